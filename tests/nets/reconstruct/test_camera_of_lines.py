"""The camera that lines tell."""

from types import SimpleNamespace

import numpy as np
import pytest

from nets.reconstruct.fibres.camera_of_lines import fit_with_camera
from nets.reconstruct.fibres.lines_view import LinesView
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.three_lines import LINES, SCENE, error_um
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.simulator import CausticSimulator

BLUR, NOISE = 0.8, 0.005


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def image(model):
    pixels = SCENE.image_pixels
    many = light_of(SCENE, model.heights(LINES))
    shown = blurred(many, blur_matrices(pixels, np.full(3, BLUR), "cpu")).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    return CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE))


def run_with(model, image, lines, blur_px):
    plain = Resimulation(CausticSimulator(SCENE), image)
    camera = ChannelCamera(
        *(np.zeros((3, 2)), np.zeros(3), np.full(3, blur_px), np.ones(3), np.zeros(3)), SCENE.image_pixels
    )
    view = LinesView(plain.through(camera), model)

    def on(bench):
        return LinesView(plain.through(plain.found_camera(view.relief(run.lines), exactly=True)), model)

    run = SimpleNamespace(
        model=model, lines=lines, view=view, bench=None, on=on, moves_section=False, note=lambda loss: None
    )
    return run


def test_lines_that_are_right_tell_the_blur(model, image):
    """To a hundredth of a pixel, with lines 20 um off, which the wrong blur had bent."""
    run = run_with(model, image, LINES + 2e-5, 0.5)
    fit_with_camera(run)
    np.testing.assert_allclose(run.view.blur_px, BLUR, atol=0.02)
    assert error_um(model, run.lines) < 0.3 * error_um(model, LINES + 2e-5)


def test_a_camera_that_is_right_stays(model, image):
    run = run_with(model, image, LINES, 0.5)
    fit_with_camera(run)
    lines, view = run.lines, run.view
    fit_with_camera(run)
    assert run.lines is lines and run.view is view


def test_an_interrupted_fit_changes_nothing(model, image):
    run = run_with(model, image, LINES + 2e-5, 0.5)
    lines, view = run.lines, run.view

    def stop(loss):
        raise KeyboardInterrupt

    run.note = stop
    with pytest.raises(KeyboardInterrupt):
        fit_with_camera(run)
    assert run.lines is lines and run.view is view
