"""Waves along lines, found on a small scene."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.shapes.beside_waves import BesideWaves, mended
from nets.reconstruct.fibres.shapes.waves import FARTHEST, THICKNESS, straight, waves_of, with_mended_lines, with_waves
from nets.reconstruct.fibres.trust.uncertainty import CROSSING, PLAIN_LINES, calibration_of, of_lines
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.wavy_model import WavyModel, knot_counts
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.simulator import CausticSimulator

NOISE = 0.01


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


def printed(model, share=0.04, aside_m=5e-5):
    """Lines with two waves of thickness and way along each."""
    counts = knot_counts(LINES)
    at = np.linspace(0, 1, int(counts.max()))
    turns = np.random.default_rng(3).uniform(0, 2 * np.pi, (len(LINES), 2, 1))
    knots = np.sin(2 * np.pi * 4 * at + turns) * np.array([share, aside_m])[:, None]
    return WavyModel(model, counts).heights(LINES, torch.from_numpy(knots.transpose(0, 2, 1).copy()))


def seen(heights):
    shown = light_of(SCENE, heights).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    return CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE))


def error_um(found, truth):
    return 1e6 * float((found - truth).square().mean().sqrt())


def run_on(model, image, lines, of_network):
    """What of a run is asked."""
    plain = Resimulation(CausticSimulator(SCENE), image, np.ones(3))
    view = LinesView(plain.through(ChannelCamera.perfect(3, SCENE.image_pixels)), model)
    relief = view.relief(lines)
    return SimpleNamespace(
        lines=lines,
        view=view,
        model=model,
        left=lambda: (relief, view.resimulation(relief).residual, of_network),
        note=lambda loss: None,
    )


def test_waves_are_found_with_the_lines(model):
    truth = printed(model)
    fit = ImageFit(SCENE, seen(truth), model, 4 * N)
    start = straight(model, LINES + 1e-5)
    found = with_waves(fit, start, 80, NOISE)
    before = error_um(start.heights, truth)
    assert before > 8 and error_um(found.heights, truth) < 0.3 * before
    assert fit.loss(found.heights) < 0.3 * fit.loss(start.heights)
    assert found.thickness == pytest.approx(0.04 / np.sqrt(2), rel=0.3)
    assert found.record == {"thickness": found.thickness, "aside_m": found.aside_m}


def test_noise_makes_no_waves(model):
    """Of lines that are straight, what is believed of waves holds them."""
    truth = model.heights(LINES)
    found = with_waves(ImageFit(SCENE, seen(truth), model, 4 * N), straight(model, LINES), 40, NOISE)
    assert found.thickness < 0.004 and found.aside_m < 8e-6
    assert error_um(found.heights, truth) < 1.0


def test_waves_are_tried_where_straight_lines_leave_more_than_noise(model):
    image, straight_image = seen(printed(model)), seen(model.heights(LINES))
    assert waves_of(run_on(model, straight_image, LINES, of_network=1.0)) is None
    run = run_on(model, image, LINES, of_network=1.0)
    found = waves_of(run)
    assert error_um(found.heights, printed(model)) < 0.6 * error_um(model.heights(LINES), printed(model))
    assert waves_of(run_on(model, image, LINES, of_network=1e-6)) is None, "what the network knows better is no line"
    few = LINES[1:]
    assert waves_of(run_on(model, image, few, of_network=1.0)) is None, "waves do not stand in for a line"


def test_a_run_that_is_out_of_time_ends(model):
    def late(loss):
        raise KeyboardInterrupt

    run = run_on(model, seen(printed(model)), LINES, of_network=1.0)
    run.note = late
    with pytest.raises(KeyboardInterrupt):
        waves_of(run)


def test_lines_are_mended_beside_their_waves(model):
    """An end 1.5 mm too soon is little beside waves that are not told."""
    truth = printed(model)
    fit = ImageFit(SCENE, seen(truth), model, 4 * N)
    short = LINES.clone()
    way = short[0, 2:4] - short[0, :2]
    short[0, 2:4] -= 1.5e-3 * way / way.norm()

    def beside(added):
        on_waves = BesideWaves(model, added)
        quick = ImageFit(SCENE, seen(truth), on_waves, 2 * N)
        return ImageFit(SCENE, seen(truth), on_waves, 4 * N, metric=quick), quick

    start = with_waves(fit, straight(model, short), 40, NOISE)
    found = with_mended_lines(fit, start, NOISE, beside)
    assert float((found.lines[0] - LINES[0]).abs().max()) < 5e-4 < 1e-3 < float((start.lines[0] - LINES[0]).abs().max())
    assert error_um(found.heights, truth) < 0.6 * error_um(start.heights, truth)
    assert fit.loss(found.heights) < 0.97 * fit.loss(start.heights)


@pytest.mark.parametrize("overlap", [1.0, 0.4])
def test_waves_are_added_to_lines(overlap):
    model = LineModel(SCENE)
    model.shape = Shape(overlap=overlap)
    added = 1e-5 * torch.randn(N, N, generator=torch.Generator().manual_seed(0))
    beside = BesideWaves(model, added)
    heights, derivatives = model.with_jacobian(LINES)
    found, by_line = beside.with_jacobian(LINES)
    torch.testing.assert_close(found, heights + added)
    torch.testing.assert_close(by_line, derivatives)
    torch.testing.assert_close(beside.heights(LINES), heights + added)
    parts = model.parts(LINES)[0]
    torch.testing.assert_close(beside.without(parts, [(0,), (1,)]), model.without(parts, [(0,), (1,)]) + added)
    tried = LINES[:2].flip(0) + 1e-4
    torch.testing.assert_close(beside.with_each(LINES, tried), model.with_each(LINES, tried) + added)
    torch.testing.assert_close(beside.heights_without_each(LINES), model.heights_without_each(LINES) + added)


def test_short_lines_may_only_have_told_waves():
    short = LINES[:1].clone()
    short[0, 2:4] = short[0, :2] + 1e-4
    image = CausticImage(light_of(SCENE, LineModel(SCENE).heights(LINES)).numpy(), np.full(3, NOISE))
    fit = ImageFit(SCENE, image, LineModel(SCENE), 2 * N)
    assert [len(each) for each in mended(fit, fit, LINES)] == [len(LINES)]
    with_more = mended(fit, fit, torch.cat([LINES, short]))
    assert len(with_more[-1]) == len(LINES)


def test_what_varies_is_told_of_the_knots_that_there_are(model):
    lines = LINES.clone()
    lines[1, 2:4] = lines[1, :2] + torch.tensor([2e-3, 0.0], dtype=torch.float64)
    start = straight(model, lines)
    knots = torch.full_like(start.knots, 0.02)
    knots[1, int(start.counts[1]) :] = 7.0
    assert dataclasses.replace(start, knots=knots).thickness == pytest.approx(0.02)


def test_lines_state_by_how_they_are_made_what_they_are_off_by():
    """Sections that descents find are as well known as the usual one; waves least of all."""
    plain, merged = (calibration_of(s, has_waves=False) for s in (Shape(0.9), Shape(0.9, overlap=0.4)))
    same = Shape(0.5, 1.0, is_cap=True), Shape(thicker=0.2), Shape(16.0, cut=0.01), Shape(0.5), Shape(1.0, 1.0)
    assert {plain, *(calibration_of(shape, has_waves=False) for shape in same)} == {PLAIN_LINES}
    ellipse, steep = (calibration_of(s, has_waves=False) for s in (Shape(0.5, 1.0), Shape(0.35)))
    blurred = calibration_of(Shape(), has_waves=False, is_blurred=True)
    curved = calibration_of(Shape(), has_waves=False, has_curves=True)
    wavy = calibration_of(Shape(thicker=0.2), has_waves=True)
    scales = [each.scale_m for each in (plain, ellipse, merged, blurred, curved, wavy)]
    assert scales == sorted(scales) and len(set(scales)) == len(scales) and steep == ellipse
    assert calibration_of(Shape(overlap=0.4), has_waves=False, is_blurred=True) == blurred
    spread, heights = np.full((2, 2), 4e-6), np.ones((2, 2))
    stated = [of_lines(spread, heights, None, True, 0.0, calibration=each)[0, 0] for each in (plain, merged, wavy)]
    np.testing.assert_allclose(np.array(stated) / stated[0], [1.0, 8.0, 120.0])


def test_lines_state_more_where_light_paths_cross():
    """Of what noise and spread make of them; the base is as flat there as elsewhere."""
    spread, heights, posterior = np.full((2, 2), 4e-6), np.ones((2, 2)), np.full((2, 2), 1e-7)
    crossing = np.array([[True, False], [False, False]])
    plain, told = (of_lines(spread, heights, None, True, 0.0, posterior, crossing=each) for each in (None, crossing))
    np.testing.assert_allclose(told, np.where(crossing, CROSSING, 1.0) * plain)
    flat = of_lines(spread, heights, None, True, 3e-8, posterior, crossing=crossing)
    np.testing.assert_allclose(flat**2 - told**2, 9e-16)


def test_waves_stay_within_what_machines_do(model):
    """However far a descent would go: of an image that no line explains."""
    image = CausticImage(np.full((3, SCENE.image_pixels, SCENE.image_pixels), 4.0, np.float32), np.full(3, NOISE))
    found = with_waves(ImageFit(SCENE, image, model, 2 * N), straight(model, LINES), 30, 1e-6)
    assert float(found.knots[..., 0].abs().max()) <= FARTHEST * THICKNESS + 1e-12
    assert torch.isfinite(found.heights).all()
