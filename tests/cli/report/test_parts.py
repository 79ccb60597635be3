"""Numbers, colours and reduced arrays."""

import numpy as np
import pytest

from cli.report.arrays import finite_range, packed, reduced
from cli.report.colours import DEVIATION, HEIGHT, UNCERTAINTY, palette
from cli.report.frame import log_ticks, plate_frame
from cli.report.number import number
from warp_caustics.io.page import inline_script


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0"), (1505.3, "1505"), (43.083, "43.1"), (2.7321, "2.73"), (-3.9357, "-3.94"), (0.05, "0.05"), (999.7, "1000"),
        (1e-5, "1.00e-05"), (2.5e7, "2.50e+07"), (100, "100"), (float("nan"), "n/a"), (float("inf"), "n/a"), (None, "n/a"),
    ],
)  # fmt: skip
def test_numbers(value, text):
    assert number(value) == text


def test_reduced_is_a_mean_of_what_is_known():
    values = np.arange(24.0).reshape(4, 6)
    values[0, 0] = np.nan
    values[2:, 4:] = np.inf
    found = reduced(values, 3)
    assert found.shape == (2, 3)
    np.testing.assert_allclose(found, [[(1 + 6 + 7) / 3, 5.5, 7.5], [15.5, 17.5, np.nan]])
    np.testing.assert_array_equal(reduced(values, 6)[1], values[1])


@pytest.mark.parametrize("size", [100, 257, 300])
def test_reduced_keeps_places_to_half_a_sample(size):
    """Blocks of a ramp are the ramp at their places."""
    found = reduced(np.tile(np.arange(size) + 0.5, (size, 1)), 99)[0]
    places = (np.arange(99) + 0.5) * size / 99
    assert np.abs(found - places).max() <= 0.5 + 1e-9


def test_ranges_are_never_empty():
    assert finite_range(np.array([np.nan])) == (0.0, 1.0)
    assert finite_range(np.zeros(3), None) == (0.0, 1.0)
    assert finite_range(np.array([1.0, np.inf, -2.0])) == (-2.0, 1.0)


def test_packed_is_little_endian_float32():
    assert packed(np.array([[1.0, np.nan]])) == {"shape": [1, 2], "f4": "AACAPwAAwH8="}


def lightness(name):
    from skimage.color import rgb2lab

    return rgb2lab(palette(name, 101)[None] / 255)[0, :, 0]


@pytest.mark.parametrize("name", [HEIGHT, UNCERTAINTY])
def test_lightness_grows_with_the_value(name):
    assert (np.diff(lightness(name)) > 0).all()


def test_deviations_are_as_light_below_as_above():
    """Printed without colour, a deviation keeps its size."""
    values = lightness(DEVIATION)
    assert np.abs(values - values[::-1]).max() < 8
    assert (np.diff(values[:51]) > 0).all() and values[50] > 95


def test_script_cannot_end_early():
    made = inline_script('a = "</script>"; b = /<!--/; c = "</SCRIPT >"')
    assert "</script" not in made.lower() and "<!--" not in made
    assert made == 'a = "<\\/script>"; b = /<\\!--/; c = "<\\/SCRIPT >"'


def test_frame_has_the_plates_shape():
    frame = plate_frame("data:,", "a plate", (50.0, 25.0), boxes_mm=[(-25, -12.5, 0, 0, "1")])
    x, y, width, height = frame.area
    assert width == 2 * height
    (box,) = frame.boxes
    assert (box.x, box.y) == pytest.approx((x, y)), "lowest y on top"
    assert (box.width, box.height) == pytest.approx((width / 2, height / 2))
    assert [text for _, text in frame.x_ticks] == ["-20", "-10", "0", "10", "20"]


def test_log_ticks_are_round():
    assert [round(10**place, 3) for place in log_ticks(-1.2, 1.1)] == [0.1, 0.2, 0.5, 1, 2, 5, 10]
    assert [10**place for place in log_ticks(-3.0, 1.0)] == pytest.approx([0.001, 0.01, 0.1, 1, 10])
