"""Odd prints, lights and benches: what is drawn, what is counted, and what the page says of the stored results."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.beyond import NAMES, UNTOLD, figures, is_row_wrong, odd_image, plate_case, summary, table
from benchmarks.odd_light import LIGHT
from benchmarks.odd_reliefs import BENCHES, COLOURS, RELIEFS
from data_gen.suites.light import true_heights
from warp_caustics.reconstruct.base import Reconstruction

ROOT = Path(__file__).parents[2]
STORED = ROOT / "benchmarks" / "beyond.json"
PHOTONS = 200_000


@pytest.fixture(scope="module")
def case():
    return plate_case(0)


@pytest.fixture(scope="module")
def plain(case):
    """Of a sensor that is linear after all."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(LIGHT, "plain", ("", lambda image, rng: image))
        return odd_image(case, "plain", "cpu", PHOTONS)


def test_names_are_told_apart():
    assert len(NAMES) == sum(map(len, (LIGHT, RELIEFS, BENCHES, COLOURS))) and set(UNTOLD) < set(NAMES)
    assert len({words.lower() for words in NAMES.values()}) == len(NAMES)


@pytest.mark.parametrize("name", ["stripes", "groove", "base_4mm", "leds"])
def test_what_is_odd_shows(case, plain, name):
    image, heights = odd_image(case, name, "cpu", PHOTONS)
    change = image.irradiance - plain[0].irradiance
    assert image.irradiance.shape == plain[0].irradiance.shape and np.abs(change).max() > 0
    assert image.irradiance.min() >= 0
    assert (heights != true_heights(case)).any() == (name in RELIEFS)
    again, _ = odd_image(case, name, "cpu", PHOTONS)
    np.testing.assert_array_equal(image.irradiance, again.irradiance)


@pytest.mark.parametrize("name", RELIEFS)
def test_reliefs_are_heights(case, name):
    true = true_heights(case)
    odd = RELIEFS[name][1](true, np.random.default_rng(0))
    assert odd.shape == true.shape and np.isfinite(odd).all() and (odd != true).any()
    np.testing.assert_array_equal(true, true_heights(case))


@pytest.mark.parametrize("name", LIGHT)
def test_lights_are_light(name):
    image = 1 + 5 * np.random.default_rng(0).random((3, 64, 64))
    odd = LIGHT[name][1](image.copy(), np.random.default_rng(0))
    assert odd.shape == image.shape and np.isfinite(odd).all() and (odd != image).any()


def test_results_are_counted():
    truth = np.zeros((8, 8))
    result = Reconstruction(
        "fibres",
        truth + 4e-6,
        np.zeros((3, 1, 1)),
        0.0,
        "converged",
        uncertainty_m=np.full((8, 8), 1e-6),
        counters={"doubt": {"is_doubtful": True}, "explained_by": "fibres"},
        warnings=("see there",),
    )
    row = figures("groove", 1, result, truth)
    assert row == {
        "name": "groove", "plate": 1, "rmse_um": pytest.approx(4), "stated_um": pytest.approx(1), "within_two": 0.0,
        "doubted": True, "warnings": 1, "by": "fibres",
    }  # fmt: skip
    assert (
        is_row_wrong(row) and not is_row_wrong(row | {"rmse_um": 2.9}) and not is_row_wrong(row | {"stated_um": None})
    )
    rows = [row, row | {"plate": 0, "rmse_um": 2.0, "within_two": 1.0}, row | {"name": "wedge", "rmse_um": 60.0}]
    lines = table(rows)
    assert lines[2] == "| base a wedge, 100 um | 60, 1 | 0 % | 1 | 1 |"
    assert lines[3] == "| a groove, 60 um deep | 2, 1; 4, 1 | 100 %; 0 % | 1 | 1; 1 |" and len(lines) == 4
    assert summary(rows).startswith("1 of 2 results are off by more than 3 times what they state (groove), beside 1 of")


def test_the_page_shows_what_is_stored():
    """python -m benchmarks.beyond --read benchmarks/beyond.json gives the table."""
    rows = json.loads(STORED.read_text(encoding="utf-8"))["rows"]
    page = (ROOT / "docs" / "beyond.md").read_text(encoding="utf-8")
    assert "\n".join(table(rows)) in page and summary(rows) in " ".join(page.split())
