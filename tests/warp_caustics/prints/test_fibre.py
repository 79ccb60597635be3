"""Fibres melted into lines: the glass is conserved, and what overhangs is refused."""

import math

import numpy as np
import pytest

from warp_caustics.errors import InputError
from warp_caustics.prints.fibre import (
    cap_angle_of_area,
    cap_of_area,
    cap_of_width,
    fibre_area_m2,
    height_of_area,
    least_cap_width_m,
    proportioned,
)
from warp_caustics.prints.paths import paths_relief, uniform_path
from warp_caustics.prints.sections import SECTION_NAMES, named_section

D = 0.4e-3
PLATE = (0.05, 0.05)


def test_one_pass_has_the_fibres_area():
    assert fibre_area_m2(D) == pytest.approx(math.pi * D**2 / 4)
    assert fibre_area_m2(D, 6) == pytest.approx(6 * fibre_area_m2(D))


def test_the_narrowest_cap_of_the_common_fibre():
    """0.4 mm of fibre: single-valued from 0.57 mm of width on, then 0.28 mm high; sqrt(2) d and d / sqrt(2)."""
    width, height = cap_of_area(fibre_area_m2(D), math.pi / 2)
    assert width == pytest.approx(math.sqrt(2) * D) == pytest.approx(0.566e-3, rel=1e-3)
    assert height == pytest.approx(D / math.sqrt(2)) == pytest.approx(0.283e-3, rel=1e-3)
    assert least_cap_width_m(fibre_area_m2(D)) == pytest.approx(width)


@pytest.mark.parametrize("degrees", [5, 25, 70, 90])
@pytest.mark.parametrize("passes", [1, 2, 6])
def test_width_and_height_of_caps(degrees, passes):
    """A = R^2 (theta - sin theta cos theta) with w = 2 R sin theta, H = R (1 - cos theta)."""
    theta = math.radians(degrees)
    width, height = cap_of_area(fibre_area_m2(D, passes), theta)
    radius = width / (2 * math.sin(theta))
    assert height == pytest.approx(radius * (1 - math.cos(theta)))
    assert radius**2 * (theta - math.sin(theta) * math.cos(theta)) == pytest.approx(passes * math.pi * D**2 / 4)
    # Passes keep the angle, so that width and height go with the root of the glass.
    single = cap_of_area(fibre_area_m2(D), theta)
    assert (width, height) == pytest.approx(tuple(math.sqrt(passes) * value for value in single))
    angle, found = cap_of_width(fibre_area_m2(D, passes), width)
    assert (angle, found) == pytest.approx((theta, height), rel=1e-7)


@pytest.mark.parametrize("name", SECTION_NAMES)
def test_glass_is_conserved_in_every_section(name):
    section = named_section(name, contact_angle_rad=1.0)
    for passes in (1, 3):
        area = fibre_area_m2(D, passes)
        width, height = proportioned(section, area, 1.0)
        assert section.area_m2(width, height) == pytest.approx(area, rel=1e-12)
        assert height / width == pytest.approx(math.tan(0.5) / 2)
        assert section.area_m2(1.5e-3, height_of_area(section, area, 1.5e-3)) == pytest.approx(area, rel=1e-12)


@pytest.mark.parametrize("name", SECTION_NAMES)
def test_a_printed_relief_holds_the_fibres_glass(name):
    """Volume of a line across the whole plate: area times length, for one pass and for five."""
    section = named_section(name, contact_angle_rad=0.9)
    for passes in (1, 5):
        width, height = proportioned(section, fibre_area_m2(D, passes), 0.9)
        line = uniform_path(np.array([[0.001, -0.03], [0.001, 0.03]]), width, height, section)
        relief = paths_relief([line], 200, PLATE, supersampling=16)
        volume = relief.sum() * (PLATE[0] / 200) ** 2
        assert volume == pytest.approx(passes * math.pi * D**2 / 4 * PLATE[1], rel=2e-3)


def test_contact_angle_of_a_width():
    """Beyond 90 degrees too: what a bond narrower than the fibre would need (109 to 175 degrees are reported)."""
    for degrees in (20, 90, 109, 150, 175):
        theta = math.radians(degrees)
        radius = math.sqrt(fibre_area_m2(D) / (theta - math.sin(theta) * math.cos(theta)))
        assert cap_angle_of_area(fibre_area_m2(D), 2 * radius * math.sin(theta)) == pytest.approx(theta, rel=1e-9)


def test_what_overhangs_is_refused_with_its_angle_and_the_mend():
    with pytest.raises(InputError, match=r"contact angle of 110\.9 degrees: it overhangs .* at least 0\.566 mm wide"):
        cap_of_width(fibre_area_m2(D), 0.44e-3)
    with pytest.raises(InputError, match="contact angle 120 degrees is above 90"):
        cap_of_area(fibre_area_m2(D), math.radians(120))
    # The width that the message names is taken.
    angle, _ = cap_of_width(fibre_area_m2(D), 0.566e-3)
    assert angle == pytest.approx(math.pi / 2, rel=1e-3)
    for diameter, passes in ((0.0, 1), (math.nan, 1), (D, 0), (D, 10_000)):
        with pytest.raises(InputError):
            fibre_area_m2(diameter, passes)
