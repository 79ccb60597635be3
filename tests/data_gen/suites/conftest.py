"""Small cases: few light paths, otherwise as they are."""

import pytest

from data_gen.suites.light import Light


@pytest.fixture(scope="session")
def light():
    return Light("cpu", 50_000)
