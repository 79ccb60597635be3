"""Printed lines against closed forms and against a relief that other software made of the demo's lines."""

import math
from pathlib import Path

import numpy as np
import pytest

from data_gen.config import ReliefConfig
from warp_caustics.errors import InputError
from warp_caustics.prints.line import Line, line_profile, line_relief

PLATE = (0.05, 0.05)
ROOT = Path(__file__).parents[3]
PRINTED_LINES = ROOT / "examples" / "data" / "printed_lines.csv"


def test_relief_of_other_software_is_reproduced():
    """Heights that came with another renderer's image, of the demo's lines at cell centres."""
    numbers = np.loadtxt(PRINTED_LINES, delimiter=",", skiprows=1).tolist()
    lines = [Line((x0, y0), (x1, y1), width, height) for x0, y0, x1, y1, width, height in numbers]
    relief = line_relief(lines, 128, PLATE, supersampling=1)
    theirs = np.load(ROOT / "tests" / "data" / "f_lines_trace.npz")["heights_m"]
    np.testing.assert_allclose(relief, theirs, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("section", "expected"), [("cosine", [2.0, 1.0, 0.0, 0.0]), ("quarter", [2.0, math.sqrt(2), 0.0, 0.0])]
)
def test_profile_at_centre_quarter_edge_and_outside(section, expected):
    heights = line_profile(np.array([0.0, 1.0, 2.0, 2.5]), width_m=4.0, height_m=2.0, section=section)
    np.testing.assert_allclose(heights, expected, atol=1e-15)


def test_lines_are_added_where_they_cross():
    across = Line((-0.01, 0.0), (0.01, 0.0), 2e-3, 1e-3)
    along = Line((0.0, -0.01), (0.0, 0.01), 4e-3, 5e-4)
    relief = line_relief([across, along], 5, PLATE, supersampling=1)
    assert relief[2, 2] == pytest.approx(1.5e-3)
    np.testing.assert_allclose(relief, line_relief([across], 5, PLATE, supersampling=1) + relief_of(along))


def relief_of(line):
    return line_relief([line], 5, PLATE, supersampling=1)


def test_row_grows_with_y_and_column_with_x():
    relief = line_relief([Line((0.02, -0.02), (0.02, -0.01), 4e-3, 1e-3)], 50, PLATE)
    row, column = np.unravel_index(int(relief.argmax()), relief.shape)
    assert row in range(5, 15) and column in (44, 45)
    assert relief[25:].max() == 0.0


@pytest.mark.parametrize("section", ["cosine", "quarter"])
def test_volume_of_a_thin_line_survives_supersampling(section):
    """Cross-section times length plus the two half discs at the ends; width a quarter of a cell."""
    width, height, length = 1e-4, 1e-3, 0.0317
    line = Line((-0.0111, 0.0032), (-0.0111 + length * math.cos(0.4), 0.0032 + length * math.sin(0.4)), width, height)
    area, disc = {
        "cosine": (width * height / 2, height * width**2 * (math.pi / 8 - 1 / (2 * math.pi))),
        "quarter": (2 * width * height / math.pi, height * width**2 * (1 - 2 / math.pi)),
    }[section]
    relief = line_relief([line], 125, PLATE, section=section, supersampling=16)
    volume = relief.mean() * PLATE[0] * PLATE[1]
    assert volume == pytest.approx(area * length + disc, rel=0.01)


def test_a_line_without_length_is_a_round_drop():
    relief = line_relief([Line((0.0, 0.0), (0.0, 0.0), 0.02, 1e-3)], 101, PLATE, supersampling=1)
    np.testing.assert_allclose(relief, relief.T, atol=1e-18)
    assert relief[50, 50] == 1e-3
    assert relief[50, 60] == pytest.approx(1e-3 / 2 * (1 + math.cos(2 * math.pi * 10 * 0.05 / 101 / 0.02)))


def test_parts_beyond_the_plate_are_cut_off():
    assert line_relief([Line((0.03, 0.0), (0.04, 0.0), 1e-3, 1e-3)], 16, PLATE).max() == 0.0
    assert line_relief([Line((0.02, 0.0), (0.04, 0.0), 1e-2, 1e-3)], 16, PLATE)[:, -1].max() > 0.0


@pytest.mark.parametrize(("width", "height"), [(0.0, 1e-3), (-1e-3, 1e-3), (1e-3, -1e-9), (math.nan, 1e-3)])
def test_impossible_lines_are_refused(width, height):
    with pytest.raises(InputError):
        Line((0.0, 0.0), (0.01, 0.0), width, height)


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("line_count", (30, 2), "give 0 <= lowest"),
        ("line_width_m", (4e-3, 1e-4), "swap them"),
        ("line_width_m", (0.0, 1e-3), "not above 0"),
        ("line_start_m", (-25.0, 25.0), "give metres"),
        ("line_height_m", (1e-4, math.inf), "finite"),
        ("supersampling", 0, "greater than or equal to 1"),
        ("line_width", (1e-4, 4e-3), "Extra inputs"),
        ("smallest_width_m", 5e-3, "widest line"),
    ],
)
def test_bad_ranges_are_refused(key, value, reason):
    with pytest.raises(ValueError, match=reason):
        ReliefConfig.model_validate({key: value})


def test_defaults_are_table_3():
    config = ReliefConfig()
    assert config.line_count == (2, 30)
    assert config.line_start_m == config.line_end_m == (-0.025, 0.025)
    assert (config.line_width_m, config.line_height_m) == ((1e-4, 4e-3), (1e-4, 2e-3))
    offsets = config.perturbation
    assert offsets.line_start_m == offsets.line_end_m == (-2.5e-3, 2.5e-3)
    assert offsets.line_width_m == offsets.line_height_m == (-1e-3, 1e-3)
