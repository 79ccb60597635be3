"""Files reach the disk; tests that need the optional OpenEXR package are skipped without it."""

import pytest


@pytest.fixture(autouse=True)
def _to_disk(real_fsync: None) -> None:
    """Files are written here as they are for a user."""


@pytest.fixture(autouse=True)
def _exr(request: pytest.FixtureRequest) -> None:
    parameters = getattr(request.node, "callspec", None)
    if parameters is not None and ".exr" in str(parameters.params.get("suffix", parameters.params.get("name", ""))):
        pytest.importorskip("OpenEXR")
