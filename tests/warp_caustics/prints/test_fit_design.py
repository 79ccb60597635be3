"""Lines found again in a relief, and what is the matter with them."""

from dataclasses import replace

import numpy as np
import pytest

from warp_caustics.inspection.fibres import fibre_findings
from warp_caustics.prints.fit_design import fit_design
from warp_caustics.prints.line import Line, line_relief, moved_across
from warp_caustics.prints.model import LineModel
from warp_caustics.scene import Scene

PLATE = (0.05, 0.05)
N = 64
LINES = [
    Line((-0.02, -0.015), (0.02, -0.01), 3e-3, 5e-4),
    Line((-0.015, 0.02), (0.01, -0.02), 2.5e-3, 8e-4),  # crosses the first
    Line((0.0, 0.01), (0.022, 0.018), 4e-3, 3e-4),
]
SIGMA = np.full((N, N), 3e-6)
TOLERANCE = 5e-5
MODEL = LineModel(Scene(height_samples=N, image_pixels=N, plate_size_m=PLATE))


def relief(lines):
    return line_relief(lines, N, PLATE)


def findings(printed, sigma=SIGMA):
    deviation = relief(printed) - relief(LINES)
    fitted = fit_design(MODEL, LINES, relief(printed), sigma)
    limit = np.full((N, N), TOLERANCE)
    out = np.abs(deviation) > limit
    return fibre_findings(LINES, fitted, out, deviation, limit, TOLERANCE, PLATE)


def status(printed, sigma=SIGMA):
    return [fibre.status for fibre in findings(printed, sigma)]


def test_a_plate_as_designed_fits_exactly():
    for fit in fit_design(MODEL, LINES, relief(LINES), SIGMA):
        assert abs(fit.height_error_m) < 1e-9 and abs(fit.displacement_m) < 1e-9
    assert status(LINES) == ["as designed"] * 3


def test_small_errors_are_measured():
    """Heights off by 20 um, ends by some ten; overlaps shared out."""
    printed = [
        replace(moved_across(line, 3e-5 * k, -2e-5), height_m=line.height_m + 2e-5 * (k - 1))
        for k, line in enumerate(LINES)
    ]
    noise = np.random.default_rng(1).normal(0, 1e-6, (N, N))
    for k, fit in enumerate(fit_design(MODEL, LINES, relief(printed) + noise, SIGMA)):
        assert fit.height_error_m == pytest.approx(2e-5 * (k - 1), abs=3e-6)
        assert fit.displacement_m == pytest.approx((3e-5 * k - 2e-5) / 2, abs=5e-6)


@pytest.mark.parametrize("k", range(3))
def test_a_missing_fibre_is_named(k):
    printed = [replace(line, height_m=0.0) if i == k else line for i, line in enumerate(LINES)]
    assert status(printed) == ["missing" if i == k else "as designed" for i in range(3)]


@pytest.mark.parametrize(("change", "name"), [(2e-4, "too high"), (-1.5e-4, "too low")])
def test_a_wrong_height_is_named(change, name):
    printed = [LINES[0], replace(LINES[1], height_m=LINES[1].height_m + change), LINES[2]]
    found = findings(printed)
    assert [fibre.status for fibre in found] == ["as designed", name, "as designed"]
    assert found[1].height_error_m == pytest.approx(change, abs=1e-6)


@pytest.mark.parametrize("shift", [4e-4, -1e-3, 1.7e-3])
def test_a_displaced_fibre_is_named_near_and_far(shift):
    printed = [LINES[0], moved_across(LINES[1], shift, shift), LINES[2]]
    found = findings(printed)
    assert [fibre.status for fibre in found] == ["as designed", "displaced", "as designed"]
    assert found[1].displacement_m == pytest.approx(abs(shift), abs=2e-5)
    assert found[1].start_m == LINES[1].start_m


def test_patches_of_error_do_not_drag_a_line():
    """A crossing that was measured 0.3 mm wrong."""
    heights = relief(LINES)
    heights[15:21, 36:42] += 3e-4
    for fit in fit_design(MODEL, LINES, heights, SIGMA):
        assert abs(fit.height_error_m) < 1.5e-5 and abs(fit.displacement_m) < 2e-5


def test_an_extra_fibre_is_found_with_its_ends():
    extra = Line((-0.02, 0.005), (-0.008, 0.022), 2e-3, 3e-4)
    *designed, found = findings([*LINES, extra])
    assert {fibre.status for fibre in designed} == {"as designed"}
    assert found.name == "extra 1" and found.status == "extra"
    ends = sorted([found.start_m, found.end_m])
    np.testing.assert_allclose(ends, [extra.start_m, extra.end_m], atol=1.5e-3)
    assert found.volume_m3 == pytest.approx(relief([extra]).sum() * (PLATE[0] / N) ** 2, rel=0.25)


def test_what_cannot_be_seen_is_hidden():
    sigma = SIGMA.copy()
    sigma[relief([LINES[2]]) > 0] = 1e-2
    found = findings(LINES, sigma)
    assert [fibre.status for fibre in found] == ["as designed", "as designed", "hidden"]
    assert np.isnan(found[2].height_error_m)


def test_odd_numbers_without_a_deviation_are_no_fault():
    """A fault needs cells out of tolerance."""
    fitted = fit_design(MODEL, LINES, relief([replace(LINES[0], height_m=0.0), *LINES[1:]]), SIGMA)
    nothing = np.zeros((N, N), bool)
    found = fibre_findings(LINES, fitted, nothing, np.zeros((N, N)), np.full((N, N), TOLERANCE), TOLERANCE, PLATE)
    assert [fibre.status for fibre in found] == ["as designed"] * 3


def test_blocks_find_what_one_matrix_finds(monkeypatch):
    """Several blocks, where a design is too large for one: the same heights, within what their overlaps leave."""
    from warp_caustics.prints import fit_design as module

    heights = relief([replace(line, height_m=1.1 * line.height_m) for line in LINES])
    whole = fit_design(MODEL, LINES, heights, SIGMA)
    monkeypatch.setattr(module, "BLOCK_LINES", 1)
    split = fit_design(MODEL, LINES, heights, SIGMA)
    for one, other in zip(whole, split, strict=True):
        assert abs(one.line.height_m - other.line.height_m) < 3e-6
        assert abs(one.displacement_m - other.displacement_m) < 3e-6


def test_another_width_is_found_and_told_from_another_height():
    """One half as wide again, one narrower by a third; the third keeps its width to the last digit."""
    printed = [
        replace(LINES[0], width_m=1.5 * LINES[0].width_m), replace(LINES[1], width_m=0.67 * LINES[1].width_m), LINES[2]
    ]  # fmt: skip
    noise = np.random.default_rng(1).normal(0, 1e-6, (N, N))
    fitted = fit_design(MODEL, LINES, relief(printed) + noise, SIGMA)
    for fit, line in zip(fitted[:2], printed[:2], strict=True):
        assert fit.line.width_m == pytest.approx(line.width_m, rel=0.02)
        assert abs(fit.height_error_m) < 1e-5 and 0 < fit.width_std_m < 1e-4
    assert fitted[2].width_error_m == 0.0 and fitted[2].line.width_m == LINES[2].width_m
    assert status(printed) == ["too wide", "too narrow", "as designed"]


def test_widths_that_are_as_designed_change_nothing():
    """Heights and places are those of a fit that knows no widths."""
    printed = [replace(moved_across(line, 2e-5, -2e-5), height_m=line.height_m + 1e-5) for line in LINES]
    for fit in fit_design(MODEL, LINES, relief(printed), SIGMA):
        assert fit.width_error_m == 0.0
        assert fit.height_error_m == pytest.approx(1e-5, abs=1e-6)


def test_a_missing_fibre_has_no_width():
    printed = [replace(LINES[0], height_m=0.0), *LINES[1:]]
    assert fit_design(MODEL, LINES, relief(printed), SIGMA)[0].width_error_m == 0.0
    assert status(printed) == ["missing", "as designed", "as designed"]


def test_a_fibre_that_was_taken_for_missing_with_another_beside_it_is_displaced():
    """As where lines were fitted to the image and a new one took its place; one that crosses it is another."""
    aside = moved_across(LINES[0], 1e-3, 1e-3)
    printed = [aside, *LINES[1:]]
    gone = [replace(LINES[0], height_m=0.0), *LINES[1:]]
    deviation = relief(printed) - relief(LINES)
    fitted = fit_design(MODEL, LINES, relief(gone), SIGMA)
    limit = np.full((N, N), TOLERANCE)
    found = fibre_findings(LINES, fitted, np.abs(deviation) > limit, deviation, limit, TOLERANCE, PLATE)
    assert [fibre.status for fibre in found] == ["displaced", "as designed", "as designed"]
    assert found[0].displacement_m == pytest.approx(1e-3, rel=0.4)
    crossing = Line((-0.01, -0.022), (-0.014, -0.002), 3e-3, 5e-4)
    deviation = relief([crossing, *LINES[1:]]) - relief(LINES)
    found = fibre_findings(LINES, fitted, np.abs(deviation) > limit, deviation, limit, TOLERANCE, PLATE)
    assert found[0].status == "missing" and [fibre.status for fibre in found[3:]] == ["extra"] * len(found[3:])
    assert len(found) > 3
