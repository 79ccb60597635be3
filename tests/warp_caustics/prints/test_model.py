"""Lines on a grid and their derivatives."""

import numpy as np
import pytest
import torch

from warp_caustics.prints.chains import chains_of
from warp_caustics.prints.imperfections import thick_ends
from warp_caustics.prints.line import SECTIONS, line_relief
from warp_caustics.prints.line_shape import Shape, half_height, line_section, section_edge
from warp_caustics.prints.model import LineModel, lines_of, rows_of
from warp_caustics.prints.paths import PrintedPath, path_of_line, paths_relief
from warp_caustics.prints.sections import CrossSection, cap_contact_angle_rad
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=64, image_pixels=64, plate_size_m=(0.05, 0.04))
LINES = 1e-3 * torch.tensor([[-10.0, 3.0, 12.0, -7.0, 2.9, 0.8], [1.0, 2.0, 5.0, 5.0, 1.3, 1.0]], dtype=torch.float64)


@pytest.mark.parametrize("section", SECTIONS)
def test_heights_are_those_of_printed_lines(section):
    expected = line_relief(lines_of(LINES), 64, SCENE.plate_size_m, section=section)
    found = LineModel(SCENE, section).heights(LINES).double().numpy()
    # On the rim of a "quarter" line float32 decides otherwise here and there.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 if section == "cosine" else 2e-5)
    assert np.abs(found - expected).mean() < 1e-9 * 64


@pytest.mark.parametrize("section", SECTIONS)
@pytest.mark.parametrize("number", range(6))
def test_derivatives(section, number):
    """Against central differences; the steep rim of a "quarter" line is left out by a wide step's mean."""
    model, step = LineModel(SCENE, section, supersampling=8), torch.zeros_like(LINES)
    step[:, number] = 2e-6
    derivative = model.parts(LINES)[1][:, number]
    difference = (model.parts(LINES + step)[0] - model.parts(LINES - step)[0]) / 4e-6
    assert difference.norm() > 0.1
    # The rim of a quarter profile is a kink: at any one of 8^2 points the difference quotient may be half right.
    assert (difference - derivative).norm() <= (2e-3 if section == "cosine" else 0.25) * difference.norm()


THICK = Shape(1.0, 0.0, 1.0, 0.3, 2e-3)


def printed_with_thick_ends(lines: torch.Tensor, shape: Shape) -> np.ndarray:
    """Relief [m] of lines [L, 6] as prints have it, in double precision: paths of many points, straight between."""
    known = lines_of(lines)
    ends = [np.array([line.start_m, line.end_m]) for line in known]
    chains = chains_of(ends, [line.width_m for line in known], [line.height_m for line in known])
    chains = thick_ends(chains, np.full(len(lines), shape.thicker), np.full(len(lines), shape.end_m))
    last = np.append(chains.first[1:], len(chains.points_m))
    paths = [
        PrintedPath(chains.points_m[a:b], chains.widths_m[a:b], chains.heights_m[a:b])
        for a, b in zip(chains.first, last, strict=True)
    ]
    return paths_relief(paths, 64, SCENE.plate_size_m)


@pytest.mark.parametrize(("widths", "end_m"), [(1.0, 2e-3), (3.0, 2e-3), (3.0, 7e-4)])
def test_thicker_ends_are_those_that_are_printed(widths, end_m):
    """Beside a line, too, where what swells nearer to the end is higher than the section of the nearest part."""
    model, lines, shape = LineModel(SCENE), LINES.clone(), THICK._replace(end_m=end_m)
    lines[:, 4] *= widths
    plain = model.heights(lines).double().numpy()
    model.shape = shape
    found, expected = model.heights(lines).double().numpy(), printed_with_thick_ends(lines, shape)
    thicker = np.linalg.norm(plain - expected)
    assert thicker > 0.03 * np.linalg.norm(plain), "as these lines are without"
    assert np.linalg.norm(found - expected) < 1e-3 * thicker


def test_thicker_ends_of_a_short_line():
    """Whose ends reach beyond its middle, where points of both stand between each other."""
    model, shape = LineModel(SCENE), THICK._replace(end_m=2e-3)
    lines = 1e-3 * torch.tensor([[-1.5, 0.3, 1.2, 0.1, 3.0, 0.8]], dtype=torch.float64)
    model.shape = shape
    found, expected = model.heights(lines).double().numpy(), printed_with_thick_ends(lines, shape)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("number", range(6))
def test_derivatives_with_thicker_ends(number):
    """Ends that move take their thicker places along, and turn with the line."""
    model, step = LineModel(SCENE, supersampling=8), torch.zeros_like(LINES)
    model.shape = THICK
    step[:, number] = 2e-6
    derivative = model.parts(LINES)[1][:, number]
    difference = (model.parts(LINES + step)[0] - model.parts(LINES - step)[0]) / 4e-6
    assert (difference - derivative).norm() <= 4e-3 * difference.norm()


@pytest.mark.parametrize("proportion", [0.05, 0.2, 0.35, 0.45])
def test_caps_are_circles(proportion):
    """Of 11 to 84 degrees: the cap of a line's own width and height, against that of prints."""
    lines = LINES.clone()
    lines[:, 5] = proportion * lines[:, 4]
    section = CrossSection("cap", contact_angle_rad=cap_contact_angle_rad(1.0, proportion))
    paths = [path_of_line(line, section) for line in lines_of(lines)]
    model = LineModel(SCENE)
    model.shape = Shape(is_cap=True)
    expected = paths_relief(paths, 64, SCENE.plate_size_m)
    np.testing.assert_allclose(model.heights(lines), expected, atol=2e-3 * float(lines[:, 5].max()) * proportion)


def test_flat_caps_merge():
    """Nowhere below the plate, so that powers of their heights are numbers: 10 um on 4 mm are a circle of 0.4 m."""
    lines = LINES.clone()
    lines[:, 4], lines[:, 5] = 4e-3, torch.tensor([1e-5, 2e-4])
    model = LineModel(SCENE)
    for overlap in (0.0, 0.35, 1.0):
        model.shape = Shape(1.0, 1.0, overlap, is_cap=True)
        assert float(model.parts(lines)[0].min()) >= 0
        relief, derivatives = model.with_jacobian(lines)
        assert torch.isfinite(relief).all() and torch.isfinite(derivatives).all()


@pytest.mark.parametrize(("proportion", "points", "exact"), [(0.2, 16, 6e-3), (0.4, 16, 2e-2), (0.6, 32, 0.06)])
@pytest.mark.parametrize("number", range(6))
def test_derivatives_of_caps(proportion, points, exact, number):
    """With thicker ends; the steeper their edge, the more a difference of few points errs there."""
    lines, step = LINES.clone(), torch.zeros_like(LINES)
    lines[:, 5] = proportion * lines[:, 4]
    model = LineModel(SCENE, supersampling=points)
    model.shape = Shape(1.0, 1.0, 1.0, 0.3, 2e-3, is_cap=True)
    step[:, number] = 4e-6
    derivative = model.parts(lines)[1][:, number]
    difference = (model.parts(lines + step)[0] - model.parts(lines - step)[0]) / 8e-6
    assert (difference - derivative).norm() <= exact * difference.norm()


@pytest.mark.parametrize("count", [1, 2, 15])
def test_heights_alone_are_those_beside_derivatives(count):
    """However many cores share the lines."""
    model, lines = LineModel(SCENE), LINES.repeat(8, 1)[:count]
    heights, derivatives = model.parts(lines)
    assert torch.equal(model.each(lines), heights) and all(each.any() for each in derivatives)


def test_no_lines():
    model = LineModel(SCENE)
    assert model.each(torch.zeros(0, 6, dtype=torch.float64)).shape == (0, 64, 64)
    heights, derivatives = model.parts(torch.zeros(0, 6, dtype=torch.float64))
    assert heights.shape == (0, 64, 64) and derivatives.shape == (0, 6, 64, 64)
    assert not model.heights(torch.zeros(0, 6, dtype=torch.float64)).any()


def test_limits():
    wild = 1e-3 * torch.tensor([[100.0, -100.0, 0.0, 0.0, 9.0, -1.0]], dtype=torch.float64)
    clamped = LineModel(SCENE).clamped(wild)[0]
    assert clamped.tolist() == pytest.approx([0.027, -0.0216, 0.0, 0.0, 4.5e-3, 1e-5])


def test_round_drops_may_be_wider_than_lines():
    """By as much less as they are long: between a drop and a line nothing jumps."""
    lengths = np.array([0.0, 0.5, 1.5, 2.0, 30.0])
    wild = 1e-3 * torch.tensor([[0.0, 0.0, length, 0.0, 90.0, 1.0] for length in lengths], dtype=torch.float64)
    expected = [6.5e-3, 6e-3, 5e-3, 4.5e-3, 4.5e-3]
    model = LineModel(SCENE)
    np.testing.assert_allclose(model.clamped(wild)[:, 4], expected, rtol=1e-12)
    assert torch.equal(model.clamped(wild.expand(3, 5, 6)), model.clamped(wild).expand(3, 5, 6)), "several versions"
    np.testing.assert_allclose(model.limits_of(wild)[1].reshape(-1, 6)[:, 4], expected, rtol=1e-12)


def test_the_widest_line_is_told_by_its_width_at_half_its_height():
    """A Gaussian is wide at its foot, and may be 1.2 times as wide at half its height as a cosine; an ellipse, which is
    wide there, may be as wide as a cosine at its foot."""
    wild = 1e-3 * torch.tensor([[0.0, 0.0, 5.0, 0.0, 90.0, 1.0]], dtype=torch.float64)
    model = LineModel(SCENE)
    for shape, at_half in ((Shape(64.0, 0.3), 1.2 * 2.25e-3), (Shape(), 2.25e-3)):
        model.shape = shape
        assert float(model.clamped(wild)[0, 4]) * half_height(shape) == pytest.approx(at_half, rel=0.02)
    for shape in (Shape(0.5), Shape(0.5, 1.0)):
        model.shape = shape
        assert float(model.clamped(wild)[0, 4]) == pytest.approx(4.5e-3)


@pytest.mark.parametrize(
    "shape",
    [Shape(1.0, 0.5), Shape(2.0), Shape(16.0, 1.0), Shape(64.0, 0.3), Shape(6.0, cut=0.06), Shape(0.8, 0.3, cut=0.2)],
)
def test_a_section_ends_where_it_has_faded(shape):
    edge = section_edge(shape)
    beyond = np.linspace(edge, 1, 50)
    assert line_section(shape, beyond).max() <= 1.01e-6 and 0.2 < edge <= 1
    model = LineModel(SCENE)
    model.shape = shape
    line = LINES[:1].clone()
    line[0, 4] /= 2 * half_height(shape)
    faded = model.heights(line)
    columns, rows = (
        ((np.arange(4 * 64) + 0.5) / (4 * 64) - 0.5).reshape(axes) * size
        for axes, size in zip(((1, 1, 64, 4), (64, 4, 1, 1)), SCENE.plate_size_m, strict=True)
    )
    start, along = line[0, :2].numpy(), (line[0, 2:4] - line[0, :2]).numpy()
    share = np.clip(((columns - start[0]) * along[0] + (rows - start[1]) * along[1]) / (along @ along), 0, 1)
    gap = np.hypot(columns - start[0] - share * along[0], rows - start[1] - share * along[1])
    relief = float(line[0, 5]) * line_section(shape, 2 * gap / float(line[0, 4])).mean(axis=(1, 3))
    np.testing.assert_allclose(faded, relief, atol=2e-8)


def test_a_step_goes_as_far_as_derivatives_tell_and_the_limits_allow():
    model = LineModel(SCENE)
    far = model.moved(LINES, torch.full((LINES.numel(),), -1.0, dtype=torch.float64))
    np.testing.assert_allclose(far[0] - LINES[0], [-1.5e-3] * 4 + [-5e-4, -4e-4])
    assert float(model.moved(far, torch.full((LINES.numel(),), -1.0, dtype=torch.float64))[1, 4]) > 0


def test_rows_are_lines():
    assert torch.equal(rows_of(lines_of(LINES)), LINES) and rows_of([]).shape == (0, 6)
    relief, jacobian = LineModel(SCENE).with_jacobian(LINES)
    assert relief.shape == (64, 64) and jacobian.shape == (12, 64, 64)


@pytest.mark.parametrize("overlap", [1.0, 0.4, 0.0])
def test_reliefs_without_some_of_the_lines(overlap):
    """Of pairs, of one each, and of none that are asked for; of no lines at all."""
    model = LineModel(Scene(height_samples=24, image_pixels=24))
    model.shape = Shape(overlap=overlap)
    ends = [(-0.01, 0.0, 0.012, 0.003), (0.0, -0.01, 0.002, 0.01), (-0.008, 0.008, 0.01, -0.006)]
    parts = model.parts(torch.tensor([[*each, 3e-3, 4e-4] for each in ends], dtype=torch.float64))[0]
    found = model.without(parts, [(0, 2), (1, 0)])
    torch.testing.assert_close(found, parts[[1, 2]], rtol=0, atol=1e-9)
    expected = [model.joined(parts[[k for k in range(3) if k != gone]]) for gone in range(3)]
    torch.testing.assert_close(model.without_each(parts), torch.stack(expected), rtol=0, atol=1e-9)
    assert model.without(parts, []).shape == model.without_each(parts[:0]).shape == (0, 24, 24)
