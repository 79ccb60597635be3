"""What every reconstruction method owes its caller, whatever it does inside: one suite over all of ``ALL_METHODS``.

Networks are tiny and their weights random, so nothing here asks how good a relief is; tests of single methods do.
"""

import dataclasses
import json
import math
from typing import get_args

import numpy as np
import pytest
import torch

from nets.reconstruct.methods import ALL_METHODS, create
from tests.tiny_networks import save_network
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.kernels.trace import FATE_NAMES
from warp_caustics.reconstruct.base import CausticImage, Progress, Reconstruction, StopReason
from warp_caustics.simulator import CausticSimulator

OPTIONS = {
    "auto": {"max_iterations": 4},
    "direct": {"refine_iterations": 4},
    # To ask for a bench as usual takes three times as long as all else: one test here does.
    "fibres": {"refine_iterations": 3, "max_iterations": 3, "jumps": 1, "set_up": "known"},
    "nsfc": {"max_iterations": 3, "n_photons": 4000},
    "nsfc-unrolled": {"max_iterations": 3, "refine_iterations": 3},
    "refine": {"max_iterations": 6},
    "sfc": {"max_iterations": 6},
    "transport": {"cells": 32, "max_iterations": 6},
    "hcccd": {"cells": 16, "max_iterations": 2},
}
NETWORKS = {
    "direct": {"weights": "direct"},
    "fibres": {"weights": "direct"},
    "nsfc": {"weights": "updater", "denoiser_weights": "denoiser"},
    "nsfc-unrolled": {"weights": "unrolled"},
}
DIVIDES_EXPOSURE = {"auto", "direct", "fibres", "refine", "transport", "hcccd"}
"""Methods that find the exposure, or know ratios of light only; the others warn of it."""
TAKES_NO_START = {"direct", "fibres"}
SEES_BRIGHT_MASKED_PIXELS = set(NETWORKS)
"""A masked pixel that is brighter than its neighbours stays in what a network is shown: a saturated one is a fact."""

every_method = pytest.mark.parametrize("name", list(ALL_METHODS))


def test_no_method_is_forgotten():
    assert set(OPTIONS) == set(ALL_METHODS)


@pytest.fixture(scope="module")
def image(scene, heights):
    """Lines whose light crosses, with 0.5 % of noise."""
    clean = CausticSimulator(scene)(torch.tensor(heights, dtype=torch.float32)).numpy()
    noise = np.random.default_rng(0).standard_normal(clean.shape)
    return CausticImage((clean + 0.005 * noise).astype(np.float32), np.full(3, 0.005))


@pytest.fixture(scope="module")
def make(scene, tmp_path_factory):
    """A fresh method on tiny networks; no network is shipped."""
    folder = tmp_path_factory.mktemp("networks")
    kinds = {kind for options in NETWORKS.values() for kind in options.values()}
    files = {kind: save_network(folder, kind, scene, spread=0.05) for kind in kinds}

    def made(name, **options):
        weights = {key: files[kind] for key, kind in NETWORKS.get(name, {}).items()}
        return create(name, scene, **(weights | OPTIONS[name] | options))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nets.shipped.FOLDER", folder / "none")
        yield made


@dataclasses.dataclass
class Run:
    """A reconstruction and what it told on the way."""

    result: Reconstruction
    told: list[Progress]


@pytest.fixture(scope="module")
def plain(make, image):
    """The undisturbed run of each method, made once."""
    known = {}

    def run(name):
        if name not in known:
            told = []
            known[name] = Run(make(name).reconstruct(image, progress=told.append), told)
        return known[name]

    return run


@every_method
def test_the_record_is_complete(name, plain, scene):
    result, n, m = plain(name).result, scene.height_samples, scene.image_pixels
    assert result.method == ("refine" if name == "auto" else name)
    assert result.heights_m.shape == (n, n) and result.heights_m.dtype == np.float64
    assert result.image.shape == (3, m, m)
    assert np.isfinite(result.heights_m).all() and np.isfinite(result.image).all()
    assert result.heights_m.min() > -scene.base_thickness_m
    assert math.isfinite(result.residual) and result.residual >= 0
    assert result.stop_reason in get_args(StopReason)
    assert [entry["iteration"] for entry in result.history] == list(range(1, len(result.history) + 1))
    times = [entry["elapsed_s"] for entry in result.history]
    assert times == sorted(times) and all(isinstance(entry["stage"], str) for entry in result.history)
    assert all(entry["residual"] is None or entry["residual"] >= 0 for entry in result.history)
    assert "resimulation" in result.timings_s and all(seconds >= 0 for seconds in result.timings_s.values())
    energy = result.counters["energy"]
    assert sum(np.array(energy[fate]) for fate in FATE_NAMES) == pytest.approx(np.ones(3), abs=1e-6)
    assert result.settings["simulation"]["n_photons"] > 0
    json.dumps([result.settings, result.counters, result.history], default=float)
    assert isinstance(result.warnings, tuple) and all(isinstance(line, str) for line in result.warnings)
    assert not any("\n" in line for line in result.warnings)
    spread = result.uncertainty_m
    assert (spread is None) == bool(result.no_uncertainty)
    assert result.trust is not None
    assert result.trust.left_at_all == pytest.approx(result.residual, rel=1e-6), "whatever pixels were judged"
    assert result.trust.pixels is not None or result.trust.left == result.trust.left_at_all
    assert result.trust.line.startswith(("explained ", "not explained: "))
    assert "\n" not in result.trust.line + result.no_uncertainty
    assert spread is None or (spread.shape == (n, n) and np.isfinite(spread).all() and (spread >= 0).all())


@every_method
def test_progress_counts_up_and_ends(name, plain):
    told, history = plain(name).told, plain(name).result.history
    assert len(told) >= len(history) >= 1
    numbers, times = [state.iteration for state in told], [state.elapsed_s for state in told]
    assert numbers == sorted(set(numbers)) and numbers[0] == 1
    assert times == sorted(times)
    assert all(state.iteration <= state.total for state in told)
    assert all(state.stage and isinstance(state.residual, float) for state in told)


@every_method
def test_two_runs_are_the_same(name, plain, make, image):
    """To the bit, on a CPU."""

    def without_times(history):
        return [{key: value for key, value in entry.items() if key != "elapsed_s"} for entry in history]

    first, second = plain(name).result, make(name).reconstruct(image)
    np.testing.assert_array_equal(first.heights_m, second.heights_m)
    np.testing.assert_array_equal(first.image, second.image)
    assert first.residual == second.residual and first.warnings == second.warnings
    assert without_times(first.history) == without_times(second.history)


@every_method
@pytest.mark.parametrize("share", [0.0, 0.6], ids=["at once", "later"])
def test_interruption_keeps_the_best_so_far(name, share, plain, make, image, scene):
    """Ctrl-C comes out of the progress callback, as the terminal delivers it; what was told until then is on record."""
    at = max(1, int(share * len(plain(name).told)))
    told = []

    def interrupt(state):
        told.append(state)
        if len(told) == at:
            raise KeyboardInterrupt

    result = make(name).reconstruct(image, progress=interrupt)
    assert result.stop_reason == "interrupted" and len(told) == at
    assert np.isfinite(result.heights_m).all() and result.heights_m.shape == (scene.height_samples,) * 2
    assert 1 <= len(result.history) <= at
    assert "resimulation" in result.timings_s and "energy" in result.counters
    if name not in NETWORKS and share:
        flat = np.linalg.norm(1 - image.irradiance) / np.linalg.norm(image.irradiance)
        assert result.residual < flat


@every_method
def test_time_limit(name, plain, make, image):
    """The first step that ends after it is the last."""
    result = make(name, max_time_s=1e-6).reconstruct(image)
    assert result.stop_reason == "max_time"
    assert np.isfinite(result.heights_m).all()
    assert len(result.history) <= max(2, len(plain(name).result.history) / 2)


@every_method
def test_masked_pixels_do_not_count(name, make, image):
    """Dark, no number, or far too bright under the mask: the same heights, on the same bench."""
    mask = np.ones(image.irradiance.shape, bool)
    mask[:, 20:23, 30:33] = False
    garbage = [0.0, np.nan] + [1e3] * (name not in SEES_BRIGHT_MASKED_PIXELS)
    found = []
    for value in garbage:
        dirty = np.where(mask, image.irradiance, np.float32(value))
        asked = {"set_up": None} if name == "fibres" else {}
        result = make(name, **asked).reconstruct(CausticImage(dirty, image.noise_std, mask))
        found.append(result)
        assert math.isfinite(result.residual)
    for other in found[1:]:
        np.testing.assert_array_equal(found[0].heights_m, other.heights_m)
        assert found[0].residual == other.residual


@every_method
@pytest.mark.parametrize("exposure", [0.5, 2.0])
def test_dim_and_bright_light(name, exposure, plain, make, image):
    """The lamp is not what it was: divided out, or warned of."""
    seen = CausticImage(image.irradiance * np.float32(exposure), image.noise_std * exposure)
    result, nominal = make(name).reconstruct(seen), plain(name).result
    assert np.isfinite(result.heights_m).all()
    assert any("of the light" in line or "of the radiosity" in line for line in result.warnings)
    if name in DIVIDES_EXPOSURE:
        change = result.heights_m - nominal.heights_m
        assert result.residual == pytest.approx(nominal.residual, abs=0.01)
        # Lines that 16 samples do not tell are 11 or 12, by an exposure that is found to 1e-4: 2.7 % of heights.
        most = 0.04 if name == "fibres" else 0.02
        assert np.sqrt((change**2).mean()) < most * np.sqrt((nominal.heights_m**2).mean()) + 1e-6


@pytest.mark.parametrize("name", [name for name in ALL_METHODS if name not in NETWORKS])
def test_light_of_the_scene_itself(name, make, plain, image, scene):
    """Another lamp in scene and image is the same measurement; networks bring their own scene (``test_methods.py``)."""
    bright = scene.model_copy(update={"radiosity_W_m2": (2.0, 3.0, 0.5)})
    scale = np.array(bright.radiosity_W_m2, dtype=np.float32)
    seen = CausticImage(image.irradiance * scale[:, None, None], image.noise_std * scale)
    found = create(name, bright, **OPTIONS[name]).reconstruct(seen)
    np.testing.assert_allclose(found.heights_m, plain(name).result.heights_m, atol=2e-6)


@every_method
def test_a_start_is_used(name, plain, make, image, heights):
    """Or refused in words."""
    result = make(name).reconstruct(image, initial=0.9 * heights)
    told = [line for line in result.warnings if "takes no start" in line]
    if name in TAKES_NO_START:
        np.testing.assert_array_equal(result.heights_m, plain(name).result.heights_m)
        assert len(told) == 1
    else:
        assert not told
        assert np.abs(result.heights_m - plain(name).result.heights_m).max() > 1e-5


def changed(image, **changes):
    return dataclasses.replace(image, **changes)


BAD = {
    "not a number": (lambda i: changed(i, irradiance=i.irradiance * np.nan), None, InputError, "not finite"),
    "one infinite pixel": (
        lambda i: changed(i, irradiance=np.where(np.arange(64) == 7, np.inf, i.irradiance)),
        None,
        InputError,
        "not finite",
    ),
    "no light": (lambda i: changed(i, irradiance=0 * i.irradiance), None, InputError, "nothing to see"),
    "negative light": (lambda i: changed(i, irradiance=-i.irradiance), None, InputError, "nothing to see"),
    "another size": (
        lambda i: changed(i, irradiance=i.irradiance[:, :32, :32]),
        None,
        MismatchError,
        r"\[3, 32, 32\].*\[3, 64, 64\]",
    ),
    "one colour": (lambda i: changed(i, irradiance=i.irradiance[:1]), None, MismatchError, r"\[1, 64, 64\]"),
    "all masked": (lambda i: changed(i, mask=i.irradiance < -1e9), None, InputError, "all pixels are masked"),
    "another mask": (lambda i: changed(i, mask=np.ones((64, 64), bool)), None, MismatchError, r"mask has shape \[64"),
    "a start of another size": (lambda i: i, np.zeros((8, 8)), InputError, r"\[8, 8\].*\[16, 16\]"),
    "a start that is no number": (lambda i: i, np.full((16, 16), np.nan), InputError, "not finite"),
    "a start with a hole": (lambda i: i, np.full((16, 16), -1.0), InputError, "cuts through"),
}


@every_method
def test_bad_input_is_refused(name, make, image):
    """In one line, with the fix, before anything is computed."""
    method = make(name)
    for case, (spoiled, initial, error, words) in BAD.items():
        told = []
        with pytest.raises(error, match=words) as caught:
            method.reconstruct(spoiled(image), initial=initial, progress=told.append)
        assert "\n" not in str(caught.value) and "; " in str(caught.value), case
        assert not told, case
