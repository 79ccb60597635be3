"""A plate judged from its relief: zone and findings of the design's lines, whatever their section."""

from dataclasses import replace

import numpy as np
import pytest

from warp_caustics.errors import InputError
from warp_caustics.inspection.judge import judge_plate
from warp_caustics.inspection.nominal import Nominal, read_nominal, with_lines
from warp_caustics.prints.line import SECTIONS, Line, moved_across
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=64, image_pixels=64)
TOLERANCE_M = 5e-5
LINES = [
    Line((-0.02, -0.015), (0.02, -0.01), 3e-3, 5e-4),
    Line((-0.015, 0.02), (0.01, -0.02), 2.5e-3, 8e-4),
    Line((0.0, 0.01), (0.022, 0.018), 4e-3, 3e-4),
]
SIGMA = np.full((64, 64), 3e-6)


def judged(printed, section, nominal_section=None):
    nominal = Nominal.of_lines(LINES, SCENE, nominal_section or section)
    heights = Nominal.of_lines(printed, SCENE, section).relief_m
    return judge_plate(heights, nominal, SCENE, TOLERANCE_M, sigma_m=SIGMA)


@pytest.mark.parametrize("section", SECTIONS)
def test_a_good_plate_passes_and_a_bad_line_is_named(section):
    aside = [moved_across(line, 2e-5, -2e-5) for line in LINES]
    good = judged(aside, section)
    assert good.verdict == "pass" and [fibre.status for fibre in good.fibres] == ["as designed"] * 3
    bad = judged([aside[0], moved_across(aside[1], 5e-4, 5e-4), replace(aside[2], height_m=0.0)], section)
    assert bad.verdict == "fail"
    assert [fibre.status for fibre in bad.fibres] == ["as designed", "displaced", "missing"]
    assert bad.fibres[1].displacement_m == pytest.approx(5e-4, abs=5e-6)


def test_a_quarter_cosine_is_no_raised_cosine():
    """It holds a quarter more glass: taken for the other, a good plate of this section would fail."""
    assert judged(LINES, "quarter", "cosine").verdict == "fail"
    volumes = [Nominal.of_lines(LINES[:1], SCENE, section).relief_m.sum() for section in SECTIONS]
    assert volumes[1] / volumes[0] == pytest.approx((2 / np.pi) / (1 / 2), rel=0.02)


def test_a_design_without_lines_has_no_fibres():
    nominal = Nominal(Nominal.of_lines(LINES, SCENE).relief_m)
    found = judge_plate(nominal.relief_m, nominal, SCENE, TOLERANCE_M, sigma_m=SIGMA)
    assert found.verdict == "pass" and not found.fibres
    assert (
        any("give the design as a list of lines" in warning for warning in found.warnings) or found.limit_m is not None
    )


@pytest.mark.parametrize("section", SECTIONS)
def test_lines_of_a_map_are_found_in_its_section(section):
    wide = [replace(line, width_m=4e-3) for line in LINES]
    relief = Nominal.of_lines(wide, SCENE, section).relief_m
    found = with_lines(Nominal(relief, section=section, origin="map"), "map", SCENE)
    assert len(found.lines) == 3 and found.section == section
    assert ("of section" in found.origin) == (section != "cosine")
    np.testing.assert_allclose(Nominal.of_lines(found.lines, SCENE, section).relief_m, relief, atol=2e-6)


def test_every_line_needs_a_fit():
    nominal = Nominal.of_lines(LINES, SCENE)
    with pytest.raises(InputError, match="0 fitted lines for 3"):
        judge_plate(nominal.relief_m, nominal, SCENE, TOLERANCE_M, fitted=[])


def test_a_design_far_higher_than_its_plate_is_refused_unless_told(tmp_path):
    """40 mm on a plate of 3 mm is a slip of the unit far more often than a print."""
    path = tmp_path / "design.csv"
    path.write_text("start_x_mm,start_y_mm,end_x_mm,end_y_mm,width_mm,height_mm\n-10,0,10,0,4,40\n")
    with pytest.raises(
        InputError, match=r"is up to .* mm high, above 9 mm \(3 times .*: --max-height 35.5mm"
    ) as caught:
        read_nominal(str(path), SCENE)
    told = float(str(caught.value).rsplit(" ", 1)[1].removesuffix("mm")) * 1e-3
    assert read_nominal(str(path), SCENE, highest_m=told).relief_m.max() <= told
    with pytest.raises(InputError, match="above 12 mm"):
        read_nominal(str(path), SCENE, highest_m=0.012)
