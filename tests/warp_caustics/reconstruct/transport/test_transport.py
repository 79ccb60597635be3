"""``transport`` from image to heights, and what it does with bad images."""

import numpy as np
import pytest
import torch

from nets.reconstruct.methods import create
from warp_caustics import CausticSimulator, Scene
from warp_caustics.errors import InputError
from warp_caustics.metrics import height_errors
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.transport.transport import transport_initial, with_initial

SMALL = Scene(height_samples=32, image_pixels=128, plate_size_m=(0.02, 0.02))


def relief(height_m=1.5e-4, scene=SMALL):
    """Two printed lines that cross, no folds."""
    ends = [((-7e-3, -5e-3), (6e-3, 4e-3)), ((-4e-3, 7e-3), (5e-3, -6e-3))]
    return line_relief([Line(start, end, 3e-3, height_m) for start, end in ends], 32, scene.plate_size_m)


def caustic(heights, scene=SMALL, noise=0.0):
    """Image from photons no reconstruction uses."""
    image = CausticSimulator(scene, n_photons=397**2)(torch.from_numpy(heights).float()).numpy()
    image += noise * np.random.default_rng(0).standard_normal(image.shape).astype(np.float32)
    return CausticImage(image, np.full(scene.n_wavelengths, noise) if noise else None)


def rmse(result, truth, scene=SMALL, key="rmse_um"):
    return height_errors(result.heights_m, truth, scene.plate_size_m)[key]


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_mild_relief(noise):
    """Lines 0.15 mm high, a flat guess 48 um off: 1.3 um from the image alone, absolute, with 1 % noise too."""
    truth = relief()
    result = create("transport", SMALL).reconstruct(caustic(truth, noise=noise))
    assert rmse(result, truth) < 1.5 < 40 < np.sqrt((truth**2).mean()) * 1e6
    assert result.stop_reason == "converged" and result.warnings == ()
    assert result.counters["mass_error"] < 0.02
    assert result.residual < 0.05
    assert len(result.history) == result.counters["steps"]
    assert result.history[-1]["residual"] < 0.2 * result.history[0]["residual"]


def test_flat_plate_has_no_relief():
    result = create("transport", SMALL).reconstruct(CausticImage(np.ones((3, 128, 128))))
    assert np.abs(result.heights_m).max() < 1e-8


def test_weak_relief():
    """A relief of 3 um moves 0.1 % of the light; it is found all the same, but for its mean."""
    truth = relief(3e-6)
    result = create("transport", SMALL).reconstruct(caustic(truth))
    assert rmse(result, truth, key="rmse_mean_removed_um") < 0.25 < 0.8 < truth.std() * 1e6
    assert result.counters["mass_error"] < 1e-5


@pytest.mark.parametrize(
    "scene",
    [
        SMALL.model_copy(update={"screen_position_m": (0.0, 0.0, -5e-3)}),
        SMALL.model_copy(update={"exit_medium": "glass", "screen_position_m": (1e-3, 0.0, -2e-3)}),
        SMALL.model_copy(update={"emission_half_angle_rad": 0.3, "light_position_m": (0.0, 0.0, 0.3)}),
    ],
    ids=["air", "glass, window beside the plate", "point source"],
)
def test_other_geometries(scene):
    """Exact refraction on all of the path: as good with a screen in air, in glass, and with a point source.

    Where window and plate do not cover each other nothing is known, so only the middle is compared.
    """
    truth = relief(1e-4)
    result = create("transport", scene).reconstruct(caustic(truth, scene))
    inner = slice(6, -6)
    error = (result.heights_m - truth)[inner, inner] * 1e6
    assert error.std() < 1.5 < 20 < truth[inner, inner].std() * 1e6


def test_dim_and_missing_light():
    """Only the ratio to the radiosity counts; a wavelength that is dark is left out, with a warning."""
    truth = relief()
    dim = SMALL.model_copy(update={"radiosity_W_m2": (0.01, 0.02, 0.005)})
    image = caustic(truth, dim)
    assert rmse(create("transport", dim).reconstruct(image), truth) < 1.5
    image.irradiance[1] = 0
    result = create("transport", dim).reconstruct(image)
    assert rmse(result, truth) < 1.5
    assert "530 nm" in result.warnings[0]


def test_masked_pixels_do_not_count():
    truth = relief()
    clean = caustic(truth)
    mask = np.ones(clean.irradiance.shape, bool)
    mask[:, 20:23, 30:34] = False
    dirty = clean.irradiance.copy()
    dirty[~mask] = 1e3
    results = [
        create("transport", SMALL).reconstruct(CausticImage(values, None, mask)) for values in (clean.irradiance, dirty)
    ]
    np.testing.assert_array_equal(results[0].heights_m, results[1].heights_m)
    assert rmse(results[0], truth) < 1.5


def test_constant_baseline_leaves_the_bend():
    """Both baselines set the bare plate to zero; only the smooth one takes a bend off that lost light feigns."""
    truth = relief()
    image = caustic(truth)
    image.irradiance[:, :, -12:] *= 0.99
    smooth, constant = (create("transport", SMALL, baseline=b).reconstruct(image) for b in ("smooth", "constant"))
    assert rmse(smooth, truth) < 0.5 * rmse(constant, truth)
    assert smooth.counters["removed_bend_rms_m"] > 1e-6 and constant.counters["removed_bend_rms_m"] < 1e-12
    assert np.quantile(constant.heights_m, 0.1) == pytest.approx(0, abs=1e-8)


def test_a_start_is_taken_up():
    """From the true relief there is no light to move: it stays, though its caustic has folds."""
    truth = relief(7e-4)
    image = caustic(truth)
    assert image.irradiance.max() > 5
    from_truth = create("transport", SMALL).reconstruct(image, initial=truth)
    from_flat = create("transport", SMALL).reconstruct(image)
    assert rmse(from_truth, truth) < 0.5 * rmse(from_flat, truth)
    assert not from_truth.settings["from_flat"] and from_flat.settings["from_flat"]


def test_light_that_cannot_be_carried_is_warned_of():
    """All light in one corner: no convergence in ten steps, out of reach of refraction, and said so."""
    spot = np.zeros((3, 128, 128))
    spot[:, 10:14, 10:14] = 128**2 / 16
    result = create("transport", SMALL, max_iterations=10).reconstruct(CausticImage(spot))
    text = " | ".join(result.warnings)
    assert result.stop_reason == "max_iterations"
    assert "not converged" in text and "cannot be refracted" in text and "light paths cross" in text
    assert np.isfinite(result.heights_m).all() and result.counters["mass_error"] > 0.05


def test_start_for_other_methods_is_on_record():
    image = caustic(relief())
    start = transport_initial(SMALL, image)
    refined = create("refine", SMALL, max_iterations=2).reconstruct(image, initial=start.heights_m)
    result = with_initial(refined, start)
    assert result.settings["initial"]["method"] == "transport"
    assert result.settings["initial"]["counters"]["mass_error"] == start.counters["mass_error"]
    assert result.settings["metric"] == "height"
    assert result.timings_s["initial"] > 0
    np.testing.assert_array_equal(result.heights_m, refined.heights_m)


@pytest.mark.parametrize("method", ["transport", "hcccd"])
def test_next_to_no_light_is_refused(method):
    with pytest.raises(InputError, match="less than 0.01"):
        create(method, SMALL).reconstruct(CausticImage(1e-4 * np.ones((3, 128, 128))))


@pytest.mark.parametrize("method", ["transport", "hcccd"])
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"cells": 100}, "does not divide"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"step": 1}, "step: unknown key"),
        ({"max_time_s": -1.0}, "max_time_s"),
    ],
)
def test_bad_options_are_refused(method, options, words):
    with pytest.raises(InputError, match=words):
        create(method, SMALL, **options)
