"""The method sfc: what it recovers, when it stops, what it says, what it refuses."""

import numpy as np
import pytest
import torch

from nets.reconstruct.methods import create
from warp_caustics import CausticSimulator, Scene
from warp_caustics.errors import InputError
from warp_caustics.metrics import height_errors
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage

ONE = {"wavelengths_m": (5e-7,), "radiosity_W_m2": (1.0,)}
SMALL = Scene(height_samples=32, image_pixels=64, plate_size_m=(0.0125, 0.0125), **ONE)
LANDWEBER = ["landweber_pixel", "landweber_wavelet"]


def lines(height_m=6e-5):
    pair = [((-4e-3, -3e-3), (3e-3, 2e-3)), ((-2e-3, 4e-3), (4e-3, -3e-3))]
    return line_relief([Line(start, end, 2e-3, height_m) for start, end in pair], 32, SMALL.plate_size_m)


def caustic(heights, scene=SMALL, noise=0.0):
    """Image from photons the reconstruction never uses."""
    image = CausticSimulator(scene, n_photons=197**2)(torch.from_numpy(heights).float()).numpy()
    image += noise * np.random.default_rng(0).standard_normal(image.shape).astype(np.float32)
    return CausticImage(image, np.full(scene.n_wavelengths, noise) if noise else None)


def rmse_um(result, truth):
    return height_errors(result.heights_m, truth, SMALL.plate_size_m)["rmse_um"]


TRUTH, FLAT_UM = lines(), float(np.sqrt(np.mean(lines() ** 2))) * 1e6


@pytest.fixture(scope="module")
def measured():
    return caustic(TRUTH, noise=0.005)


@pytest.mark.parametrize(
    ("variant", "share"), [("baseline", 0.9), ("landweber_pixel", 0.6), ("landweber_wavelet", 0.6)]
)
def test_weak_relief_gets_nearer(variant, share, measured):
    """Two lines of 60 um, 0.5 % noise, 60 iterations from flat."""
    result = create("sfc", SMALL, variant=variant, max_iterations=60, discrepancy=0).reconstruct(measured)
    assert result.method == "sfc"
    assert result.settings["variant"] == variant
    assert rmse_um(result, TRUTH) < share * FLAT_UM
    assert result.history[-1]["residual"] < result.counters["start_residual"] / 2
    assert len(result.history) == 60


def test_volume_tells_the_mean_height(measured):
    """The same with mask and volume of the truth: nearer, and flagged in settings and warnings."""
    blind = create("sfc", SMALL, max_iterations=60).reconstruct(measured)
    told = create("sfc", SMALL, max_iterations=60, oracle_heights_m=TRUTH).reconstruct(measured)
    assert rmse_um(told, TRUTH) < rmse_um(blind, TRUTH)
    assert told.settings["knowledge"]["mask"] == told.settings["knowledge"]["volume"] == "oracle"
    assert any("privileged" in warning for warning in told.warnings)
    assert blind.settings["knowledge"] == {"mask": "none", "mask_fraction": 1.0, "volume": "none", "volume_m3": None}
    assert not any("privileged" in warning for warning in blind.warnings)
    printed = TRUTH.sum() * SMALL.plate_area_m2 / 32**2
    assert told.settings["knowledge"]["volume_m3"] == pytest.approx(printed)


def test_half_an_oracle_is_flagged_too(measured):
    options = {"oracle_heights_m": TRUTH, "mask": "none", "max_iterations": 1}
    result = create("sfc", SMALL, **options).reconstruct(measured)
    assert result.settings["knowledge"]["mask"] == "none"
    assert next(w for w in result.warnings if "privileged" in w).startswith("volume derived")


@pytest.mark.parametrize("variant", LANDWEBER)
def test_mask_and_bounds_hold(variant, measured):
    mask = np.zeros((32, 32), bool)
    mask[:, 10:] = True
    options = {"variant": variant, "mask": mask, "max_iterations": 10, "highest_m": 2e-5}
    result = create("sfc", SMALL, **options).reconstruct(measured)
    assert (result.heights_m[:, :10] == 0).all()
    assert result.heights_m.min() == 0
    assert result.heights_m.max() == 2e-5
    assert result.settings["knowledge"]["mask"] == "given"
    assert result.settings["mask"] == "array [32, 32]"


def test_given_volume_and_estimated_mask(measured):
    """Without any knowledge of the truth but a weighed plate: the volume ends in its band."""
    printed = TRUTH.sum() * SMALL.plate_area_m2 / 32**2
    options = {"mask": "estimated", "volume_m3": printed, "max_iterations": 60}
    result = create("sfc", SMALL, **options).reconstruct(measured)
    assert result.settings["knowledge"]["mask"] == "estimated"
    assert 0 < result.settings["knowledge"]["mask_fraction"] < 1
    assert result.counters["volume_m3"] == pytest.approx(printed, rel=0.3)
    assert not any("privileged" in warning for warning in result.warnings)


def test_morozov_stops_at_the_first_iterate_at_the_noise(measured):
    """Told that the noise is what iteration 12 leaves, it stops there and nowhere else, and returns that iterate."""
    free = create("sfc", SMALL, max_iterations=14, discrepancy=0).reconstruct(measured)
    residuals = [entry["residual"] for entry in free.history]
    assert residuals == sorted(residuals, reverse=True)
    level = residuals[11] * 1.0001 / 1.1
    result = create("sfc", SMALL, relative_noise=level).reconstruct(measured)
    assert result.stop_reason == "discrepancy"
    assert len(result.history) == 12
    assert result.history[-1]["discrepancy"] <= 1.1 < result.history[-2]["discrepancy"]
    assert not any("convergence" in warning for warning in result.warnings)


def test_a_start_at_the_noise_is_returned_as_it_is(measured):
    result = create("sfc", SMALL).reconstruct(measured, initial=TRUTH)
    assert (result.stop_reason, result.history) == ("discrepancy", [])
    np.testing.assert_array_equal(result.heights_m, TRUTH)


def test_no_convergence_is_a_warning(measured):
    result = create("sfc", SMALL, max_iterations=2).reconstruct(measured)
    assert result.stop_reason == "max_iterations"
    assert any("no convergence: 2 iterations left" in warning for warning in result.warnings)
    wild = create("sfc", SMALL, variant="baseline", step=1000, max_iterations=3).reconstruct(measured)
    assert np.isfinite(wild.heights_m).all()
    assert any("lower step" in warning for warning in wild.warnings)


def test_unknown_noise_is_a_warning():
    result = create("sfc", SMALL, max_iterations=1).reconstruct(caustic(TRUTH))
    assert any("relative_noise" in warning for warning in result.warnings)


def test_l1_ignores_what_l2_chases(measured):
    """Ten dead pixels of 20: the absolute misfit gets nearer to the truth than the squared one."""
    image = measured.irradiance.copy()
    image[:, 5:60:6, 5:60:6] = 20
    options = {"max_iterations": 60, "discrepancy": 0}
    found = {k: create("sfc", SMALL, data_term=k, **options).reconstruct(CausticImage(image)) for k in ("l1", "l2")}
    assert rmse_um(found["l1"], TRUTH) < FLAT_UM < rmse_um(found["l2"], TRUTH)


def test_backtracking_never_climbs():
    """Lines of 0.5 mm fold the caustic; with too large a first step it still descends in every iteration."""
    options = {"step_control": "backtracking", "step": 20, "variant": "baseline", "max_iterations": 12}
    result = create("sfc", SMALL, **options).reconstruct(caustic(lines(5e-4)))
    objectives = [entry["objective"] for entry in result.history]
    assert objectives == sorted(objectives, reverse=True)
    assert result.history[0]["step"] < result.settings["first_step_m2"]


def test_total_variation_smooths(measured):
    def roughness(weight):
        options = {"total_variation": weight, "max_iterations": 30, "discrepancy": 0}
        heights = create("sfc", SMALL, **options).reconstruct(measured).heights_m
        return np.abs(np.diff(heights)).sum() + np.abs(np.diff(heights, axis=0)).sum()

    assert roughness(0.2) < 0.9 * roughness(0.0)


def test_new_photons_in_every_iteration():
    """The paper's photons: reproducible by the seed, different by it. One wavelength, few pixels: they are wide."""
    scene = Scene(height_samples=8, image_pixels=16, **ONE)
    relief = np.zeros((8, 8))
    relief[3:5, 2:6] = 2e-4
    image = caustic(relief, scene)
    options = {"preset": "paper", "n_photons": 2000, "max_iterations": 2}
    runs = [create("sfc", scene, seed=seed, **options).reconstruct(image) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(runs[0].heights_m, runs[1].heights_m)
    assert np.abs(runs[0].heights_m - runs[2].heights_m).max() > 1e-9
    assert runs[0].settings["simulation"]["placement"] == "random"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"mask": np.zeros((32, 32), bool)}, r"mask \(given\) is False everywhere"),
        ({"mask": "estimated"}, r"mask \(estimated\) is False everywhere.*5%"),
        ({"mask": np.ones((8, 8), bool)}, r"\[8, 8\].*\[32, 32\]"),
        ({"mask": np.full((32, 32), np.nan)}, "mask has values that are not finite"),
        ({"mask": np.full((32, 32), "x")}, "mask is <U1"),
        ({"mask": "nowhere.png"}, "nowhere.png"),
        ({"mask": "oracle"}, "oracle needs the true relief"),
        ({"volume_m3": "oracle"}, "oracle needs the true relief"),
        ({"oracle_heights_m": np.zeros((8, 8))}, r"oracle_heights_m has shape \[8, 8\]"),
        ({"oracle_heights_m": np.ones((32, 32), int)}, "oracle_heights_m is int64"),
        ({"oracle_heights_m": np.full((32, 32), np.inf)}, "oracle_heights_m is not finite"),
        ({"oracle_heights_m": np.zeros((32, 32))}, "False everywhere"),
        ({"oracle_heights_m": -np.ones((32, 32)), "mask": "none"}, "nothing was printed"),
    ],
)
def test_bad_knowledge_is_refused(options, words):
    with pytest.raises(InputError, match=words) as caught:
        create("sfc", SMALL, **options).reconstruct(CausticImage(np.ones((1, 64, 64))))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"variannt": "baseline"}, "sfc.variannt: unknown key"),
        ({"variant": "adam"}, "sfc.variant"),
        ({"data_term": "l3"}, "data_term"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"step": 0.0}, "step"),
        ({"shrinkage": float("nan")}, "shrinkage"),
        ({"volume_m3": -1.0}, "volume_m3"),
        ({"volume_m3": "lots"}, "printed volume"),
        ({"mask": 7}, "give a path or an array"),
        ({"highest_m": 0.0}, "highest_m"),
        ({"relative_noise": 0.0}, "relative_noise"),
        ({"variant": "baseline", "mask": "estimated"}, "the baseline has no priors and takes no mask"),
        ({"preset": "paper", "step_control": "backtracking"}, "step_control=fixed"),
        ({"variant": "landweber_wavelet", "wavelet": "db99"}, "db99"),
        ({"variant": "landweber_wavelet", "wavelet_levels": 6}, "6 wavelet levels"),
        ({"finest_pixels": 48}, "48"),
    ],
)
def test_bad_options_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        create("sfc", SMALL, **options).reconstruct(CausticImage(np.ones((1, 64, 64))))
