"""The section of lines found with them, on a small scene."""

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.descent_numbers import (
    ENDS,
    DescentNumbers,
    by_shape,
    numbers_of,
    reshaped,
    shape_of,
    share_of,
)
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.search.line_search import LineSearch
from nets.reconstruct.fibres.search.section import NEARLY_HIGHEST, is_in_vain, with_caps, with_section_found
from tests.nets.reconstruct.exact_light import light_of
from warp_caustics.prints.line_shape import SHAPE_LIMITS, Shape, half_height, line_section
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

N = 48
SCENE = Scene(height_samples=N, image_pixels=4 * N, wavelengths_m=(610e-9, 430e-9), radiosity_W_m2=(1.0, 1.0))
LINES = 1e-3 * torch.tensor(
    [[-15.0, -12.0, 14.0, 9.0, 4.0, 0.7], [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9]], dtype=torch.float64
)
OFF = 1e-3 * torch.tensor([0.1, -0.1, -0.1, 0.1, 0.2, -0.05], dtype=torch.float64)


def model_of(*shape):
    model = LineModel(SCENE)
    model.shape = Shape(*shape)
    return model


def seen(*shape):
    """With 0.5 % noise."""
    simulated = light_of(SCENE, model_of(*shape).heights(LINES)).numpy()
    noise = np.random.default_rng(0).standard_normal(simulated.shape)
    return CausticImage((simulated + 0.005 * noise).astype(np.float32), np.full(2, 0.005))


@pytest.mark.parametrize("shape", [Shape(0.35), Shape(0.5), Shape(1.0), Shape(2.0), Shape(1.0, 1.0), Shape(0.6, 0.5)])
def test_width_at_half_the_height(shape):
    assert float(line_section(shape, np.array(half_height(shape)))) == pytest.approx(0.5, abs=1e-10)
    wider = reshaped(LINES, Shape(1.0), shape)
    np.testing.assert_allclose(wider[:, 4] * half_height(shape), LINES[:, 4] / 2)
    assert torch.equal(wider[:, [0, 1, 2, 3, 5]], LINES[:, [0, 1, 2, 3, 5]])


def section_across(model):
    """Heights of a line along x across the whole plate [m], shape [N], and t of the samples; and the line."""
    line = LINES[:1].clone()
    line[0, :4] = torch.tensor([-1e-1, 1e-3, 1e-1, 1e-3])
    y = (np.arange(N) + 0.5) / N * SCENE.plate_size_m[1] - SCENE.plate_size_m[1] / 2
    return line, np.abs(y - 1e-3) * 2 / float(line[0, 4])


@pytest.mark.parametrize("shape", [Shape(1.0), Shape(0.6), Shape(1.0, 1.0), Shape(0.5, 1.0), Shape(1.3, 0.4)])
def test_lines_have_the_section_of_the_oracle(shape):
    model = LineModel(SCENE, supersampling=1)
    model.shape = shape
    line, t = section_across(model)
    column = model.heights(line)[:, N // 2].double().numpy()
    np.testing.assert_allclose(column, float(line[0, 5]) * line_section(shape, t), atol=2e-6)


@pytest.mark.parametrize("shape", [Shape(0.6), Shape(1.0), Shape(1.7), Shape(1.0, 0.3)])
def test_derivatives_by_the_section(shape):
    """Against differences of the oracle, of a section that a cell's mean hardly changes."""
    model = LineModel(SCENE, supersampling=1)
    model.shape = shape
    line, t = section_across(model)
    found = by_shape(model, line)[:, :, N // 2].double().numpy()
    numbers, height = numbers_of(shape), float(line[0, 5])

    def section(number, value):
        """As wide at half its height as the model's."""
        other = shape_of([*numbers[:number], value, *numbers[number + 1 :]])
        return height * line_section(other, t * half_height(other) / half_height(shape))

    for number, step in ((0, 1e-4), (1, 0.02)):
        low, high = max(numbers[number] - step, 0.0), numbers[number] + step
        expected = (section(number, high) - section(number, low)) / (high - low)
        np.testing.assert_allclose(found[number], expected, atol=5e-3 * np.abs(expected).max())
    assert model.shape == shape


@pytest.mark.parametrize("shape", [Shape(0.5), Shape(1.7, 0.3, 0.6), Shape(8.0, 0.2), Shape(0.5, 1.0)])
@pytest.mark.parametrize("with_section", [False, True])
def test_numbers_of_a_descent_and_back(shape, with_section):
    model = model_of(*shape)
    numbers = DescentNumbers(model, len(LINES), with_section)
    at = numbers.of(LINES, shape)
    assert at.shape == (numbers.size,) == (12 + 3 * with_section,)
    torch.testing.assert_close(numbers.put(at), LINES)
    np.testing.assert_allclose(model.shape, shape, rtol=1e-12)
    low, high = numbers.ends(at)
    assert (low <= at + 1e-12).all() and (at <= high + 1e-12).all() and (low < high).all()
    np.testing.assert_allclose(model.shape, shape, rtol=1e-12)


def test_a_section_moves_lines_that_stay_as_wide_at_half_their_height():
    model = model_of(1.0)
    numbers = DescentNumbers(model, len(LINES), True)
    at = numbers.of(LINES, Shape())
    at[12] = share_of(16.0)
    wide = numbers.put(at)
    assert model.shape.exponent == pytest.approx(16.0)
    torch.testing.assert_close(wide, reshaped(LINES, Shape(), model.shape))
    at[12] = 1.2
    numbers.put(at)
    assert model.shape.exponent == SHAPE_LIMITS[1].exponent, "a Gaussian, nearly"
    low, high = numbers.ends(at)
    assert at[12] > high[12] and low[12] == share_of(SHAPE_LIMITS[0].exponent)


@pytest.mark.parametrize("number", [4, 10, 12, 13, 14])
@pytest.mark.parametrize("shape", [Shape(1.7, 0.3, 0.6), Shape(8.0, 0.2, 0.5)])
def test_derivatives_by_the_numbers_of_a_descent(shape, number):
    model = LineModel(SCENE, supersampling=8)
    model.shape = shape
    numbers = DescentNumbers(model, len(LINES), True)
    at, by_line = numbers.of(LINES, shape), model.with_jacobian(LINES)[1]
    found = numbers.derivatives(LINES, by_line)[number]
    step, ends = (2e-6 if number < 12 else 0.00125 if number == 12 else 0.02), []
    for sign in (-1, 1):
        moved = at.copy()
        moved[number] += sign * step
        ends.append(model.heights(numbers.put(moved)))
    difference = (ends[1] - ends[0]) / (2 * step)
    assert float((found - difference).norm()) < 0.01 * float(difference.norm())


def test_a_gaussian_is_found_from_a_cosine():
    """A section that the family has as its limit only: within 0.2 % of the crowns."""
    model, widths = LineModel(SCENE), LINES[:, 4] / 2
    truth = gaussian_lines(LINES, widths)
    simulated = light_of(SCENE, truth).numpy()
    noise = np.random.default_rng(0).standard_normal(simulated.shape)
    image = CausticImage((simulated + 0.005 * noise).astype(np.float32), np.full(2, 0.005))
    fit = ImageFit(SCENE, image, model, 2 * N)
    found = fit.descend(LINES + OFF / 2, 60, with_section=True)
    assert model.shape.exponent > 8
    assert 1e6 * float((model.heights(found.lines) - truth).square().mean().sqrt()) < 1.0


def gaussian_lines(lines, widths_m):
    """Relief [m], shape [N, N], of lines whose section is a Gaussian, as wide at half its height as told [m]."""
    fine = 4
    at = [((np.arange(fine * N) + 0.5) / (fine * N) - 0.5) * size for size in SCENE.plate_size_m]
    relief = np.zeros((fine * N, fine * N))
    for row, width in zip(lines.numpy(), widths_m.numpy(), strict=True):
        start, along = row[:2], row[2:4] - row[:2]
        x, y = at[0][None, :] - start[0], at[1][:, None] - start[1]
        share = np.clip((x * along[0] + y * along[1]) / (along @ along), 0, 1)
        squared = (x - share * along[0]) ** 2 + (y - share * along[1]) ** 2
        relief += row[5] * np.exp(-4 * np.log(2) * squared / width**2)
    return torch.from_numpy(relief.reshape(N, fine, N, fine).mean((1, 3)).astype(np.float32))


@pytest.mark.parametrize("shape", [Shape(0.7), Shape(1.6), Shape(1.0, 1.0), Shape(0.8, 0.5)])
@pytest.mark.parametrize("number", range(6))
def test_derivatives_of_lines_of_any_section(shape, number):
    model, step = LineModel(SCENE, supersampling=8), torch.zeros(6, dtype=torch.float64)
    model.shape = shape
    step[number] = 2e-6
    derivative = model.parts(LINES)[1][:, number]
    difference = (model.parts(LINES + step)[0] - model.parts(LINES - step)[0]) / 4e-6
    scale = difference.abs().amax()
    assert float((derivative - difference).abs().mean()) < 0.01 * float(scale)


@pytest.mark.parametrize("shape", [Shape(0.5, 1.0), Shape(0.35), Shape(0.5, 0.5)])
@pytest.mark.parametrize("number", range(5))
def test_derivatives_where_the_edge_of_a_line_is_steep(shape, number):
    """Against differences of means over finely sampled cells: bounded, though the slope at the edge is not."""
    model, fine, step = LineModel(SCENE), LineModel(SCENE, supersampling=32), torch.zeros(6, dtype=torch.float64)
    model.shape = fine.shape = shape
    step[number] = 5e-5
    difference = (fine.parts(LINES + step)[0] - fine.parts(LINES - step)[0]) / 1e-4
    derivative = model.parts(LINES)[1][:, number]
    scale = difference.abs().amax()
    assert float((derivative - difference).abs().amax()) < 0.35 * float(scale)
    assert float((derivative - difference).abs().mean()) < 0.015 * float(scale)


def test_where_lines_cross_the_highest_is_printed():
    """At each point of a cell: more than the higher of two means where they cross, and that where one line is alone."""
    model = model_of(1.0, 0.0, 0.0)
    parts = model.parts(LINES)[0]
    relief, jacobian = model.with_jacobian(LINES)
    highest = parts.amax(dim=0)
    alone = (parts > 0).sum(dim=0) < 2
    torch.testing.assert_close(relief[alone], highest[alone], rtol=0, atol=1e-9)
    assert bool((relief >= highest - 1e-9).all()) and float((relief - highest).amax()) > 1e-5
    assert torch.equal(model.without_each(parts), parts.flip(0))
    lower = parts[0] < parts[1] - 4e-4
    assert bool(lower.any()) and bool((jacobian[:6, lower] == 0).all()) and bool((jacobian[5, ~lower] > 0).any())


@pytest.mark.parametrize("shape", [Shape(0.5), Shape(1.0), Shape(1.6), Shape(1.0, 1.0)])
def test_the_section_is_found_with_the_lines(shape):
    model, truth = LineModel(SCENE), model_of(*shape).heights(LINES)
    search = LineSearch(SCENE, seen(*shape), model, 2 * N, jumps=0, finds_section=True)
    found = search.run(reshaped(LINES + OFF, shape, Shape(1.0)))
    t = np.linspace(0, half_height(shape), 20)
    same = model.shape._replace(exponent=model.shape.exponent)
    across = line_section(same, t * half_height(same) / half_height(shape))
    np.testing.assert_allclose(across, line_section(shape, t), atol=0.02)
    assert 1e6 * float((model.heights(found) - truth).square().mean().sqrt()) < 2.5


def test_a_section_that_the_relief_told_moves_with_the_lines():
    """Squashed crowns: nearest of all that are tried is a quarter cosine, and not exact."""
    model, shape = model_of(0.5), Shape(0.6)
    search = LineSearch(SCENE, seen(*shape), model, 2 * N, jumps=0, finds_section=True, moves_section=True)
    search.run(reshaped(LINES + OFF, shape, Shape(0.5)))
    assert search.moves_section
    assert model.shape.exponent == pytest.approx(0.6, abs=0.02)


def test_a_section_between_those_that_are_tried_is_found(monkeypatch):
    """None of those tells the image better than the usual one; a descent goes there by itself."""
    monkeypatch.setattr("nets.reconstruct.fibres.search.section.TRIED_SHAPES", ())
    model, shape = LineModel(SCENE), Shape(0.75)
    fit = ImageFit(SCENE, seen(*shape), model, 2 * N)
    _, has_moved = with_section_found(fit, reshaped(LINES, shape, Shape(1.0)))
    assert has_moved and model.shape.exponent == pytest.approx(0.75, abs=0.03)


def test_a_cosine_stays_one_where_it_is_the_section():
    model = LineModel(SCENE)
    LineSearch(SCENE, seen(1.0), model, 2 * N, jumps=0, finds_section=True).run(LINES + OFF)
    assert model.shape == Shape(1.0)


@pytest.mark.parametrize(("overlap", "tolerance"), [(0.0, 0.05), (0.12, 0.05), (0.3, 0.05), (0.6, 0.05)])
def test_what_is_printed_where_lines_cross_is_found(overlap, tolerance):
    """The highest, or lines that merge: of powers 8.3, 3.3 and 1.7."""
    model, truth = LineModel(SCENE), model_of(1.0, 0.0, overlap).heights(LINES)
    search = LineSearch(SCENE, seen(1.0, 0.0, overlap), model, 2 * N, jumps=0, finds_section=True)
    found = search.run(LINES + OFF)
    assert model.shape.overlap == pytest.approx(overlap, abs=tolerance)
    assert 1e6 * float((model.heights(found) - truth).square().mean().sqrt()) < 2.5


@pytest.mark.parametrize("overlap", [0.0, 0.15])
def test_lines_of_which_nearly_the_highest_is_printed_are_told_from_others(overlap):
    """From there descents go either way; what is printed of q = 0 and of 0.034 are the same to noise."""
    model, truth = model_of(1.0, 0.0, NEARLY_HIGHEST), model_of(1.0, 0.0, overlap).heights(LINES)
    fit = ImageFit(SCENE, seen(1.0, 0.0, overlap), model, 2 * N)
    lines, _ = with_section_found(fit, LINES, moves=True)
    assert model.shape.overlap == pytest.approx(overlap, abs=0.04)
    assert 1e6 * float((model.heights(lines) - truth).square().mean().sqrt()) < 1.0
    assert fit.loss(model.heights(lines)) <= fit.loss(truth)


def test_thicker_ends_are_found():
    """Beside a section of its own; lines whose ends are no thicker are not given any."""
    truth = Shape(1.3, 0.0, 1.0, 0.35, 1.6e-3)
    model, heights = LineModel(SCENE), model_of(*truth).heights(LINES)
    found = LineSearch(SCENE, seen(*truth), model, 2 * N, jumps=0, finds_section=True).run(LINES + OFF)
    assert model.shape.thicker == pytest.approx(truth.thicker, abs=0.05)
    assert model.shape.end_m == pytest.approx(truth.end_m, rel=0.2)
    assert 1e6 * float((model.heights(found) - heights).square().mean().sqrt()) < 2.5


@pytest.mark.parametrize(
    ("printed", "is_cap"), [(Shape(is_cap=True), True), (Shape(0.5, 1.0), False), (Shape(1.0, 1.0), False)]
)
def test_caps_are_told_from_what_is_nearly_one(printed, is_cap):
    """From lines whose section has been found by its numbers; half ellipses and parabolas are no caps."""
    lines = LINES.clone()
    lines[:, 5] = torch.tensor([0.2, 0.42, 0.3])[: len(lines)] * lines[:, 4]
    heights = model_of(*printed).heights(lines)
    shown = light_of(SCENE, heights).numpy()
    noise = 0.005 * np.random.default_rng(0).standard_normal(shown.shape)
    image = CausticImage((shown + noise).astype(np.float32), np.full(2, 0.005))
    model = model_of(0.8, 1.0)
    fit = ImageFit(SCENE, image, model, 2 * N)
    found = fit.descend(model.clamped(lines + OFF), 40, with_section=True)
    kept = with_caps(fit, found.lines, 40)
    assert model.shape.is_cap == is_cap
    assert fit.loss(model.heights(kept)) <= found.loss * (1 + 1e-6)
    if is_cap:
        assert 1e6 * float((model.heights(kept) - heights).square().mean().sqrt()) < 1.5


def test_caps_are_told_from_cosines_of_a_power():
    """Of thin fibres, which a cosine of a power tells nearly as well."""
    lines = LINES.clone()
    lines[:, 5] = 0.25 * lines[:, 4]
    heights = model_of(*Shape(is_cap=True)).heights(lines)
    image = CausticImage(light_of(SCENE, heights).numpy(), np.full(2, 0.005))
    model = model_of(0.6, 0.0)
    fit = ImageFit(SCENE, image, model, 2 * N)
    found = fit.descend(lines + OFF, 30, with_section=True)
    assert 0.2 < model.shape.exponent < 0.9 and model.shape.parabola < 0.5
    kept = with_caps(fit, found.lines, 30)
    assert model.shape.is_cap and 1e6 * float((model.heights(kept) - heights).square().mean().sqrt()) < 1.5


@pytest.mark.parametrize("shape", [Shape(1.0, 0.2, 0.9, 0.3, 1.5e-3), Shape(0.6, 0.0, 1.0, 0.1, 5e-4)])
def test_derivatives_by_thicker_ends(shape):
    """Against differences ten times as small, in float64 of their sums."""
    model = LineModel(SCENE)
    model.shape = shape
    found = by_shape(model, LINES, ENDS).double()
    for number, step in ((3, 2e-3), (4, 4e-6)):
        moved = []
        for sign in (-1, 1):
            values = list(shape)
            values[number] += sign * step
            model.shape = Shape(*values)
            moved.append(model.heights(LINES).double())
        expected = (moved[1] - moved[0]) / (2 * step)
        assert float((found[number - 3] - expected).norm()) < 0.03 * float(expected.norm())


MANY = 1e-3 * torch.tensor(
    [
        [-15.0, -12.0, 14.0, 9.0, 3.4, 0.7],
        [-9.0, 15.0, 10.0, -16.0, 3.2, 0.6],
        [-17.0, 11.0, 16.0, 13.0, 2.7, 0.5],
        [-4.0, -18.0, 3.0, 18.0, 2.4, 0.4],
    ],
    dtype=torch.float64,
)


@pytest.mark.parametrize("shape", [Shape(0.5, 1.0), Shape(1.0, 0.0, 0.0), Shape(0.8, 0.5, 0.3)])
def test_descents_pass_ends_of_ranges(shape):
    """From cosines that add up, two numbers at the end of their range: with these in the search along lines it ends at once."""
    model = LineModel(SCENE)
    model.shape = shape
    # A cosine that is as wide at half its height as an ellipse is 1.7 times as wide: within the limits as well.
    lines = MANY * torch.tensor([1.0, 1.0, 1.0, 1.0, 0.7, 1.0], dtype=torch.float64)
    truth = model.heights(lines)
    simulated = light_of(SCENE, truth).numpy()
    noise = np.random.default_rng(0).standard_normal(simulated.shape)
    image = CausticImage((simulated + 0.005 * noise).astype(np.float32), np.full(2, 0.005))
    model.shape = Shape()
    fit = ImageFit(SCENE, image, model, 2 * N)
    found = fit.descend(model.clamped(reshaped(lines + OFF / 2, shape, Shape())), 60, with_section=True)
    assert 1e6 * float((model.heights(found.lines) - truth).square().mean().sqrt()) < 2.5
    assert fit.loss(model.heights(found.lines)) == pytest.approx(found.loss, rel=1e-6), "left at its best"


def test_numbers_that_would_leave_their_range_are_held(monkeypatch):
    """A line as high as any: the descent goes on with all others, and never asks beyond."""
    model = LineModel(SCENE)
    highest = model.limits.height_m[1]
    lines = LINES.clone()
    lines[0, 5] = highest
    fit, heights_of = ImageFit(SCENE, seen(1.0), model, 2 * N), []
    clamped = model.clamped
    monkeypatch.setattr(model, "clamped", lambda rows: heights_of.append(float(rows[0, 5])) or clamped(rows))
    before = fit.loss(model.heights(lines))
    low, high = model.limits_of(lines, (0, 1, 2))
    assert low.shape == high.shape == (15,) and (low < high).all() and high[5] == highest
    monkeypatch.setattr(
        fit, "with_gradient", lambda h, *_: (before, torch.full_like(h, -1.0), np.zeros(0))
    )  # higher is better, everywhere
    fit.descend(lines, 5)
    assert max(heights_of) <= highest


def test_a_told_section_stays():
    model = LineModel(SCENE)
    fit = ImageFit(SCENE, seen(0.6), model, 2 * N)
    fit.descend(LINES + OFF, 10)
    assert model.shape == Shape(1.0)
    better = fit.descend(LINES + OFF, 30, with_section=True)
    assert model.shape.exponent < 0.9
    assert fit.loss(model.heights(better.lines)) == pytest.approx(better.loss, rel=1e-6), "left at its best"


def test_what_is_far_is_not_tried_where_the_way_to_it_is_worse():
    tried = {Shape(1.6): 0.3, Shape(1.0, 1.0): 0.1}
    assert is_in_vain(Shape(8.0), tried, before=0.2) and not is_in_vain(Shape(0.5, 1.0), tried, before=0.2)
    assert not is_in_vain(Shape(1.6), tried, before=0.2), "it is on no other's far side"
    assert not is_in_vain(Shape(8.0), {}, before=0.2), "nothing was tried on the way"
