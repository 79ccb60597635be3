"""Reconstruction by descent: independent images, options, interruption."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nets.reconstruct.methods import create
from warp_caustics import CausticSimulator, Scene
from warp_caustics.errors import InputError, ResourceError
from warp_caustics.height_field import cell_centres
from warp_caustics.metrics import height_errors
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import level_sizes, measurement_at
from warp_caustics.reconstruct.refine.metric import CurvatureMetric

DATA = Path(__file__).parents[3] / "data"
SMALL = Scene(height_samples=32, image_pixels=64, plate_size_m=(0.02, 0.02))


def bumps(peak_m):
    x, y = np.meshgrid(*[cell_centres(32, 0.02)] * 2)
    shapes = ((-3e-3, 2e-3, 1.5e-3), (4e-3, -3e-3, 1.0e-3), (0.0, 5e-3, 1.2e-3))
    return peak_m * sum(np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * s**2)) for a, b, s in shapes)


def caustic(heights, scene=SMALL, noise=0.0, seed=0):
    """Image from photons the reconstruction never uses, finer and elsewhere than its lattice."""
    simulator = CausticSimulator(scene, n_photons=397**2)
    image = simulator(torch.from_numpy(heights).float()).numpy()
    image += noise * np.random.default_rng(seed).standard_normal(image.shape).astype(np.float32)
    return CausticImage(image, np.full(scene.n_wavelengths, noise) if noise else None)


def errors(result, truth, scene=SMALL):
    return height_errors(result.heights_m, truth, scene.plate_size_m)


def test_weak_relief_from_flat():
    """Three bumps of 40 um, no noise: 2 um from a flat start of 7 um RMS."""
    truth = bumps(40e-6)
    result = create("refine", SMALL, max_iterations=30).reconstruct(caustic(truth))
    assert result.settings["metric"] == "curvature"
    assert errors(result, truth)["rmse_um"] < 2 < 7 < errors(result, truth)["reference_rms_um"]
    assert result.residual < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "key", "limit_um"), [("d_gauss", "rmse_um", 0.2), ("c_cosine", "rmse_mean_removed_um", 0.5)]
)
def test_independent_images_from_flat(case, key, limit_um):
    """Images of another renderer; 5 and 1 um were asked for."""
    scene = Scene(exit_medium="glass")
    image = CausticImage(np.load(DATA / f"{case}_image.npz")["image"])
    truth = np.load(DATA / f"{case}_trace.npz")["heights_m"]
    result = create("refine", scene).reconstruct(image)
    assert height_errors(result.heights_m, truth, scene.plate_size_m)[key] < limit_um


def lines(height_m):
    """Two printed lines, steep enough to fold the caustic."""
    pair = [((-7e-3, -5e-3), (6e-3, 4e-3)), ((-4e-3, 7e-3), (5e-3, -6e-3))]
    return line_relief([Line(start, end, 2.4e-3, height_m) for start, end in pair], 32, SMALL.plate_size_m)


def test_strong_relief_from_a_nearby_start():
    """A folded caustic with 1 % noise, lines 15 % too low at the start: less than half of that error is left."""
    truth, start = lines(0.7e-3), lines(0.6e-3)
    measured = caustic(truth, noise=0.01)
    assert np.quantile(measured.irradiance, 0.995) > 2
    result = create("refine", SMALL, max_iterations=200).reconstruct(measured, initial=start)
    assert result.settings["metric"] == "height"
    before = height_errors(start, truth, SMALL.plate_size_m)["rmse_um"]
    assert errors(result, truth)["rmse_um"] < before / 2


def test_discrepancy_principle_stops_at_the_noise():
    """With 2 % noise the residual ends near the noise, long before the iterations do."""
    truth = bumps(40e-6)
    result = create("refine", SMALL, max_iterations=500).reconstruct(caustic(truth, noise=0.02))
    assert result.stop_reason == "discrepancy"
    assert result.counters["evaluations"] < 200
    assert result.history[-1]["discrepancy"] == pytest.approx(1.0, abs=0.1)
    assert errors(result, truth)["rmse_um"] < errors(result, truth)["reference_rms_um"]


def test_interruption_returns_the_best_so_far():
    """Ctrl-C in the curvature metric; the contract of all methods tries the other one."""
    measured = caustic(bumps(40e-6))
    seen = []

    def interrupt(progress):
        seen.append(progress.residual)
        if len(seen) == 10:
            raise KeyboardInterrupt

    method = create("refine", SMALL, metric="curvature", total_variation=0.0, coarsest_pixels=64)
    result = method.reconstruct(measured, progress=interrupt)
    assert result.stop_reason == "interrupted"
    assert len(result.history) == 10
    flat = np.linalg.norm(1 - measured.irradiance) / np.linalg.norm(measured.irradiance)
    assert result.residual < flat


@pytest.mark.parametrize("exposure", [0.95, 1.03])
def test_exposure_is_divided_out(exposure):
    """A weak relief sends no light beside the screen, so all light together tells it."""
    truth = bumps(40e-6)
    image = caustic(truth)
    seen = CausticImage(image.irradiance * np.float32(exposure))
    nominal, found, believed = (
        create("refine", SMALL, max_iterations=30, **options).reconstruct(given)
        for given, options in ((image, {}), (seen, {}), (seen, {"exposure": "trust"}))
    )
    np.testing.assert_allclose(found.counters["exposure"], exposure, rtol=2e-4)
    np.testing.assert_allclose(found.heights_m, nominal.heights_m, atol=1e-6)
    np.testing.assert_allclose(found.image, exposure * nominal.image, atol=5e-3)
    assert nominal.counters["exposure"] == [1, 1, 1]
    assert [sum("divided out" in warning for warning in r.warnings) for r in (nominal, found, believed)] == [0, 1, 0]
    assert errors(believed, truth)["rmse_um"] > 10 * errors(found, truth)["rmse_um"]


def test_a_start_tells_the_exposure():
    """Of a plate with folds, whose light the start sends where it goes."""
    truth = bumps(600e-6)
    image = caustic(truth)
    seen = CausticImage(image.irradiance * np.float32([0.95, 1.0, 1.05])[:, None, None])
    given = {"initial": 0.97 * truth}
    nominal, found = (create("refine", SMALL, max_iterations=40).reconstruct(i, **given) for i in (image, seen))
    np.testing.assert_allclose(found.counters["exposure"], [0.95, 1.0, 1.05], rtol=1e-3)
    assert errors(found, truth)["rmse_um"] < 1.1 * errors(nominal, truth)["rmse_um"]


def test_priors_keep_heights_above_the_plate():
    """Non-negativity leaves less below the plate than no prior does."""
    measured = caustic(bumps(1.5e-3))

    def depth(weight):
        method = create("refine", SMALL, metric="height", nonnegativity=weight, total_variation=0.0, max_iterations=60)
        return -method.reconstruct(measured).heights_m.clip(max=0).mean()

    assert depth(1.0) < 0.3 * depth(0.0)


def test_binning_is_the_mean_of_whole_pixels():
    """A coarse pixel is the mean of its fine ones and counts only if all of them do; noise falls by the factor."""
    image = np.random.default_rng(0).uniform(0.5, 2, (3, 64, 64))
    mask = np.ones_like(image, bool)
    mask[0, 0, 0] = False
    level = measurement_at(CausticImage(image, np.full(3, 0.01), mask), SMALL, 16, torch.device("cpu"))
    expected = image[1, 4:8, 8:12].mean()
    assert float(level.irradiance[1, 1, 2]) == pytest.approx(expected, rel=1e-6)
    assert float(level.weight[0, 0, 0]) == 0
    assert float(level.weight.sum()) == 3 * 256 - 1
    assert float(level.noise[1, 1, 2]) == pytest.approx(0.01 * np.sqrt(expected) / 4, rel=1e-6)


def test_level_sizes():
    assert level_sizes(512, 64, 512) == [64, 128, 256, 512]
    assert level_sizes(96, 10, 96) == [12, 24, 48, 96]
    assert level_sizes(101, 10, 101) == [101]
    with pytest.raises(InputError, match="100"):
        level_sizes(512, 64, 100)


def test_curvature_metric_is_symmetric():
    """Apply is its own adjoint: <K u, v> = <u, K v>."""
    metric = CurvatureMetric(16, (0.05, 0.03), 1e-3)
    u, v = np.random.default_rng(1).standard_normal((2, 16, 16))
    assert np.vdot(metric.apply(u), v) == pytest.approx(np.vdot(u, metric.apply(v)), rel=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"metrik": "height"}, "refine.metrik: unknown key"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"charbonnier_width": float("nan")}, "charbonnier_width"),
        ({"step_m": 5.0}, "step_m"),
    ],
)
def test_bad_options_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        create("refine", SMALL, **options)


def test_unknown_method_and_missing_device():
    with pytest.raises(InputError, match="refine"):
        create("magic", SMALL)
    with pytest.raises(ResourceError, match="cuda:77"):
        create("refine", SMALL, device="cuda:77")
