"""Methods with networks: same interface, same record, best so far on Ctrl-C, and plain refusals."""

import dataclasses

import numpy as np
import pytest
import torch

from nets.reconstruct.direct import Direct
from nets.reconstruct.direct_options import DirectOptions
from nets.reconstruct.methods import ALL_METHODS, create
from nets.reconstruct.network_io import network_image
from nets.reconstruct.refinement import Refinement, RefinementOptions
from nets.reconstruct.uncertainty import BARE_M, DIRECT_CALIBRATION
from nets.reconstruct.with_causes import explained
from nets.training.tasks import ITERATED_STEPS
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.found_bench import rest_causes
from warp_caustics.found_bench.rest_causes import Cause
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.methods import METHODS
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

UNROLLED = {"config": {"unrolling": {"last_steps": 3}}}
DENOISED = {"config": {"denoiser_weights": "denoiser.safetensors"}}


@pytest.fixture
def made(saved, scene):
    """Makes a method on tiny networks."""

    def make(name, *, is_random=False, **options):
        if name == "direct":
            options["weights"] = saved("direct", is_random=is_random)
        elif name == "nsfc-unrolled":
            options["weights"] = saved("unrolled", is_random=is_random, training=UNROLLED)
        else:
            options.setdefault("n_photons", 5000)
            kind = "updater" if options.get("use_gradient", True) else "updater-no-gradient"
            options["weights"] = saved(kind, is_random=is_random, training=DENOISED)
            if options.get("denoise", True):
                options["denoiser_weights"] = saved("denoiser")
        return create(name, scene, **options)

    return make


CASES = [
    ("direct", {"refine_iterations": 3}),
    ("direct", {"refine": False, "symmetries": False}),
    ("nsfc", {"max_iterations": 2}),
    ("nsfc", {"max_iterations": 2, "denoise": False, "photons": "lattice"}),
    ("nsfc", {"max_iterations": 2, "use_gradient": False}),
    ("nsfc-unrolled", {"refine": False}),
    ("nsfc-unrolled", {"symmetries": True, "refine_iterations": 2}),
]


@pytest.mark.parametrize(("name", "options"), CASES)
def test_record_is_complete(made, scene, image, name, options):
    """Fresh networks answer with what they were given: flat."""
    seen = []
    result = made(name, **options).reconstruct(image, progress=seen.append)
    n, m = scene.height_samples, scene.image_pixels
    assert result.method == name
    assert result.heights_m.shape == (n, n) and result.heights_m.dtype == np.float64
    assert result.image.shape == (3, m, m)
    assert len(result.history) >= 1 and all(entry["elapsed_s"] > 0 for entry in result.history)
    assert len(seen) >= len(result.history)
    assert result.settings["network"]["content_hash"]
    assert result.counters["energy"]["landed"]
    if not options.get("refine", name != "nsfc"):
        assert np.abs(result.heights_m).max() < 1e-12
    assert (result.uncertainty_m is not None) == (name == "direct" and options.get("symmetries", True))


def test_the_papers_method_does_ten_steps(made, image):
    """Figures 5 to 7 of the supplement: "after ten update iterations"; trainings are judged by as many."""
    method = made("nsfc", keep_iterates=True)
    result = method.reconstruct(image)
    assert result.counters["steps"] == len(result.history) == len(result.iterates_m) - 1 == 10
    assert method.iterations == ITERATED_STEPS


def test_direct_is_the_mean_of_eight_answers_and_their_spread(made, image):
    method = made("direct", is_random=True, refine=False, bench_uncertainty=False, flatness_m=0, causes=False)
    result = method.reconstruct(image)
    assert result.counters["symmetries"] == 8
    answers = []
    seen = network_image(image, method.scene, method.scene, torch.device("cpu"))
    for turns in range(4):
        for is_flipped in (False, True):
            x = torch.rot90(seen, turns, (-2, -1))
            with torch.no_grad():
                y = method.network.module((x.flip(-1) if is_flipped else x)[None])[0]
            answers.append(torch.rot90(y.flip(-1) if is_flipped else y, -turns, (-2, -1)))
    answers = torch.stack(answers).double()
    scale = float(answers.abs().max())
    np.testing.assert_allclose(result.heights_m, answers.mean(0), atol=1e-5 * scale)
    np.testing.assert_allclose(result.uncertainty_m, DIRECT_CALIBRATION.scale * answers.std(0), atol=1e-5 * scale)
    # Of a base that nobody says is a plane, what answers have in common is counted, too.
    unsaid = made("direct", is_random=True, refine=False, bench_uncertainty=False, causes=False).reconstruct(image)
    np.testing.assert_allclose(unsaid.uncertainty_m, np.hypot(result.uncertainty_m, BARE_M), atol=1e-5 * scale)
    assert 1e-4 * scale < BARE_M, "else this shows nothing"


def test_the_bench_is_part_of_the_uncertainty_and_its_numbers_are_told(made, image):
    network = made("direct", is_random=True, refine=False, bench_uncertainty=False, flatness_m=0).reconstruct(image)
    whole = made("direct", is_random=True, refine=False, priors={"gap_m": 1e-4}).reconstruct(image)
    assert "uncertainty" not in network.counters and (network.uncertainty_m < whole.uncertainty_m).all()
    parts = whole.counters["uncertainty"]
    rms = {"network": network.uncertainty_m, "whole": whole.uncertainty_m}
    rms = {name: 1e6 * float(np.sqrt(np.mean(values**2))) for name, values in rms.items()}
    assert parts["network_um"] == pytest.approx(rms["network"])
    assert np.hypot(parts["network_um"], parts["bench_um"]) == pytest.approx(rms["whole"])
    assert parts["numbers"]["gap_m"]["sigma"] == 1e-4 and set(parts["numbers"]) >= {"index_offset", "magnification"}


def test_the_rest_of_the_image_is_asked_of_every_method(made, image):
    """``direct`` asks itself; of others the same is asked afterwards, once."""
    result = made("direct", is_random=True, refine=False).reconstruct(image)
    rest = result.counters["rest"]
    assert (
        0 < rest["beyond_noise"] < 1
        and rest["ratio"] > 0
        and rest["line"].startswith(f"{100 * rest['beyond_noise']:.2g}")
    )
    method = made("direct", is_random=True, refine=False, causes=False)
    plain = method.reconstruct(image)
    assert "rest" not in plain.counters and (plain.uncertainty_m < result.uncertainty_m).all()
    later = explained(plain, image, method.scene, "cpu")
    assert later.counters["rest"]["beyond_noise"] == pytest.approx(rest["beyond_noise"], rel=1e-3)
    assert explained(later, image, method.scene, "cpu") is later


def test_a_bench_that_looks_like_another_widens_the_uncertainty(made, image, monkeypatch):
    """By twice what the image says, for heights keep half of it: it is told, and warned of only where it is in no part."""
    plain = made("direct", is_random=True, refine=False).reconstruct(image)
    lamp = Cause("vergence_per_m", "a lamp", 0.5, 0.1, is_bench=True)
    monkeypatch.setattr(rest_causes, "_bench_causes", lambda *arguments: iter([lamp]))
    wide = made("direct", is_random=True, refine=False).reconstruct(image)
    sigma = wide.counters["uncertainty"]["numbers"]["vergence_per_m"]["sigma"]
    assert sigma == pytest.approx(np.sqrt(0.02**2 + 1.0**2 + 0.1**2))
    assert wide.uncertainty_m.mean() > plain.uncertainty_m.mean()
    assert "a lamp: 0.5 +- 0.1" in wide.counters["rest"]["line"]
    assert not any("a lamp: 0.5 +- 0.1" in line for line in wide.warnings)
    bare = made("direct", is_random=True, refine=False, bench_uncertainty=False).reconstruct(image)
    assert any("a lamp: 0.5 +- 0.1" in line for line in bare.warnings) and bare.counters["doubt"]["is_doubtful"]
    exact = made("direct", is_random=True, refine=False, priors={"vergence_per_m": 0.0}).reconstruct(image)
    assert exact.counters["uncertainty"]["numbers"]["vergence_per_m"]["sigma"] == pytest.approx(
        np.sqrt(1.0**2 + 0.1**2)
    )


def test_refinement_never_raises_the_residual(made, image):
    """A flat answer improves; with a step that ruins it, the answer is kept."""
    plain = made("direct", refine=False).reconstruct(image)
    better = made("direct", symmetries=False, refine_iterations=30, refine_step_m=5e-5).reconstruct(image)
    assert better.counters["refinement"] == "kept" and better.residual < 0.98 * plain.residual
    best = dataclasses.replace(image, irradiance=plain.image)
    kept = made("direct", symmetries=False, refine_iterations=1, refine_step_m=1e-4).reconstruct(best)
    assert kept.counters["refinement"] == "no better, discarded"
    np.testing.assert_array_equal(kept.heights_m, plain.heights_m)


@pytest.mark.parametrize(("name", "symmetries"), [("direct", False), ("nsfc-unrolled", False), ("nsfc", None)])
def test_what_was_refined_at_fewer_pixels_is_judged_there_by_every_method(made, scene, image, name, symmetries):
    """And at all pixels where the refinement was not kept."""
    options = {"refine": True, "refine_iterations": 30, "refine_step_m": 5e-5, "refine_pixels": scene.image_pixels // 2}
    more = {"max_iterations": 1, "photons": "lattice"} if symmetries is None else {"symmetries": symmetries}
    result = made(name, **options, **more).reconstruct(image)
    assert result.counters["refinement"] == "kept"
    assert result.trust.pixels == scene.image_pixels // 2 and "pixels, noise and simulation leave" in result.trust.line
    assert result.trust.left_at_all == pytest.approx(result.residual, rel=1e-6)
    ruined = made(name, **options | {"refine_iterations": 1, "refine_step_m": 1e-4}, **more)
    best = dataclasses.replace(image, irradiance=made(name, refine=False, **more).reconstruct(image).image)
    kept = ruined.reconstruct(best)
    assert kept.counters["refinement"] == "no better, discarded" and kept.trust.pixels is None


def test_refinement_moves_only_where_the_network_is_unsure(scene, image, heights):
    options = RefinementOptions(refine_iterations=20, refine_step_m=2e-5, refine_pixels=64)
    refinement = Refinement(scene, options, torch.device("cpu"))
    judge = Resimulation(CausticSimulator(scene), image)
    start = 0.9 * heights
    spread = np.zeros_like(heights)
    spread[:8] = 1e-3
    found = refinement(judge, start, 0.0, None, spread)
    free = refinement(judge, start, 0.0, None)
    assert found.is_better and free.is_better
    np.testing.assert_array_equal(found.heights[8:], start[8:])
    np.testing.assert_allclose(found.heights[:8], free.heights[:8], rtol=1e-4, atol=1e-9)
    assert np.abs(free.heights[8:] - start[8:]).max() > 1e-6


def test_time_limit(made, image):
    result = made("direct", max_time_s=1e-6).reconstruct(image)
    assert result.stop_reason == "max_time" and result.counters["refinement"] == "no time left"


def test_iterates_and_start(made, scene, image, heights):
    """The first iterate is the start, the last the result; a fresh updater moves nothing."""
    for name in ("nsfc", "nsfc-unrolled"):
        method = made(name, keep_iterates=True, max_iterations=2, refine=False)
        result = method.reconstruct(image, initial=heights)
        assert result.iterates_m.shape == (3, scene.height_samples, scene.height_samples)
        np.testing.assert_allclose(result.iterates_m[0], heights, atol=1e-9)
        np.testing.assert_allclose(result.heights_m, result.iterates_m[-1], atol=1e-9)
        assert result.history[0]["residual"] < 0.5


def test_wavelengths_denoised_one_by_one_are_those_denoised_together(made, scene):
    method = made("nsfc")
    torch.nn.init.normal_(method.denoiser.module.contract.weight, std=0.3)
    images = torch.rand(2, scene.n_wavelengths, scene.image_pixels, scene.image_pixels)
    with torch.no_grad():
        together = method.denoiser.module(images)
    found = method.denoised(images)
    torch.testing.assert_close(found, together, rtol=0, atol=1e-5)
    assert float((found - images).abs().max()) > 1e-3


def test_photons_repeat_with_the_seed(made, image):
    results = [made("nsfc", is_random=True, max_iterations=1, seed=seed).reconstruct(image) for seed in (3, 3, 4)]
    np.testing.assert_array_equal(results[0].heights_m, results[1].heights_m)
    assert not np.array_equal(results[0].heights_m, results[2].heights_m)


def test_brightness_does_not_matter(made, saved, scene, image):
    """Twice the light through the plate and in the image: the same heights."""
    bright = scene.model_copy(update={"radiosity_W_m2": (2.0, 3.0, 0.5)})
    brighter = CausticImage(image.irradiance * np.array([2.0, 3.0, 0.5])[:, None, None])
    path = saved("direct", is_random=True)
    found = [
        Direct(s, DirectOptions(weights=path, refine=False)).reconstruct(i)
        for s, i in ((scene, image), (bright, brighter))
    ]
    np.testing.assert_allclose(found[0].heights_m, found[1].heights_m, atol=1e-4 * np.abs(found[0].heights_m).max())


def test_dead_pixels_take_their_neighbours(scene):
    irradiance = np.ones((3, 64, 64))
    mask = np.ones(irradiance.shape, bool)
    irradiance[0, 5, 5], mask[0, 5, 5] = 0.0, False
    irradiance[1, 7, 7], mask[1, 7, 7] = 9.0, False
    seen = network_image(CausticImage(irradiance, mask=mask), scene, scene, torch.device("cpu"))
    assert seen[0, 5, 5] == pytest.approx(1) and seen[1, 7, 7] == 9 and seen[2].eq(1).all()


def test_registry_has_all_methods():
    assert {"auto", "direct", "fibres", "nsfc", "nsfc-unrolled", *METHODS} == set(ALL_METHODS)


@pytest.mark.parametrize(
    ("name", "options", "error", "reason"),
    [
        ("direct", {}, InputError, "nsfc train direct --fresh"),
        ("nsfc", {}, InputError, "training.denoiser_weights=DENOISER"),
        ("nsfc", {"use_gradient": False}, InputError, "network.use_gradient=false"),
        ("nsfc-unrolled", {}, InputError, "nsfc train unrolled --fresh"),
        ("direct", {"weights": "none.safetensors"}, InputError, "none.safetensors"),
        ("direct", {"refine_step": 1}, InputError, "direct.refine_step: unknown key"),
        ("magic", {}, InputError, "auto, direct, fibres, nsfc"),
    ],
)
def test_refusals(shipped, scene, name, options, error, reason):
    with pytest.raises(error, match=reason) as caught:
        create(name, scene, **options)
    assert "\n" not in str(caught.value)


def test_wrong_kind_and_wrong_ablation(saved, scene):
    with pytest.raises(MismatchError, match="holds a unrolled network, not a direct"):
        create("direct", scene, weights=saved("unrolled"))
    with pytest.raises(MismatchError, match="trained with gradient, asked is one without"):
        create("nsfc", scene, weights=saved("updater"), denoise=False, use_gradient=False)


def test_another_scene_is_refused_with_the_command(saved, image):
    other = Scene(height_samples=16, image_pixels=64, base_thickness_m=5e-3)
    path = saved("direct")
    with pytest.raises(
        MismatchError, match=r"base_thickness_m is 0.003 there and 0.005 here; images differ by"
    ) as caught:
        create("direct", other, weights=path)
    assert "nsfc train direct --fresh" in str(caught.value) and "scene.base_thickness_m=0.005" in str(caught.value)
    with pytest.raises(MismatchError, match="image_pixels is 64 there and 128 here"):
        create("nsfc-unrolled", Scene(height_samples=16, image_pixels=128), weights=saved("unrolled"))
    with pytest.raises(MismatchError, match="radiosity"):
        dark = Scene(height_samples=16, image_pixels=64, radiosity_W_m2=(1, 1, 0))
        create("nsfc-unrolled", dark, weights=saved("unrolled"))


def test_a_scene_that_hardly_differs_is_used_with_a_warning(saved, image):
    other = Scene(height_samples=16, image_pixels=64, base_thickness_m=3.05e-3)
    result = create("direct", other, weights=saved("direct"), refine=False).reconstruct(image)
    assert any("used because images of both differ by 0." in warning for warning in result.warnings)


@pytest.mark.parametrize("exposure", [1.0, 0.93, 1.5])
def test_exposure_is_divided_out(made, image, exposure):
    """A lamp that is brighter or dimmer than when the flat frame was taken changes nothing but the image's scale."""
    nominal = made("direct").reconstruct(image)
    seen = dataclasses.replace(image, irradiance=exposure * image.irradiance)
    found = made("direct").reconstruct(seen)
    lost = nominal.counters["exposure"]
    np.testing.assert_allclose(found.counters["exposure"], np.multiply(lost, exposure), rtol=2e-3)
    np.testing.assert_allclose(found.heights_m, nominal.heights_m, atol=2e-6)
    assert found.residual == pytest.approx(nominal.residual, rel=0.02)
    np.testing.assert_allclose(found.image, exposure * nominal.image, rtol=0.02, atol=0.02)
    assert any("of the light that this scene gives" in warning for warning in found.warnings) == (exposure != 1)


@pytest.mark.parametrize("method", ["direct", "fibres"])
def test_a_network_of_few_steps_is_named_and_its_spread_is_no_uncertainty(method, saved, scene, image):
    """After 4 steps all symmetries answer alike, and a result 28 um wrong was said to be certain to 0.2 um."""
    options = {"max_iterations": 2, "set_up": "known"} | ({"jumps": 1} if method == "fibres" else {})
    result = create(method, scene, weights=saved("direct", training={"steps": 4}), **options).reconstruct(image)
    assert result.uncertainty_m is None
    assert "was trained for 4 steps only" in result.no_uncertainty
    assert any("was trained for 4 steps, fewer than 1000" in warning for warning in result.warnings)
    enough = create(method, scene, weights=saved("direct", training={"steps": 1000}), **options).reconstruct(image)
    assert enough.uncertainty_m is not None and enough.no_uncertainty == ""
    assert not any("fewer than 1000" in warning for warning in enough.warnings)


def test_every_network_of_few_steps_is_named(saved, scene):
    from nets.shipped import find_network, shipped_weights
    from nets.weights import weights_info

    for kind in ("direct", "unrolled", "updater", "denoiser"):
        found = find_network(kind, scene, path=saved(kind, training={"steps": 999}))
        assert found.few_steps == 999 and "trained for 999 steps" in found.warnings[-1]
    assert all(weights_info(file).training["steps"] >= 1000 for file in shipped_weights())


def test_samples_are_given_on_request_and_change_nothing_else(made, image):
    """Random networks, whose answers differ everywhere: samples lie around the result and are no worse."""
    plain = made("direct", is_random=True, refine_iterations=2, set_up="known").reconstruct(image)
    result = made("direct", is_random=True, refine_iterations=2, set_up="known", samples=3).reconstruct(image)
    assert plain.samples_m is None and "samples" not in plain.counters
    np.testing.assert_array_equal(result.heights_m, plain.heights_m)
    np.testing.assert_array_equal(result.uncertainty_m, plain.uncertainty_m)
    assert result.samples_m.shape == (3, *result.heights_m.shape)
    told = result.counters["samples"]
    assert told["count"] == 3 and told["line"].startswith("3: they ") and result.timings_s["samples"] > 0
    assert (np.array(told["residuals"]) < 1.1 * result.residual).all()


def test_one_answer_has_no_samples_and_says_why(made, image):
    result = made("direct", refine=False, symmetries=False, samples=2).reconstruct(image)
    assert result.samples_m is None and "several symmetries" in result.counters["samples"]["line"]


def test_ctrl_c_among_samples_keeps_the_result(made, image):
    def stop(state):
        if state.stage.startswith("samples"):
            raise KeyboardInterrupt

    method = made("direct", is_random=True, refine_iterations=2, set_up="known", samples=3)
    result = method.reconstruct(image, progress=stop)
    assert result.samples_m is None and "cut short" in result.counters["samples"]["line"]
    assert result.counters["refinement"] != "no time left"
