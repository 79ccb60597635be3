"""Lines from a network's answer and an image, on a small scene."""

import dataclasses

import numpy as np
import pytest
import torch

import nets.reconstruct.fibres.lines_of_image as lines_of_image
from nets.reconstruct.bench_search import Glance
from nets.reconstruct.direct import Direct
from nets.reconstruct.fibres.bench.bench_of_lines import TOLD_BY_LINES
from nets.reconstruct.fibres.image.discrepancy import LARGEST_OF_NOISE
from nets.reconstruct.fibres.method import Fibres
from nets.reconstruct.methods import create
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N, noisy_image
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_record import is_picture_larger
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.wavy_model import WavyModel, knot_counts
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.seen_camera.pixel_means import Lay, pixel_means
from warp_caustics.reconstruct.seen_camera.point_spread import FineLight
from warp_caustics.setup.optical import with_optical_values
from warp_caustics.simulator import CausticSimulator
from warp_caustics.way_of_light import way_of_light_m


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def image(model):
    return noisy_image(model)


@pytest.mark.parametrize("exposure", [1.0, 0.95])
def test_lines_replace_an_answer_that_is_nearly_right(model, image, answering, exposure):
    """Whatever the exposure: it is told by the sum of the light."""
    truth = model.heights(LINES).double().numpy()
    wrong = truth + 1e-5 * np.random.default_rng(1).standard_normal(truth.shape)
    wrong[20:24, 20:24] += 1e-4
    seen = CausticImage(image.irradiance * np.float32(exposure), image.noise_std * exposure)
    result = answering(wrong, refine_pixels=2 * N).reconstruct(seen)
    np.testing.assert_allclose(result.counters["exposure"], exposure, rtol=1e-3)
    error = 1e6 * float(np.sqrt(np.mean((result.heights_m - truth) ** 2)))
    assert result.counters["explained_by"] == "fibres" and error < 1.0
    assert result.fibres_m.shape == (3, 6) and result.method == "fibres"
    assert result.residual < result.counters["residual_of_network"]
    assert not np.any(result.counters["camera"]["shift_px"]), "channels that lie together are found so"
    assert "refinement" not in result.counters, "nothing but noise is left"
    assert result.counters["discrepancy"] == pytest.approx(1, abs=0.1)
    # Beside a usual lattice 1.2 % of the image would be left, and 0.66 % beyond its noise.
    assert result.residual < 0.0105 and result.counters["rest"]["beyond_noise"] < 0.003
    assert [warning.split(" has ")[0] for warning in result.warnings] == ["the image"] * (exposure != 1)
    assert result.uncertainty_m is None, "one answer has no spread"
    heights = [entry["elapsed_s"] for entry in result.history]
    assert heights == sorted(heights)


def test_samples_of_lines_are_lines_that_explain_the_image_as_well(model, image, answering):
    truth = model.heights(LINES).double().numpy()
    wrong = truth + 1e-5 * np.random.default_rng(1).standard_normal(truth.shape)
    result = answering(wrong, refine_pixels=2 * N, samples=4, set_up="known").reconstruct(image)
    assert result.counters["explained_by"] == "fibres" and result.samples_m.shape == (4, N, N)
    told = result.counters["samples"]
    assert told["count"] == 4 and max(told["residuals"]) < 1.1 * result.residual
    apart = result.samples_m.std(axis=0)
    assert 1e-8 < apart[truth > 1e-4].max() < 1e-5 and apart[truth == 0].mean() < 1e-7


@pytest.mark.parametrize("set_up", ["known", "estimate"])
def test_a_plate_that_is_not_made_of_lines_keeps_the_answer(model, image, answering, set_up):
    """A smooth bump, exactly found by the network: lines cannot do better."""
    centre = (np.arange(N) + 0.5) / N - 0.5
    bump = 1e-4 * np.exp(-(centre[:, None] ** 2 + centre[None] ** 2) / 0.08)
    seen = light_of(SCENE, bump).numpy()
    result = answering(bump, refine=False, jumps=0, most_lines=4, set_up=set_up).reconstruct(CausticImage(seen))
    assert result.method == "fibres"
    assert result.counters["explained_by"] == "network" and result.fibres_m is None
    elapsed = [entry["elapsed_s"] for entry in result.history]
    assert elapsed == sorted(elapsed)
    np.testing.assert_allclose(result.heights_m, bump, atol=1e-9)


def moved_picture(truth, stray):
    """A plate whose picture is moved by 1.5 pixels, under stray light; and by how much [m]."""
    shift_m = 1.5 * SCENE.plate_size_m[0] / SCENE.image_pixels
    moved = with_optical_values(SCENE, {"screen_x_m": shift_m})
    shown = light_of(moved, truth).numpy()
    noise = 0.01 * np.random.default_rng(0).standard_normal(shown.shape)
    return CausticImage(((shown + stray) / (1 + stray) + noise).astype(np.float32), np.full(3, 0.01)), shift_m


@pytest.mark.parametrize("is_elsewhere", [False, True])
def test_the_bench_is_found_with_lines_that_do_not_explain_the_image(model, answering, is_elsewhere):
    """Plate printed as told, the network's answer a little off; as on a GPU, and as on a CPU: there without lines first."""
    truth = model.heights(LINES).double().numpy()
    wrong = truth + 3e-6 * np.random.default_rng(1).standard_normal(truth.shape)
    image, shift_m = moved_picture(truth, 0.03)
    told = 0.01 if is_elsewhere else 0.0
    known = answering(wrong, refine=False, jumps=0, set_up="known").reconstruct(image)
    method = answering(wrong, refine=False, jumps=0, set_up="estimate", ambient=told)
    method.looks_first = is_elsewhere
    found = method.reconstruct(image)
    errors = [1e6 * float(np.sqrt(np.mean((each.heights_m - truth) ** 2))) for each in (known, found)]
    assert errors[1] < 0.5 * errors[0] and errors[1] < 3
    assert found.counters["explained_by"] == "fibres" and len(found.fibres_m) == len(LINES)
    assert ("network again" in found.timings_s) == is_elsewhere
    bench = {number["name"]: number for number in found.counters["bench"]["numbers"]}
    assert bench["screen_x_m"]["found"] == pytest.approx(shift_m, abs=0.1 * shift_m / 1.5)
    assert bench["screen_x_m"]["verdict"] == "found" and bench["gap_m"]["verdict"] != "found"
    by_slant = 5e-3 * way_of_light_m(SCENE)
    assert bench["screen_x_m"]["sigma"] < by_slant, "as light that slants as is believed would move the picture"
    assert bench["gap_m"]["verdict"] == "not told by this image", "what was told explains it"
    assert bench["ambient"]["found"] == pytest.approx((0.03 - told) / (1 + told), abs=0.02)
    assert any("screen_x_m" in warning for warning in found.warnings)
    assert found.counters["discrepancy"] < LARGEST_OF_NOISE < known.counters["discrepancy"]
    # What is left is asked on that bench, which is no doubt.
    assert not any(cause["is_bench"] for cause in found.counters["rest"]["causes"])
    assert not found.counters["doubt"]["is_doubtful"]
    elapsed = [entry["elapsed_s"] for entry in found.history]
    assert elapsed == sorted(elapsed)
    # The caustic of the result is one of the image as it was taken, but for stray light that was told.
    seen = image.irradiance * (1 + told) - told
    assert np.sqrt(np.mean((found.image - seen) ** 2)) < 0.03


@pytest.mark.parametrize(
    ("options", "is_found"),
    [
        ({"priors": {"gap_m": 4e-4}}, True),
        ({"priors": {"gap_m": 4e-4}, "set_up": "known"}, False),
        ({"priors": {"gap_m": 0.0, "base_thickness_m": 0.0, "index_offset": 0.0}}, False),
    ],
)
def test_a_gap_is_found_with_lines_that_explain_the_image_without_it(model, answering, options, is_found):
    """By 300 um wider than told, on a CPU by default; so small a plate tells it to 20 um."""
    truth = model.heights(LINES).double().numpy()
    wide = with_optical_values(SCENE, {"gap_m": 3.01e-4})
    shown = light_of(wide, model.heights(LINES)).numpy()
    noise = 0.005 * np.random.default_rng(0).standard_normal(shown.shape)
    image = CausticImage((shown + noise).astype(np.float32), np.full(3, 0.005))
    method = answering(1.1 * truth, refine=False, jumps=0, **options)
    method.looks_first = False
    result = method.reconstruct(image)
    error = 1e6 * float(np.sqrt(np.mean((result.heights_m - truth) ** 2)))
    assert (error < 5) == is_found and (result.counters["explained_by"] == "fibres" or not is_found)
    bench = {number["name"]: number for number in result.counters.get("bench", {"numbers": []})["numbers"]}
    if not is_found:
        assert all(bench[name]["found"] == bench[name]["told"] for name in TOLD_BY_LINES if name in bench)
    else:
        assert bench["gap_m"]["found"] == pytest.approx(3.01e-4, abs=6e-5)
        assert bench["gap_m"]["sigma"] < 0.8 * bench["gap_m"]["prior"] and bench["screen_x_m"]["found"] == 0
        assert any("gap" in warning for warning in result.warnings) and result.counters["bench"]["is_kept"]


def test_a_bench_that_only_looks_other_costs_no_lines(monkeypatch, model, image, answering):
    """At a glance it did; what was found without lines then is not looked for again, and lines are found as told."""
    monkeypatch.setattr("nets.reconstruct.fibres.method.BenchSearch.glance", lambda *of: Glance(True, False))
    reconstruct, asked = Direct.reconstruct, []
    monkeypatch.setattr(Direct, "reconstruct", lambda self, *a, **o: asked.append(self) or reconstruct(self, *a, **o))
    truth = model.heights(LINES).double().numpy()
    wrong = truth + 3e-6 * np.random.default_rng(1).standard_normal(truth.shape)
    result = answering(wrong, refine=False, jumps=0).reconstruct(image)
    assert len(asked) == 1 and result.counters["explained_by"] == "fibres" and "bench" not in result.counters
    assert 1e6 * float(np.sqrt(np.mean((result.heights_m - truth) ** 2))) < 1.0
    assert "without lines" in result.timings_s and "network again" not in result.timings_s
    bump = answering(np.full((N, N), 1e-4), refine=False, jumps=0, most_lines=1).reconstruct(image)
    assert len(asked) == 2 and bump.counters["explained_by"] == "network"


@pytest.mark.parametrize("set_up", ["known", "estimate", None])
def test_what_is_asked_of_a_bench(monkeypatch, model, image, answering, set_up):
    """Of one that is known only the lens, which is the camera's; on a CPU what moves a picture, before the lens."""
    asked, asks_lens = [], lines_of_image.fit_through_lens

    def lens(run):
        asked.append("fit_through_lens")
        asks_lens(run)

    monkeypatch.setattr(lines_of_image, "fit_through_lens", lens)
    on_any = {"fit_through_lens_or_with_light", "fit_with_lamp", "fit_with_light", "fit_with_gap"}
    for name in (*on_any, "fit_with_place", "fit_with_bench"):
        monkeypatch.setattr(lines_of_image, name, lambda run, name=name: asked.append(name))
    truth = model.heights(LINES).double().numpy()
    wrong = truth + 1e-5 * np.random.default_rng(1).standard_normal(truth.shape)
    answering(wrong, refine=False, jumps=0, set_up=set_up).reconstruct(image)
    others = {"estimate": "fit_with_bench", None: "fit_with_place"}
    assert set(asked) == ({"fit_through_lens"} if set_up == "known" else {*on_any, others[set_up]})
    assert set_up is not None or asked[0] == "fit_with_place"


@pytest.mark.parametrize("waves", [False, True])
def test_lines_that_vary_along_their_way(monkeypatch, model, answering, waves):
    """Of a print whose lines are 4 % thicker and thinner, and 50 um aside, where the network's relief told the lines."""
    monkeypatch.setattr("nets.reconstruct.fibres.lines_of_image.starting_lines", lambda *_, **__: LINES + 1e-5)
    counts = knot_counts(LINES)
    turns = 8 * np.pi * np.linspace(0, 1, int(counts.max()))
    knots = np.stack([0.04 * np.sin(turns), 5e-5 * np.cos(turns)], axis=1)
    printed = WavyModel(model, counts).heights(LINES, torch.from_numpy(np.repeat(knots[None], len(LINES), axis=0)))
    shown = light_of(SCENE, printed).numpy()
    noise = 0.01 * np.random.default_rng(0).standard_normal(shown.shape)
    image = CausticImage((shown + noise).astype(np.float32), np.full(3, 0.01))
    truth = printed.double().numpy()
    wrong = truth + 4e-5 * np.random.default_rng(1).standard_normal(truth.shape)
    result = answering(wrong, refine=False, jumps=0, set_up="known", waves=waves).reconstruct(image)
    error = 1e6 * float(np.sqrt(np.mean((result.heights_m - truth) ** 2)))
    assert result.counters["explained_by"] == "fibres" and ("waves" in result.counters) == waves
    assert error < 4.0 if waves else error > 8.0
    if waves:
        assert result.counters["waves"]["thickness"] == pytest.approx(0.028, abs=0.01)
        np.testing.assert_allclose(result.fibres_m, LINES, atol=3e-4)


@pytest.mark.parametrize("is_picture", [False, True])
def test_lines_are_found_in_a_picture_that_is_too_large(monkeypatch, model, answering, is_picture):
    """Where they explain nothing with a lamp nearby, and heights say that it is a picture."""
    truth, size = model.heights(LINES).double().numpy(), 1.01
    fine, lay = FineLight(CausticSimulator(SCENE))(model.heights(LINES)), Lay(size=size, is_back=False)
    shown = torch.stack([pixel_means(light, SCENE.image_pixels, lay=lay) for light in fine]).numpy()
    noise = 0.02 * np.random.default_rng(0).standard_normal(shown.shape)
    image = CausticImage((shown + noise).astype(np.float32), np.full(3, 0.02))
    monkeypatch.setattr(lines_of_image, "fit_with_bench", lambda run: None)
    by_network, vergence = Fibres._by_network, (size - 1) / way_of_light_m(SCENE)

    def told(*given):
        found = by_network(*given)
        numbers = [
            number | {"found": vergence if number["name"] == "vergence_per_m" else number["told"], "sigma": 0.1}
            for number in found.counters["bench"]["numbers"]
        ]
        bench = found.counters["bench"] | {"numbers": numbers, "is_kept": is_picture, "is_picture": is_picture}
        return dataclasses.replace(found, counters=found.counters | {"bench": bench})

    monkeypatch.setattr(Fibres, "_by_network", told)
    wrong = truth + 2e-5 * np.random.default_rng(1).standard_normal(truth.shape)
    method = answering(wrong, refine_iterations=20, jumps=0, set_up="estimate")
    method.finds_bench, method.looks_first = True, False
    result = method.reconstruct(image)
    error = 1e6 * float(np.sqrt(np.mean((result.heights_m - truth) ** 2)))
    assert (error < 4) == is_picture and ("network again" in result.timings_s) == is_picture
    if is_picture:
        assert result.counters["explained_by"] == "fibres" and len(result.fibres_m) == len(LINES)
        assert is_picture_larger(result.counters["bench"]), "and the picture is told"
        assert any("too large" in warning for warning in result.warnings)


def test_told_stray_light_is_taken_off(model, image, answering):
    """As by ``direct``: lines explain the rest to its noise."""
    truth = model.heights(LINES).double().numpy()
    wrong = truth + 2e-6 * np.random.default_rng(1).standard_normal(truth.shape)
    stray = CausticImage((image.irradiance + np.float32(0.1)) / np.float32(1.1), image.noise_std / 1.1)
    told = answering(wrong, refine=False, jumps=0, set_up="known", ambient=0.1).reconstruct(stray)
    untold = answering(wrong, refine=False, jumps=0, set_up="known").reconstruct(stray)
    errors = [1e6 * float(np.sqrt(np.mean((each.heights_m - truth) ** 2))) for each in (told, untold)]
    assert errors[0] < 1.0 and errors[0] < 0.5 * errors[1]
    assert told.counters["discrepancy"] < 1.2 < untold.counters["discrepancy"]


@pytest.mark.parametrize("lumps", [0.0, 3e-4])
def test_without_known_noise_the_better_relief_wins(model, image, answering, lumps):
    """Lines alone explain the first plate; the second has a lump that only the network's answer shows."""
    centre = (np.arange(N) + 0.5) / N - 0.5
    lump = lumps * np.exp(-((centre[:, None] - 0.3) ** 2 + (centre[None] + 0.3) ** 2) / 0.01)
    truth = model.heights(LINES).double().numpy() + lump
    seen = light_of(SCENE, truth).numpy()
    wrong = truth + (2e-7 if lumps else 2e-6) * np.random.default_rng(1).standard_normal(truth.shape)
    method = answering(wrong, most_lines=3, refine_iterations=3, max_iterations=8, jumps=0)
    result = method.reconstruct(CausticImage(seen))
    counters = result.counters
    assert counters["explained_by"] == ("network" if lumps else "fibres")
    assert (result.fibres_m is None) == bool(lumps)
    assert ("refinement" in counters) == bool(lumps), "an image without noise is explained to the simulation's error"


def test_what_is_left_of_the_image_is_told(model, image, answering):
    """One line too few may be used: more than noise is left."""
    truth = model.heights(LINES[:2]).double().numpy()
    options = {"refine_iterations": 30, "refine_pixels": 2 * N, "set_up": "known"}
    result = answering(truth, most_lines=2, jumps=0, max_iterations=10, **options).reconstruct(image)
    assert result.counters["discrepancy"] > 2
    assert any("times the noise is left of the image where light was moved" in warning for warning in result.warnings)
    assert result.counters["refinement"] == "kept" and result.trust.pixels == 2 * N, "as of every method"
    assert not result.trust.is_explained and result.trust.left_at_all == pytest.approx(result.residual, rel=1e-6)


def test_many_lines_are_left_to_the_network_if_so_wished(model, image, answering):
    """As ``auto`` does on a CPU; asked once, the network is not asked again."""
    truth = model.heights(LINES).double().numpy()
    method = answering(truth, left_alone=len(LINES), refine_iterations=5, refine_pixels=2 * N)
    result = method.reconstruct(image)
    assert result.counters["explained_by"] == "network" and result.counters["fibres"] == 0
    assert result.counters["lines_of_relief"] == len(LINES)
    assert not any(entry.get("method") == "fibres" for entry in result.history)
    assert answering(truth, left_alone=len(LINES) + 1).reconstruct(image).counters["fibres"] == len(LINES)


def test_each_call_asks_the_network_once(monkeypatch, model, image, answering):
    """Whether lines are taken or not; and again of an image that may have been changed since."""
    asked = []
    opinion = Direct._opinion

    def counted(self, *arguments):
        asked.append(self)
        return opinion(self, *arguments)

    monkeypatch.setattr(Direct, "_opinion", counted)
    options = {"refine_iterations": 2, "refine_pixels": 2 * N, "losses": False}
    method = answering(model.heights(LINES).double().numpy(), left_alone=len(LINES), **options)
    changed = dataclasses.replace(image, irradiance=image.irradiance.copy())
    for calls in (1, 2):
        assert method.reconstruct(changed).counters["explained_by"] == "network"
        assert asked == [method.network] * calls
        changed.irradiance[:, :8] = 1.0
    direct = method.network
    for _ in range(2):
        direct.reconstruct(changed)
    assert len(asked) == 4


def test_nothing_printed(answering):
    flat = np.zeros((N, N))
    seen = CausticSimulator(SCENE)(torch.zeros(N, N)).numpy()
    result = answering(flat, refine=False).reconstruct(CausticImage(seen))
    assert result.counters["fibres"] == 0 and result.fibres_m is None and not result.heights_m.any()


def test_limits(model, image, answering):
    truth = model.heights(LINES).double().numpy()
    late = answering(truth, max_time_s=1e-3).reconstruct(image)
    assert late.stop_reason == "max_time" and np.isfinite(late.heights_m).all()

    def interrupt(progress):
        if progress.stage == "fibres":
            raise KeyboardInterrupt

    stopped = answering(truth).reconstruct(image, progress=interrupt)
    assert stopped.stop_reason == "interrupted" and np.isfinite(stopped.heights_m).all()
    with pytest.raises(InputError, match="profile"):
        create("fibres", SCENE, profile="round")
