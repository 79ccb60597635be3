"""A measured relief against its design."""

import numpy as np
import pytest

from warp_caustics.errors import InputError
from warp_caustics.inspection.compare import inspect_plate
from warp_caustics.inspection.findings import FibreFinding
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=64, image_pixels=64)
NOMINAL = line_relief([Line((-0.015, -0.01), (0.015, 0.01), 4e-3, 3e-4)], 64, SCENE.plate_size_m)
SIGMA = np.full((64, 64), 2e-6)
CELL = (0.05 / 64) ** 2


def bump(row, column, height, size=4):
    heights = NOMINAL.copy()
    heights[row : row + size, column : column + size] += height
    return heights


def test_a_plate_as_designed_passes():
    found = inspect_plate(NOMINAL + 1e-5, NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert found.verdict == "pass" and not found.regions
    assert found.volume_m3 == pytest.approx(NOMINAL.sum() * CELL)
    assert any("level was moved by -10 um" in warning for warning in found.warnings)
    assert np.abs(found.deviation_m).max() < 1e-15


def test_region_has_place_size_volume_and_peak():
    """A block of 4 x 4 cells of 0.2 mm on bare plate, at rows 4 to 7 and columns 40 to 43."""
    found = inspect_plate(bump(4, 40, 2e-4), NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert found.verdict == "fail" and len(found.regions) == 1
    (region,) = found.regions
    pitch = 0.05 / 64
    assert region.centre_m == pytest.approx((-0.025 + 42 * pitch, -0.025 + 6 * pitch))
    assert region.lower_m == pytest.approx((-0.025 + 40 * pitch, -0.025 + 4 * pitch))
    assert region.upper_m == pytest.approx((-0.025 + 44 * pitch, -0.025 + 8 * pitch))
    assert region.area_m2 == pytest.approx(16 * CELL)
    assert region.volume_m3 == pytest.approx(16 * CELL * 2e-4)
    assert region.peak_m == pytest.approx(2e-4)
    assert "too much glass, up to 200 um" in found.reasons[0]
    assert found.volume_m3 - found.nominal_volume_m3 == pytest.approx(region.volume_m3)
    assert found.mass_kg == pytest.approx(2200 * found.volume_m3)


def test_regions_are_sorted_by_volume_and_split_by_sign():
    heights = bump(4, 40, 2e-4)
    heights[4:10, 44:50] -= 3e-4
    found = inspect_plate(heights, NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert [region.number for region in found.regions] == [1, 2]
    assert [np.sign(region.peak_m) for region in found.regions] == [-1, 1]


def test_an_uncertain_measurement_does_not_pass():
    sigma = SIGMA.copy()
    sigma[10:20, 10:20] = 4e-5
    found = inspect_plate(NOMINAL, NOMINAL, SCENE, 5e-5, sigma_m=sigma)
    assert found.verdict == "uncertain" and not found.regions
    assert found.undecided.sum() == 100 and "too uncertain to tell" in found.reasons[0]


def test_a_faulty_fibre_fails_and_a_hidden_one_is_uncertain():
    def fibre(status):
        return FibreFinding("1", status, (0.0, 0.0), (0.01, 0.0), -3e-4, 0.0, 0.0)

    failed = inspect_plate(NOMINAL, NOMINAL, SCENE, 5e-5, sigma_m=SIGMA, fibres=[fibre("missing")])
    assert failed.verdict == "fail" and "fibre 1 is missing" in failed.reasons[0]
    assert inspect_plate(NOMINAL, NOMINAL, SCENE, 5e-5, sigma_m=SIGMA, fibres=[fibre("hidden")]).verdict == "uncertain"


def test_what_is_masked_does_not_count():
    mask = np.ones((64, 64), bool)
    mask[:12] = False
    found = inspect_plate(bump(4, 40, 2e-4), NOMINAL, SCENE, 5e-5, sigma_m=SIGMA, mask=mask)
    assert found.verdict == "pass"


def test_glass_of_unknown_density_has_no_mass():
    found = inspect_plate(NOMINAL, NOMINAL, SCENE.model_copy(update={"glass": 1.5}), 5e-5)
    assert np.isnan(found.mass_kg) and any("--density" in warning for warning in found.warnings)


def test_fibres_narrower_than_two_samples_are_told_unless_the_lines_are_known():
    """Moved aside by less than the tolerance, such a fibre leaves the zone that its samples give it."""
    thin = [Line((-0.015, 0.0002), (0.015, 0.0002), 3e-4, 1e-3)]
    nominal = line_relief(thin, 64, SCENE.plate_size_m)
    moved = line_relief([Line((-0.015, 0.00023), (0.015, 0.00023), 3e-4, 1e-3)], 64, SCENE.plate_size_m)
    found = inspect_plate(moved, nominal, SCENE, 2e-5, sigma_m=0.01 * SIGMA)
    assert any("narrower than two samples" in warning for warning in found.warnings)
    known = inspect_plate(moved, nominal, SCENE, 2e-5, sigma_m=0.01 * SIGMA, limit_m=np.full((64, 64), 1e-3))
    assert not any("narrower than two samples" in warning for warning in known.warnings) and known.verdict == "pass"
    wide = inspect_plate(NOMINAL, NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert not any("narrower than two samples" in warning for warning in wide.warnings)


def test_wrong_input_is_named():
    with pytest.raises(InputError, match="tolerance 0 m"):
        inspect_plate(NOMINAL, NOMINAL, SCENE, 0.0)
    with pytest.raises(InputError, match="nominal heights have shape"):
        inspect_plate(NOMINAL, NOMINAL[:32], SCENE, 5e-5)


@pytest.mark.parametrize("size", [1, 2])
def test_a_spike_fails_whatever_its_area(size):
    """Fewer cells than a defect has, but far higher than an error of the measurement."""
    found = inspect_plate(bump(4, 40, 1e-3, size), NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert found.verdict == "fail" and len(found.regions) == 1
    assert found.regions[0].area_m2 == pytest.approx(size**2 * CELL)
    assert "up to 1000 um" in found.reasons[0]


@pytest.mark.parametrize("size", [1, 2])
def test_a_spike_that_is_not_certain_is_no_fault_but_does_not_pass(size):
    """Twenty times the tolerance, and nobody knows whether it is there."""
    sigma = SIGMA.copy()
    sigma[4 : 4 + size, 40 : 40 + size] = 6e-4
    found = inspect_plate(bump(4, 40, 1e-3, size), NOMINAL, SCENE, 5e-5, sigma_m=sigma)
    assert found.verdict == "uncertain" and not found.regions and found.undecided.sum() == size**2


def test_a_small_part_that_is_not_certain_stands_in_the_verdict():
    sigma = SIGMA.copy()
    sigma[4, 40] = 6e-5
    found = inspect_plate(bump(4, 40, 1e-4, 1), NOMINAL, SCENE, 5e-5, sigma_m=sigma)
    assert found.verdict == "pass"
    assert found.reasons[-1].startswith("not judged: 1 part beyond tolerance (up to 100 um)")


@pytest.mark.parametrize(("step", "verdict"), [(8, "uncertain"), (16, "pass")])
def test_many_small_parts_do_not_pass_one_by_one(step, verdict):
    """Single cells of 0.15 mm on 1.6 % of the plate; on 0.4 % they are named."""
    heights = NOMINAL.copy()
    heights[::step, ::step] += 1.5e-4
    found = inspect_plate(heights, NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert found.verdict == verdict and not found.regions
    assert f"{(64 // step) ** 2} parts beyond tolerance (up to 150 um)" in found.reasons[-1]


def test_parts_too_small_to_judge_stand_in_the_verdict():
    found = inspect_plate(bump(4, 40, 1.2e-4, 2), NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    assert found.verdict == "pass" and not found.regions
    assert found.reasons[-1].startswith("not judged: 1 part beyond tolerance (up to 120 um), each of fewer than 5")


def test_no_numbers_never_pass():
    heights, sigma = NOMINAL.copy(), SIGMA.copy()
    heights[3, 3] = np.nan
    with pytest.raises(InputError, match="heights are no numbers at 1 places"):
        inspect_plate(heights, NOMINAL, SCENE, 5e-5, sigma_m=SIGMA)
    for nothing in (np.nan, -1e-6, np.inf):
        sigma[10:20, 10:20] = nothing
        assert inspect_plate(NOMINAL, NOMINAL, SCENE, 5e-5, sigma_m=sigma).verdict == "uncertain"
