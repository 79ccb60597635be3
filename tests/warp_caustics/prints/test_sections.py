"""Cross sections: area, height, width and foot of each against closed forms, by quadrature and by differences."""

import math

import numpy as np
import pytest

from warp_caustics.errors import InputError
from warp_caustics.prints.sections import (
    KINDS,
    SECTION_NAMES,
    CrossSection,
    cap_contact_angle_rad,
    cap_proportion,
    check_contact_angle,
    named_section,
)

WIDTH, HEIGHT = 1.2e-3, 3e-4
ANGLES = [0.01, 0.3, 1.0, math.radians(70), math.pi / 2]


SECTIONS = [
    *(named_section(name, contact_angle_rad=1.0) for name in SECTION_NAMES if name != "cap"),
    *(named_section(name, exponent=g) for name in ("cosine", "parabola", "gaussian") for g in (0.6, 1.6)),
    named_section("gaussian", exponent=0.8, reach=1.7),
    *(named_section("cap", contact_angle_rad=angle) for angle in ANGLES),
]


@pytest.mark.parametrize("section", SECTIONS, ids=str)
def test_crown_edge_and_symmetry(section):
    """1 on the centre line, falling, 0 from the edge on, and the same on both sides."""
    t = np.arange(-1000, 1001) / 1000 * section.reach
    height = section.relative_height(np.abs(t))
    assert height[1000] == pytest.approx(1.0, abs=1e-12) and height[0] == height[-1] == 0.0
    np.testing.assert_array_equal(height, height[::-1])
    assert (np.diff(height[1000:]) <= 1e-15).all()
    assert not section.relative_height(np.array([section.reach, 3.5])).any()


@pytest.mark.parametrize("section", SECTIONS, ids=str)
def test_area_by_quadrature(section):
    """The midpoint rule with a million points; upright edges cost it digits."""
    t = (np.arange(1_000_000) + 0.5) / 1_000_000 * section.reach
    measured = section.relative_height(t).mean() * section.reach
    assert section.area_factor() == pytest.approx(measured, rel=1e-6)
    assert section.area_m2(WIDTH, HEIGHT) == pytest.approx(measured * WIDTH * HEIGHT, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "area"), [("cosine", 1 / 2), ("quarter", 2 / math.pi), ("ellipse", math.pi / 4), ("parabola", 2 / 3)]
)
def test_known_areas(name, area):
    assert named_section(name).area_factor() == pytest.approx(area, rel=1e-12)


@pytest.mark.parametrize("angle", ANGLES)
def test_a_cap_is_a_circle(angle):
    """Every point of the cap lies on one circle whose centre is R cos(theta) below the plate's top."""
    radius = WIDTH / (2 * math.sin(angle))
    height = cap_proportion(angle) * WIDTH
    assert height == pytest.approx(radius * (1 - math.cos(angle)), rel=1e-12)
    r = np.linspace(0, WIDTH / 2, 101)[:-1]
    z = height * named_section("cap", contact_angle_rad=angle).relative_height(2 * r / WIDTH)
    np.testing.assert_allclose(np.hypot(r, z + radius * math.cos(angle)), radius, rtol=1e-12)
    assert cap_contact_angle_rad(WIDTH, height) == pytest.approx(angle, rel=1e-12)
    area = radius**2 * (angle - math.sin(angle) * math.cos(angle))
    section = named_section("cap", contact_angle_rad=angle)
    assert section.area_m2(WIDTH, height) == pytest.approx(area, rel=1e-9)


@pytest.mark.parametrize("section", SECTIONS, ids=str)
def test_the_foot_by_differences(section):
    """The angle of the last bit of the section; upright feet grow without end as the bit gets smaller."""
    height = cap_proportion(section.contact_angle_rad) * WIDTH if section.kind == "cap" else HEIGHT
    angle = section.foot_angle_rad(WIDTH, height)

    def measured(bit):
        rise = height * section.relative_height(np.array([section.reach * (1 - bit)]))[0]
        return math.atan(rise / (bit * section.reach * WIDTH / 2))

    if angle == math.pi / 2:
        assert measured(1e-9) > measured(1e-5) > measured(1e-3) and measured(1e-9) > 1.4
    elif angle == 0.0:
        assert measured(1e-9) < 1e-1 * measured(1e-3) < 1e-1
    else:
        assert measured(1e-6) == pytest.approx(angle, rel=1e-4)
    if section.kind == "cap":
        assert angle == pytest.approx(section.contact_angle_rad, rel=1e-12)


def test_a_flat_cap_is_a_parabola():
    t = np.linspace(0, 1, 101)
    flat = named_section("cap", contact_angle_rad=0.01).relative_height(t)
    np.testing.assert_allclose(flat, named_section("parabola").relative_height(t), atol=2e-5)
    half = named_section("cap", contact_angle_rad=math.pi / 2).relative_height(t)
    np.testing.assert_allclose(half, named_section("ellipse").relative_height(t), atol=1e-12)


def test_what_is_no_section_is_refused():
    with pytest.raises(InputError, match=r"contact angle 109 degrees is above 90: .*overhangs.*give at most 90"):
        check_contact_angle(math.radians(109))
    with pytest.raises(InputError, match="109 degrees"):
        named_section("cap", contact_angle_rad=math.radians(109))
    with pytest.raises(InputError, match=r"contact angle 0 degrees; give 0\.5 to 90"):
        check_contact_angle(0.0)
    with pytest.raises(InputError, match="needs a contact angle"):
        named_section("cap")
    with pytest.raises(InputError, match=r"'ellipse' takes no exponent.*'parabola'"):
        named_section("ellipse", exponent=2.0)
    with pytest.raises(InputError, match="'square' is not known; use one of"):
        named_section("square")
    with pytest.raises(InputError, match="exponent 9 is not from"):
        CrossSection("cosine", 9.0)
    with pytest.raises(InputError, match="reach 2 of a cosine"):
        CrossSection("cosine", reach=2.0)
    assert KINDS[:3] == ("cosine", "parabola", "gaussian"), "kernels and old data sets count on their numbers"
