"""Where the whole picture lies, apart from what is the matter with single fibres."""

from dataclasses import replace

import numpy as np
import pytest

from warp_caustics.inspection.judge import judge_plate
from warp_caustics.inspection.nominal import Nominal
from warp_caustics.inspection.place import Place, found_place, moved_design, moved_line
from warp_caustics.prints.line import Line, line_relief, moved_across
from warp_caustics.scene import Scene

N = 64
SCENE = Scene(height_samples=N, image_pixels=N)
SIGMA = np.full((N, N), 3e-6)
WHOLE = Place((6e-5, -4e-5), 8e-4, 1e-3, 0.04)


def drawn(count, seed=3):
    """Fibres of millimetres anywhere on the plate."""
    rng = np.random.default_rng(seed)
    ends = rng.uniform(-0.02, 0.02, (count, 4)).tolist()
    return [
        Line((x, y), (u, v), width, height)
        for (x, y, u, v), width, height in zip(
            ends, rng.uniform(2e-3, 4e-3, count).tolist(), rng.uniform(3e-4, 9e-4, count).tolist(), strict=True
        )
    ]


LINES = drawn(12)
NOMINAL = Nominal.of_lines(LINES, SCENE)


def relief(lines, gain=0.0):
    return (1 + gain) * line_relief(lines, N, SCENE.plate_size_m)


@pytest.mark.parametrize("nominal", [NOMINAL, Nominal(NOMINAL.relief_m)], ids=["lines", "map"])
def test_shift_turn_size_and_gain_are_found_together(nominal):
    heights = relief([moved_line(line, WHOLE) for line in LINES], WHOLE.gain)
    noise = np.random.default_rng(0).normal(0, 3e-6, (N, N))
    found = found_place(heights + noise, nominal, SCENE, sigma_m=SIGMA)
    off = np.abs(found.numbers - WHOLE.numbers)
    assert (off < [5e-6, 5e-6, 3e-4, 3e-4, 0.01]).all()
    assert (off < 3 * np.array(found.sigma)).all()


def test_one_fibre_that_is_displaced_moves_no_picture():
    """Nor one that is missing, or a drop of glass that nobody designed."""
    for printed in (
        [moved_across(LINES[0], 6e-4, 6e-4), *LINES[1:]],
        [replace(LINES[0], height_m=0.0), *LINES[1:]],
        [*LINES, Line((0.0, 0.0), (0.0, 0.0), 4e-3, 5e-4)],
    ):
        found = found_place(relief(printed), NOMINAL, SCENE, sigma_m=SIGMA)
        assert found.significant().is_told
        assert np.hypot(*found.shift_m) < 8e-6


@pytest.mark.parametrize("count", [1, 2])
def test_of_few_fibres_one_that_is_displaced_is_no_shift_of_the_picture(count):
    """Both would explain it; the whole is rarely so far off."""
    lines = drawn(count, 1)
    heights = relief([moved_across(lines[0], 1e-3, 1e-3), *lines[1:]])
    found = found_place(heights, Nominal.of_lines(lines, SCENE), SCENE, sigma_m=SIGMA)
    assert np.hypot(*found.shift_m) < 5e-5


def test_uncertainties_cover_fibres_that_lie_aside_by_chance():
    """20 um of noise in the place of each end: of 5 numbers of 30 plates two thirds within one, nearly all in three."""
    off = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        lines = drawn(12, 100 + seed)
        printed = [
            replace(
                line,
                start_m=tuple(np.add(line.start_m, rng.normal(0, 2e-5, 2)).tolist()),
                end_m=tuple(np.add(line.end_m, rng.normal(0, 2e-5, 2)).tolist()),
            )
            for line in lines
        ]
        found = found_place(relief(printed), Nominal.of_lines(lines, SCENE), SCENE, sigma_m=SIGMA)
        off.append(np.abs(found.numbers) / np.array(found.sigma))
    assert 0.5 < np.mean(np.array(off)[:, :4] < 1) < 0.97
    assert np.mean(np.array(off) < 3) > 0.95


def test_a_plate_that_lies_aside_as_a_whole_passes_and_its_displaced_fibre_does_not():
    aside = Place((1.5e-4, 1e-4), 1e-3)
    moved = [moved_line(line, aside) for line in LINES]
    good = judge_plate(relief(moved), NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert good.verdict == "pass" and good.place is not None
    assert good.place.shift_m == pytest.approx(aside.shift_m, abs=1e-5)
    assert judge_plate(relief(moved), NOMINAL, SCENE, 5e-5, sigma_m=SIGMA, is_placed=True).verdict == "fail"
    bad = judge_plate(relief([moved_across(moved[0], 6e-4, 6e-4), *moved[1:]]), NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert [fibre.name for fibre in bad.fibres if fibre.status != "as designed"] == ["1"]
    assert bad.fibres[0].status == "displaced"
    assert bad.fibres[0].displacement_m == pytest.approx(6e-4, rel=0.1)


def test_a_factor_on_all_heights_is_uncertain_and_a_missing_fibre_fails_all_the_same():
    """As of a gap 200 um wider than told: 12 %, up to 100 um."""
    higher = judge_plate(relief(LINES, 0.12), NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert higher.verdict == "uncertain"
    assert any("higher than designed" in warning for warning in higher.warnings)
    lacking = relief([replace(LINES[0], height_m=0.0), *LINES[1:]], 0.12)
    bad = judge_plate(lacking, NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert bad.verdict == "fail" and bad.fibres[0].status == "missing"
    slight = judge_plate(relief(LINES, 0.01), NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert slight.verdict == "pass"


def test_of_a_bare_design_nothing_is_told():
    place = found_place(np.zeros((N, N)), Nominal(np.zeros((N, N))), SCENE)
    assert place.is_told and place.line.startswith("moved by (0.0")


def test_a_map_moves_as_its_lines_do():
    moved = moved_design(NOMINAL, WHOLE, SCENE)
    as_map = moved_design(Nominal(NOMINAL.relief_m), WHOLE, SCENE)
    assert np.abs(moved.relief_m - as_map.relief_m).max() < 1.5e-5
    assert np.abs(moved.relief_m - NOMINAL.relief_m).max() > 5e-5


def test_no_single_fibre_is_accused_of_what_all_of_them_are():
    """12 % higher, and one displaced: it alone is named."""
    lines = [moved_across(LINES[0], 6e-4, 6e-4), *LINES[1:]]
    bad = judge_plate(relief(lines, 0.12), NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert [(fibre.name, fibre.status) for fibre in bad.fibres if fibre.status != "as designed"] == [("1", "displaced")]
