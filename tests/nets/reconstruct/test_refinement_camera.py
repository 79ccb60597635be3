"""A camera between plate and image: refining must not bend its blur and its lateral colour into the heights."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nets.reconstruct.methods import create
from nets.reconstruct.refinement import Refinement, RefinementOptions
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=32, image_pixels=128)
CPU = torch.device("cpu")


def plate(lower=1.0):
    """Lines of 2.5 mm, shape [32, 32] [m]."""
    lines = [
        Line((-0.015, -0.01), (0.012, 0.008), 8e-3, 2.5e-3 * lower),
        Line((0.015, -0.015), (-0.012, 0.018), 8e-3, 1.5e-3 * lower),
        Line((-0.018, 0.01), (-0.005, 0.018), 6e-3, 1e-3 * lower),
    ]
    return line_relief(lines, 32, SCENE.plate_size_m)


def seen_by_camera(blur=(0, 0, 0), apart=0.0):
    """Image with 0.5 % of noise; the last channel moved sideways by moving its screen."""
    x, y, z = SCENE.screen_position_m
    channels = []
    for channel, wavelength in enumerate(SCENE.wavelengths_m):
        moved = apart * SCENE.pixel_size_m[0] if channel == 2 else 0.0
        single = SCENE.model_copy(
            update={
                "wavelengths_m": (wavelength,),
                "radiosity_W_m2": (1.0,),
                "screen_position_m": (x - moved, y, z),
            }
        )
        with torch.no_grad():
            channels.append(CausticSimulator(single)(torch.tensor(plate(), dtype=torch.float32))[0])
    image = blurred(torch.stack(channels), blur_matrices(128, np.array(blur, dtype=float), CPU)).numpy()
    image = image + 0.005 * np.random.default_rng(3).standard_normal(image.shape)
    return CausticImage(image.astype(np.float32), np.full(3, 0.005))


def refined(image, start, is_known=True, spread=None):
    """Error before and after [m]; with the camera that is found, or as if there were none."""
    refinement = Refinement(SCENE, RefinementOptions(refine_iterations=40, refine_pixels=128), CPU)
    judge = Resimulation(CausticSimulator(SCENE), image)
    if is_known:
        judge = judge.through(judge.found_camera(start))
    found = refinement(judge, start, 0.0, None, spread)
    return [float(np.sqrt(np.mean((heights - plate()) ** 2))) for heights in (start, found.heights)], found, judge


@pytest.mark.parametrize(("blur", "apart"), [((2.0, 2.0, 2.0), 0.0), ((0.7, 0.0, 1.5), 0.6)])
def test_refinement_improves_what_it_used_to_spoil(blur, apart):
    start = plate(lower=0.95)
    image, spread = seen_by_camera(blur, apart), plate() - start
    (before, after), found, judge = refined(image, start, spread=spread)
    assert found.is_better and after < 0.95 * before
    np.testing.assert_allclose(judge.camera.blur, blur, atol=0.25)
    np.testing.assert_allclose(judge.camera.shift[2], (apart, 0), atol=0.05)
    (_, spoiled), _, _ = refined(image, start, is_known=False, spread=spread)
    assert spoiled > 1.05 * before


def test_without_a_camera_nothing_changes():
    """The very same numbers, for perfect images must lose nothing."""
    start, image = plate(lower=0.98), seen_by_camera()
    _, found, judge = refined(image, start)
    _, free, _ = refined(image, start, is_known=False)
    assert judge.camera.is_perfect
    np.testing.assert_array_equal(found.heights, free.heights)


def test_where_a_camera_was_found_the_network_is_trusted_further():
    start = plate(lower=0.98)
    spread = np.full_like(start, 6e-6)
    moved = {}
    for blur in (0.0, 1.0):
        image = seen_by_camera((blur,) * 3)
        shares = [refined(image, start, spread=s)[1].heights - start for s in (spread, None)]
        moved[blur] = float(np.abs(shares[0]).max() / np.abs(shares[1]).max())
    assert moved[0.0] == pytest.approx(0.9, abs=1e-3) and moved[1.0] == pytest.approx(0.2, abs=1e-3)


def test_a_camera_is_judged_by_what_it_sees():
    """The caustic stays that of the scene; the residual is that of the blurred one."""
    image = seen_by_camera((1.0, 1.0, 1.0), apart=0.4)
    plain = Resimulation(CausticSimulator(SCENE), image)
    judge = plain.through(plain.found_camera(plate()))
    assert judge(plate()).residual < 0.03 < 0.1 < plain(plate()).residual
    torch.testing.assert_close(judge(plate()).image, plain(plate()).image)
    assert plain.through(ChannelCamera.perfect(3, 128)) is plain


def apart(shift_px):
    return {"config": {"camera": {"shift_px": shift_px}}}


def test_the_record_tells_of_the_camera(saved, monkeypatch):
    """Channels that lie apart are named where they lie farther apart than the network has seen, as its weights tell."""
    camera = ChannelCamera.perfect(3, 64)
    camera.shift[2] = 0.3, 0.4
    monkeypatch.setattr(Resimulation, "found_camera", lambda self, heights: dataclasses.replace(camera))
    scene = Scene(height_samples=16, image_pixels=64)
    image = CausticImage(np.ones((3, 64, 64), np.float32))
    for training, expected in (({}, "undone"), (apart(0.6), None), (apart(0.4), "for no more than 0.4 px")):
        method = create("direct", scene, weights=saved("direct", training=training), refine_iterations=2)
        result = method.reconstruct(image)
        assert result.counters["camera"]["shift_px"][2] == [0.3, 0.4]
        told = [line for line in result.warnings if "0.50 px beside that of 530 nm" in line]
        assert len(told) == (expected is not None) and (not told or expected in told[0])
    iterated = create("nsfc-unrolled", scene, weights=saved("unrolled"), max_iterations=1, refine_iterations=2)
    result = iterated.reconstruct(image)
    assert result.counters["camera"]["shift_px"][2] == [0.3, 0.4]
    assert any("430 nm lies up to 0.50 px" in line for line in result.warnings)


class Judge:
    """What a refinement asks of a resimulation; its result leaves the told share of what its start leaves."""

    def __init__(self, resimulation, start, left):
        self.image, self.camera, self.start, self.left = resimulation.image, resimulation.camera, start, left

    def __call__(self, heights):
        return SimpleNamespace(residual=0.1 * (1.0 if heights is self.start else self.left))


@pytest.mark.parametrize(("left", "is_kept"), [(0.95, False), (0.93, True)])
def test_beside_a_camera_a_small_gain_is_not_kept(left, is_kept):
    """What a lens does beyond a Gaussian blur is worth 5 % of what is left, and a plate of 1.9 um became 2.4 um wrong."""
    plain = Resimulation(CausticSimulator(SCENE), seen_by_camera())
    blur = dataclasses.replace(ChannelCamera.perfect(3, 128), blur=np.full(3, 0.8))
    refinement, start = Refinement(SCENE, RefinementOptions(refine_iterations=1, refine_pixels=64), CPU), plate(0.9)
    assert refinement(Judge(plain.through(blur), start, left), start, 0.0, None).is_better == is_kept
    assert refinement(Judge(plain, start, left), start, 0.0, None).is_better
