"""The bench comes back from captures of known plates, and is as sure as it says."""

import numpy as np
import pytest
import torch

from warp_caustics.calibration.advice import advice, least_told
from warp_caustics.calibration.calibrate import calibrate, usual_free
from warp_caustics.calibration.plates import DESIGN, TOLERANCES, KnownPlate, flat_plate, lens
from warp_caustics.calibration.window_camera import shown_window
from warp_caustics.camera.config import CameraConfig
from warp_caustics.errors import InputError
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene
from warp_caustics.setup.set_up import SetUp

from .conftest import CAMERA, NAMES, SCENE, capture, drawn_bench, true_values

QUICK = {"border_px": 3, "photons": 200}


def printed(seed=0, lines=6):
    """A design of short thick lines."""
    generator = np.random.default_rng(seed)
    drawn = [
        Line(tuple(generator.uniform(-0.02, 0.02, 2)), tuple(generator.uniform(-0.02, 0.02, 2)), 6e-3, 4e-4)
        for _ in range(lines)
    ]

    def relief(factor, n, size):
        wider = [Line(line.start_m, line.end_m, line.width_m * factor, line.height_m) for line in drawn]
        return line_relief(wider, n, size)

    return KnownPlate(DESIGN, "print", lambda n, size: relief(1.0, n, size), TOLERANCES[DESIGN], relief)


def scores(seeds):
    """(found - true) / sigma of random benches, prints and noise, shape [seeds, parameters]."""
    setup = SetUp.of(SCENE, CAMERA, NAMES)
    found = []
    for seed in seeds:
        scene, camera, theta = drawn_bench(setup, seed)
        plate = printed(seed)
        generator = np.random.default_rng(1000 + seed)
        view = capture(scene, camera, plate, 0.01, seed, modes=[generator.normal(0, p.prior) for p in plate.parameters])
        result = calibrate(SCENE, CAMERA, [view], free=NAMES, **QUICK)
        sigma = torch.tensor([f.sigma for f in result.bench])
        found.append((result.theta - theta) / sigma)
    return torch.stack(found)


@pytest.mark.slow
def test_sigma_covers_over_fifty_benches():
    """Benches, prints and noise drawn at random; nothing but the model's own numbers is told."""
    off = scores(range(50)).abs()
    within = float((off < 1).double().mean())
    assert 0.58 < within < 0.78, f"{within:.2f} of the values are within one sigma"
    assert float((off < 2).double().mean()) > 0.9


def test_sigma_covers_on_a_few_benches():
    """Three benches of eight numbers: 0.68 within, give or take 0.17 where numbers of a bench go together."""
    off = scores(range(100, 103)).abs()
    assert 0.4 < float((off < 1).double().mean()) <= 0.96
    assert float(off.max()) < 4


@pytest.fixture(scope="module")
def found():
    """A calibration of a picture some pixels off, and what is true."""
    theta = {"gap_m": 3.05e-3, "tilt_x_rad": 3e-3}
    scene = Scene.model_validate(
        SCENE.model_dump() | {"screen_position_m": (0, 0, -theta["gap_m"]), "light_tilt_rad": (theta["tilt_x_rad"], 0)}
    )
    camera = CameraConfig(psf_px=0.9, ambient=0.03, shift_px=(3.4, -2.6), magnification=1.002)
    view = capture(scene, camera, printed(3), 0.005, 7)
    shift = {"shift_x_px": 5.0, "shift_y_px": 5.0}
    result = calibrate(SCENE, CAMERA, [view], free=NAMES, priors=shift, **QUICK)
    return result, true_values(result, scene, camera)


def test_a_picture_some_pixels_off_is_found(found):
    """Far beyond the width of its lines, which a descent from where it was believed would miss."""
    result, truth = found
    assert result.is_converged
    sigma = torch.tensor([f.sigma for f in result.bench])
    assert float(((result.theta - truth) / sigma).abs().max()) < 3.5
    by_name = {f.parameter.name: f for f in result.bench}
    assert by_name["shift_x_px"].value == pytest.approx(3.4, abs=0.06)
    assert by_name["psf_px.0"].value == pytest.approx(0.9, abs=0.05)
    assert by_name["psf_px.0"].verdict == "found"
    assert result.fits[0].explained > 0.95 and float(result.fits[0].misfit.max()) < 1.3


def test_scene_and_camera_are_those_of_the_values(found):
    """What is written for other commands is what was found."""
    result, _ = found
    values = dict(zip(result.setup.names, result.theta.tolist(), strict=True))
    assert -result.scene.screen_position_m[2] == pytest.approx(values["gap_m"])
    assert result.camera.shift_px == pytest.approx((values["shift_x_px"], values["shift_y_px"]))
    assert result.camera.psf_px == pytest.approx((values["psf_px.0"],))
    assert torch.allclose(result.correlations.diagonal(), torch.ones(len(values), dtype=torch.float64))


def test_advice_shrinks_what_is_least_told(found):
    """A direct measurement of the worst number leaves less of it than any plate does of nothing."""
    result, _ = found
    least = least_told(result)
    assert 0 < least.remaining <= 2 and least.parts
    told = advice(result)
    assert [item.left for item in told] == sorted(item.left for item in told)
    assert told[0].left < 0.9 and all(0 < item.left <= 1.0001 for item in told)
    assert any("lens" in item.what for item in told) and any("feeler" in item.what for item in told)


def test_dust_does_not_pull(found):
    """A twentieth of the pixels dark, which no mask tells of: values move by less than two sigma."""
    view = found[0].fits[0].view
    generator = np.random.default_rng(5)
    dusty = np.where(generator.random(view.image.shape) < 0.05, 0.3 * view.image, view.image)
    other = type(view)(view.name, view.plate, dusty, view.noise)
    priors = {"shift_x_px": 5.0, "shift_y_px": 5.0}
    result = calibrate(SCENE, CAMERA, [other], free=NAMES, priors=priors, **QUICK)
    apart = (result.theta - found[1]) / torch.tensor([f.sigma for f in result.bench])
    assert float(apart.abs().max()) < 4


def test_a_flat_plate_tells_uneven_light():
    """Without its flat frame; the lens beside it was divided by one, and tells nothing of that."""
    camera = CameraConfig(psf_px=0.7, ambient=0.02, light=(0.04, -0.03, 0.0, 0.02, 0.0))
    flat = capture(SCENE, camera, flat_plate(), 0.005, 1, name="flat", is_divided=False)
    assert "light_x.0" in usual_free(SCENE, CAMERA, [flat])
    round_ = capture(SCENE, camera, lens(0.15, 0.04), 0.005, 2, name="lens")
    assert "light_x.0" not in usual_free(SCENE, CAMERA, [round_])
    names = ["light_x", "light_y", "light_xy", "psf_px"]
    result = calibrate(SCENE, CAMERA, [flat, round_], free=names, **QUICK)
    assert result.theta[:3].tolist() == pytest.approx([0.04, -0.03, 0.02], abs=2e-3)
    assert {f.view for f in result.found} == {None, "flat", "lens"}


def test_what_an_image_does_not_tell_keeps_its_prior():
    """A flat plate tells nothing of the gap under parallel light."""
    flat = capture(SCENE, CAMERA, flat_plate(), 0.005, 1, is_divided=False)
    result = calibrate(SCENE, CAMERA, [flat], free=["gap_m", "light_x"], **QUICK)
    gap = result.bench[0]
    assert gap.verdict == "not told" and gap.sigma == pytest.approx(gap.parameter.prior, rel=0.05)
    assert gap.value == pytest.approx(gap.before, abs=0.3 * gap.sigma)


def test_wrong_captures_are_refused():
    view = capture(SCENE, CAMERA, lens(0.15, 0.04), 0.01, 0)
    with pytest.raises(InputError, match="no captures"):
        calibrate(SCENE, CAMERA, [])
    with pytest.raises(InputError, match="share a name"):
        calibrate(SCENE, CAMERA, [view, view])
    with pytest.raises(InputError, match="resample it"):
        calibrate(Scene(), CAMERA, [view])
    with pytest.raises(InputError, match="each capture's own"):
        calibrate(SCENE, CAMERA, [view], free=["gain"], **QUICK)
    with pytest.raises(InputError, match="tells nothing; leave the flat frame out"):
        type(view)("flat", flat_plate(), view.image, view.noise)
    with pytest.raises(InputError, match="is not above 0 for each channel"):
        type(view)("dead", view.plate, view.image, 0 * view.noise)


def test_a_registered_photo_is_a_window():
    """Where the window lies in the photo is known, and no part of the capture."""
    camera = CameraConfig(frame_px=(60, 50), shift_px=(3, 2), psf_px=0.5, magnification=0.9)
    window = shown_window(camera)
    assert window.frame_px is None and window.shift_px == (0, 0) and window.psf_px == 0.5 and window.magnification == 1
