"""Scores of a release: every cell says what it is of, and is computed once."""

import json

import pytest

from benchmarks import release
from data_gen.dataset_config import PhotonConfig
from nets.evaluation.code_version import code_version


@pytest.fixture
def few(monkeypatch):
    monkeypatch.setattr(release, "TEST_PHOTONS", PhotonConfig(n_photons=10_000, placement="stratified"))


def test_cells_are_kept_with_all_that_tells_them_apart(few, tiny_scene, tmp_path, monkeypatch):
    path, images = tmp_path / "release.json", tmp_path
    arguments = path, "development", 2, "flat,refine:max_iterations=2", tiny_scene, "cpu", images
    cells = release.run(*arguments)
    assert len(cells) == 4 == len(json.loads(path.read_text(encoding="utf-8"))["cells"])
    for cell in cells:
        assert cell["image"]["set"] == "development" and len(cell["image"]["fingerprint"]) == 64
        assert cell["image"]["pixels"] and cell["device"] == "cpu" and cell["code"] == code_version()
        assert cell["rmse_um"] > 0 and cell["device_name"]
    assert {(cell["image"]["field"], cell["method"]) for cell in cells} == {
        (f"field_{k}", method) for k in range(2) for method in ("flat", "refine:max_iterations=2")
    }
    monkeypatch.setattr(release, "reconstruct", None)  # nothing is computed twice
    assert release.run(*arguments) == cells
    assert any(line.startswith("flat") for line in release.summary(cells))
    monkeypatch.setattr(release, "code_version", lambda: "another")
    with pytest.raises(TypeError):
        release.run(*arguments)


def test_by_itself_it_is_of_the_test_fields():
    """All thirty, by methods that exist."""
    from nets.evaluation.method_spec import parse_methods

    assert {"flat", "nsfc", "direct", "fibres"} <= {spec.label for spec in parse_methods(release.METHODS.split(","))}
    assert release.COUNTS["test"] == 30
