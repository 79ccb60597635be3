"""Designs in files: every shape and size against what is built by hand, old lists unchanged, errors with their place."""

import math
from pathlib import Path

import numpy as np
import pytest

from warp_caustics.errors import InputError
from warp_caustics.inspection.nominal import read_nominal
from warp_caustics.prints.curves import bezier_points, meander_points, ring_points
from warp_caustics.prints.design_file import SHAPES, design_relief, is_design, read_design
from warp_caustics.prints.fibre import cap_of_area, fibre_area_m2
from warp_caustics.prints.font import text_lines
from warp_caustics.prints.line import line_relief
from warp_caustics.prints.line_list import read_lines
from warp_caustics.prints.paths import MAX, SUM, paths_relief, uniform_path
from warp_caustics.prints.relief_file import read_relief
from warp_caustics.prints.sections import named_section
from warp_caustics.scene import Scene

PLATE = (0.05, 0.05)
EXAMPLES = Path(__file__).parents[3] / "examples"
LINE = "start_x_mm: -10, start_y_mm: 0, end_x_mm: 10, end_y_mm: 5"
SIZE = "width_mm: 2, height_um: 300"


def write(tmp_path, text, name="design.yaml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def design(tmp_path, text):
    return read_design(write(tmp_path, text))


def line(tmp_path, text):
    (path,) = design(tmp_path, f"lines:\n- {{{LINE}, {text}}}\n").paths
    return path


POINTS = np.array([[-0.01, 0.0], [0.01, 0.005]])
WRITTEN = {
    "line": (LINE, [POINTS]),
    "polyline": ("points_mm: [[-10, 0], [0, 10], [5, -3]]", [np.array([[-0.01, 0.0], [0.0, 0.01], [5e-3, -3e-3]])]),
    "bezier": (
        "control_um: [[-10000, 0], [0, 20000], [10000, -5000]]",
        [bezier_points(np.array([[-0.01, 0.0], [0.0, 0.02], [0.01, -5e-3]]))],
    ),
    "ring": ("centre_mm: [1, 2], radius_mm: 12", [ring_points((1e-3, 2e-3), 0.012)]),
    "drop": ("centre_m: [0.001, 0.002]", [np.array([[1e-3, 2e-3]])]),
    "meander": (
        "length_mm: 20, spacing_mm: 3, rows: 4, angle_deg: 30, centre_mm: [1, 0]",
        [meander_points((1e-3, 0.0), 0.02, 3e-3, 4, math.pi / 6)],
    ),
    "text": ("text: A1, cap_height_mm: 9, angle_deg: 10", text_lines("A1", 9e-3, (0.0, 0.0), math.radians(10))),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_every_shape(tmp_path, shape):
    words, lines = WRITTEN[shape]
    file = write(tmp_path, f"lines:\n- {{shape: {shape}, {words}, {SIZE}}}\n")
    found = read_relief(file, 64, PLATE, "design")
    expected = paths_relief([uniform_path(points, 2e-3, 3e-4) for points in lines], 64, PLATE)
    np.testing.assert_allclose(found, expected, atol=1e-15)
    assert expected.max() > 1.5e-4


@pytest.mark.parametrize(
    ("text", "section", "width", "height"),
    [
        (SIZE, named_section("cosine"), 2e-3, 3e-4),
        (f"{SIZE}, section: quarter", named_section("quarter"), 2e-3, 3e-4),
        (f"{SIZE}, section: parabola, exponent: 1.4", named_section("parabola", exponent=1.4), 2e-3, 3e-4),
        (f"{SIZE}, section: gaussian, reach: 1.5", named_section("gaussian", reach=1.5), 2e-3, 3e-4),
        ("width_mm: 2, contact_angle_deg: 60", named_section("cap", contact_angle_rad=math.pi / 3), 2e-3, None),
        (f"{SIZE}, section: cap", named_section("cap", contact_angle_rad=2 * math.atan(0.3)), 2e-3, 3e-4),
    ],
)
def test_sections_and_sizes(tmp_path, text, section, width, height):
    path = line(tmp_path, text)
    assert path.section.kind == section.kind and path.section.parameter == pytest.approx(section.parameter)
    assert path.section.reach == section.reach
    height = math.tan(math.pi / 6) / 2 * width if height is None else height
    np.testing.assert_allclose(path.widths_m, width)
    np.testing.assert_allclose(path.heights_m, height)
    np.testing.assert_allclose(path.points_m, POINTS)


@pytest.mark.parametrize("section", ["cap", "cosine", "ellipse", "gaussian"])
@pytest.mark.parametrize("how", ["contact_angle_deg: 50", "width_mm: 1.4"])
def test_fibres(tmp_path, section, how):
    """Three passes of 0.4 mm have their glass, whatever the section and whatever is given of it."""
    path = line(tmp_path, f"fibre_diameter_mm: 0.4, passes: 3, section: {section}, {how}")
    area = path.section.area_m2(path.widths_m[0], path.heights_m[0])
    assert area == pytest.approx(3 * math.pi * 4e-4**2 / 4, rel=1e-9)
    if "width" in how:
        assert path.widths_m[0] == pytest.approx(1.4e-3)
    elif section == "cap":
        width, height = cap_of_area(fibre_area_m2(4e-4, 3), math.radians(50))
        assert (path.widths_m[0], path.heights_m[0]) == pytest.approx((width, height))


def test_settings_are_for_all_lines_and_their_own_words_go_before(tmp_path):
    found = design(
        tmp_path,
        f"fibre_diameter_mm: 0.4\ncontact_angle_deg: 60\npasses: 2\nmerge: max\nlines:\n"
        f"- {{{LINE}}}\n- {{{LINE}, passes: 1}}\n- {{{LINE}, width_mm: 3}}\n- {{{LINE}, section: parabola}}\n",
    )
    first, once, wide, other = found.paths
    assert found.merging == MAX
    assert once.widths_m[0] == pytest.approx(first.widths_m[0] / math.sqrt(2))
    assert wide.widths_m[0] == pytest.approx(3e-3) and wide.section.kind == "cap"
    assert wide.section.contact_angle_rad < first.section.contact_angle_rad == pytest.approx(math.pi / 3)
    assert other.section.kind == "parabola"
    areas = {path.section.area_m2(path.widths_m[0], path.heights_m[0]) for path in (first, wide, other)}
    np.testing.assert_allclose(list(areas), 2 * fibre_area_m2(4e-4), rtol=1e-9)


@pytest.mark.parametrize(("word", "merging"), [("sum", SUM), ("max", MAX), ("4", 4.0), ("2.5", 2.5)])
def test_overlaps(tmp_path, word, merging):
    text = f"merge: {word}\nlines:\n- {{{LINE}, {SIZE}}}\n- {{shape: ring, centre_mm: [0, 0], radius_mm: 8, {SIZE}}}\n"
    found = design(tmp_path, text)
    assert found.merging == merging
    np.testing.assert_array_equal(
        design_relief(found, 32, PLATE), paths_relief(found.paths, 32, PLATE, merging=merging)
    )


def test_waves_and_ends_are_the_seeds(tmp_path):
    """The same file twice is the same print, another seed another one; both within what is asked for."""
    text = f"seed: %d\nlines:\n- {{{LINE}, {SIZE}, waviness: 0.1, sideways_um: 50, end_thickness: 0.3}}\n"
    one, again, other = (design(tmp_path, text % seed).paths[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.widths_m, again.widths_m)
    assert len(one.widths_m) == len(other.widths_m) and np.abs(one.widths_m - other.widths_m).max() > 1e-5
    assert one.widths_m.min() >= 0.9 * 2e-3 and one.widths_m.max() <= 1.1 * 1.3 * 2e-3
    np.testing.assert_allclose(one.heights_m / one.widths_m, 0.15)


def test_the_base(tmp_path):
    """A bowl with the sag that it says at the middle of a side, and a wave across it."""
    text = f"bow_um: 20\nbase_wave_um: 3\nbase_wavelength_mm: 25\nbase_wave_angle_deg: 90\nlines:\n- {{{LINE}, {SIZE}}}"
    found = design(tmp_path, text)
    bare = design_relief(found, 100, PLATE) - paths_relief(found.paths, 100, PLATE)
    centres = ((np.arange(100) + 0.5) / 100 - 0.5) * 0.05
    y, x = np.meshgrid(centres, centres, indexing="ij")
    wave = 3e-6 * np.sin(2 * np.pi * y / 0.025)
    np.testing.assert_allclose(bare, 20e-6 * (x**2 + y**2) / 0.025**2 + wave, atol=1e-12)


def test_csv_with_sections(tmp_path):
    """Empty cells take the defaults."""
    names = "start_x_mm,start_y_mm,end_x_mm,end_y_mm,width_mm,height_um,section,contact_angle_deg"
    file = write(tmp_path, f"{names}\n-10,0,10,5,2,300,quarter,\n-10,0,10,5,2,,cap,45\n-10,0,10,5,2,300,,\n", "a.csv")
    quarter, cap, plain = read_design(file).paths
    assert quarter.section == named_section("quarter") and plain.section == named_section("cosine")
    assert cap.section.foot_angle_rad(cap.widths_m[0], cap.heights_m[0]) == pytest.approx(math.pi / 4)


def test_old_lists_are_what_they_were(tmp_path):
    """To the bit, and as lines; a design is none to those who need lines."""
    file = EXAMPLES / "data" / "printed_lines.csv"
    assert not is_design(file)
    np.testing.assert_array_equal(read_relief(file, 64, PLATE, "x"), line_relief(read_lines(file), 64, PLATE))
    old = write(tmp_path, f"lines:\n- {{{LINE}, {SIZE}}}\n")
    assert not is_design(old) and len(read_lines(old)) == 1
    np.testing.assert_allclose(
        design_relief(read_design(old), 64, PLATE), line_relief(read_lines(old), 64, PLATE), atol=1e-15
    )
    for text, word in (
        (f"merge: max\nlines:\n- {{{LINE}, {SIZE}}}\n", "merge"),
        (f"- {{{LINE}, passes: 2}}", "passes"),
    ):
        file = write(tmp_path, text)
        assert is_design(file)
        with pytest.raises(InputError, match=f"is a design with '{word}'"):
            read_lines(file)


@pytest.mark.parametrize("name", ["fibre", "shapes"])
def test_example_designs(name):
    """They are read, print within the plate's reach, and inspection compares with them as maps."""
    file = EXAMPLES / "designs" / f"{name}.yaml"
    relief = read_relief(file, 64, PLATE, "design")
    assert 2e-4 < relief.max() < 1e-3 and relief.min() > -1e-5
    nominal = read_nominal(str(file), Scene(height_samples=64, image_pixels=64))
    assert not nominal.lines and "compared as a map" in nominal.origin
    np.testing.assert_array_equal(nominal.relief_m, relief)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"- {{{LINE}, width_mm: 1, contact_angle_deg: 109}}", "line 1: contact angle 109 degrees is above 90"),
        (
            f"- {{{LINE}, fibre_diameter_mm: 0.4, width_mm: 0.3}}",
            "a contact angle of 134.4 degrees: it overhangs and is no height field; make it at least 0.566 mm wide",
        ),
        (f"- {{{LINE}, {SIZE}, section: cap}}\n- {{{LINE}, width_mm: 1, height_mm: 0.6, section: cap}}",
         "line 2: a cap 1 mm wide and 0.6 mm high has a contact angle of 100.4 degrees"),
        (f"- {{{LINE}, fibre_diameter_mm: 0.4}}", "by one of contact angle and width; give contact_angle_deg: 60"),
        (f"- {{{LINE}, fibre_diameter_mm: 0.4, width_mm: 1, height_mm: 1}}", "by one of contact angle and width"),
        (f"- {{{LINE}, {SIZE}, passes: 2}}", "2 passes of a line whose width and height are given"),
        (f"- {{{LINE}, {SIZE}, contact_angle_deg: 60, section: cosine}}", "made of no fibre; leave it out"),
        (f"- {{{LINE}, width_mm: 1, passes: 1}}", "needs a width and a height, or a fibre_diameter"),
        (f"- {{{LINE}, {SIZE}, section: square}}", "section 'square' is not known"),
        (f"- {{shape: spiral, {SIZE}}}", "shape 'spiral' is not known; use one of line, polyline"),
        (f"- {{shape: ring, {SIZE}, radius_mm: 3}}", "ring needs centre; give each with its unit"),
        (f"- {{shape: ring, {SIZE}, radius_mm: 0, centre_mm: [0, 0]}}", "ring of radius 0 mm"),
        (f"- {{shape: ring, {SIZE}, radius_mm: 3, centre_mm: [0, 0], rows: 3}}", "'rows' is not known here"),
        (f"- {{shape: drop, {SIZE}, center_mm: [0, 0]}}", "did you mean 'centre_mm'?"),
        (f"- {{shape: drop, {SIZE}, centre_mm: 3}}", "which is no point; write [x, y]"),
        (f"- {{shape: polyline, {SIZE}, points_mm: 3}}", "is no list of points; write [[0, 0], [10, 5]]"),
        (f"- {{shape: polyline, {SIZE}, points_mm: [[0, a]]}}", "points_mm is 'a', not a finite number"),
        (f"- {{shape: drop, {SIZE}, centre_m: [5, 0]}}", "above 1 m; check the units"),
        (f"- {{shape: text, {SIZE}, cap_height_mm: 5, text: abc}}", "'a', which the stroke font does not have"),
        (f"- {{shape: meander, {SIZE}, length_mm: 5, spacing_mm: 1, rows: 2.5}}", "rows is 2.5; give a whole number"),
        (f"- {{{LINE}, {SIZE}, waviness: 2}}", "waviness 2 of the line; give 0 to 0.9"),
        (f"- {{{LINE}, {SIZE}, waviness: 0.1, wavelength_um: 1}}", "wavelength of 0.001 mm; give at least 0.1 mm"),
        (
            f"- {{shape: polyline, points_mm: {[[-900 + 1800 * (k % 2), k] for k in range(800)]}, {SIZE}, "
            "waviness: 0.1, wavelength_mm: 0.1}",
            "1.44e+07 waves along one line; give a longer wavelength",
        ),
        (f"- {{shape: ring, centre_mm: [0, 0], radius_mm: 900, {SIZE}}}\n" * 100, "more than 200000 straight pieces"),
        (f"- {{{LINE}, {SIZE}, width_um: 3, passes: 1}}", "width is given twice; keep one unit"),
        (f"- {{{LINE}, width_mm: 0, height_mm: 1, section: cosine}}", "width 0 mm; a printed line needs one above 0"),
        (f"merge: mean\nlines:\n- {{{LINE}, {SIZE}}}", "merge is 'mean'; use sum, max, or a power from 1 to 100"),
        (f"merge: 0.5\nlines:\n- {{{LINE}, {SIZE}}}", "merge is '0.5'"),
        (f"base_wave_um: 3\nlines:\n- {{{LINE}, {SIZE}}}", "give base_wavelength_mm: 20"),
        (f"bow_mm: 5\nlines:\n- {{{LINE}, {SIZE}}}", "bow of 5 mm; give at most 1 mm"),
        (f"colour: red\nlines:\n- {{{LINE}, {SIZE}}}", "'colour' is not known here"),
    ],
)  # fmt: skip
def test_errors_name_the_place_and_the_mend(tmp_path, text, message):
    file = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_design(file)
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert str(caught.value).count("design.yaml") == 1


def test_the_example_of_the_page_is_read(tmp_path):
    """docs/prints.md: six passes, a meander and five letters."""
    page = (EXAMPLES.parent / "docs" / "prints.md").read_text(encoding="utf-8")
    found = design(tmp_path, page.split("```yaml\n")[1].split("```")[0])
    assert len(found.paths) >= 7 and found.merging == MAX
    assert 3e-4 < design_relief(found, 64, PLATE).max() < 1e-3
