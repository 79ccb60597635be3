"""A suite as files: what is read from them is what methods get."""

import hashlib
import json

import numpy as np
import pytest
import yaml

from cli.config import load_config
from data_gen.suites.export import NAMES, export_suite
from data_gen.suites.light import true_heights
from data_gen.suites.shot import measured
from data_gen.suites.suites import suite_cases
from warp_caustics.capture.read import read_capture
from warp_caustics.capture.settings import CaptureSettings
from warp_caustics.io.heights import read_heights


@pytest.fixture(scope="module")
def cases():
    return [*suite_cases("lab", 1, ("poor", "another")), *suite_cases("one-thing", 1, ("shift-1", "ellipse"))]


@pytest.fixture(scope="module")
def exported(cases, tmp_path_factory, light):
    folder = tmp_path_factory.mktemp("suite")
    export_suite(cases, folder, light, "code of a test")
    return folder


def read(folder, case):
    captures = folder / "captures"
    told = load_config(str(folder / "scenes" / f"{case.name}.yaml"), ()).scene
    tree = yaml.safe_load((captures / f"{case.name}_capture.yaml").read_text(encoding="utf-8"))
    settings = CaptureSettings(**{key: str(captures / name) for key, name in tree.items()})
    return told, read_capture(captures / f"{case.name}.tif", told, settings)


def test_captures_are_what_methods_get(exported, cases, light):
    for case in cases:
        told, capture = read(exported, case)
        assert told == case.told
        image = measured(case, light).image
        if case.camera is not None:
            np.testing.assert_array_equal(capture.irradiance, image.irradiance)
            np.testing.assert_array_equal(capture.noise_std, image.noise_std)
            np.testing.assert_array_equal(capture.mask, image.mask)
            continue
        mask = np.ones(image.irradiance.shape, bool) if image.mask is None else image.mask
        np.testing.assert_array_equal(capture.mask, mask)
        # Half a step of 16 bits.
        step = max(1 / 3000, image.irradiance[mask].max() / (0.97 * 65279))
        assert np.abs(capture.irradiance - image.irradiance)[mask].max() < 0.6 * step


def test_truth_is_apart_and_exact(exported, cases):
    for case in cases:
        np.testing.assert_array_equal(read_heights(exported / "truth" / f"{case.name}.npy"), true_heights(case))
        record = json.loads((exported / "truth" / f"{case.name}.json").read_text(encoding="utf-8"))
        assert record["scene"]["base_thickness_m"] == case.scene.base_thickness_m
    told = [*(exported / "captures").iterdir(), *(exported / "scenes").iterdir(), exported / "suite.json"]
    for path in told:
        if path.suffix in (".yaml", ".json"):
            text = path.read_text(encoding="utf-8")
            assert "fresnel" not in text and "lamp_half_angle" not in text and "psf" not in text


def test_card_and_checksums(exported, cases):
    assert {path.name for path in exported.iterdir()} == set(NAMES)
    lines = (exported / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    files = {path for path in exported.rglob("*") if path.is_file() and path.name != "SHA256SUMS"}
    assert len(lines) == len(files)
    for line in lines:
        digest, name = line.split("  ")
        assert hashlib.sha256((exported / name).read_bytes()).hexdigest() == digest
    card = (exported / "README.md").read_text(encoding="utf-8")
    assert "## Licence\n\nMIT" in card and "50,000 light paths" in card and "{" not in card
    assert all(f"| `{case.row}` |" in card for case in cases)


def test_what_is_written_stays_and_what_is_damaged_is_written_again(exported, cases, light):
    written = []
    export_suite(cases, exported, light, "code of a test", lambda case: written.append(case.name))
    assert written == []
    before = (exported / "SHA256SUMS").read_bytes()
    (exported / "truth" / f"{cases[0].name}.json").unlink()
    export_suite(cases, exported, light, "code of a test", lambda case: written.append(case.name))
    assert written == [cases[0].name]
    assert (exported / "SHA256SUMS").read_bytes() == before
