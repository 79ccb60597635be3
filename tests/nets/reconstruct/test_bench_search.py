"""Plate and bench together, with a network that answers what is true."""

import dataclasses

import numpy as np
import pytest
import torch

from nets.reconstruct.bench_search import BenchSearch, is_less
from nets.reconstruct.direct import Direct
from nets.reconstruct.direct_options import DirectOptions
from nets.reconstruct.methods import create
from nets.reconstruct.network_answers import NetworkAnswers
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.found_bench.bench_model import BenchModel
from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.bench_step import BenchStep, bench_step
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.seen_camera.pixel_means import Lay, pixel_means
from warp_caustics.reconstruct.seen_camera.point_spread import FineLight
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=32, image_pixels=128)
LINES = [
    Line((-0.018, -0.015), (0.015, 0.012), 6e-3, 1.6e-3),
    Line((0.018, -0.012), (-0.016, 0.017), 7e-3, 1.8e-3),
    Line((-0.02, 0.012), (0.02, 0.018), 5e-3, 1.4e-3),
    Line((-0.02, -0.019), (0.005, 0.02), 6e-3, 1.2e-3),
]


@pytest.fixture(scope="module")
def relief():
    return line_relief(LINES, 32, SCENE.plate_size_m)


def taken(relief, noise=0.005, is_picture=False, **values):
    """A capture on another bench, divided by its flat frame."""
    numbers = dataclasses.replace(BenchNumbers.of(SCENE), is_picture=is_picture)
    model = BenchModel(numbers, SCENE.image_pixels, "cpu")
    values = {**numbers.before, **values}
    size = numbers.picture_size(values)
    heights = torch.tensor(relief, dtype=torch.float32)
    image = model.image(heights, values)
    if size != 1:
        fine, stray = FineLight(CausticSimulator(numbers.scene_of(values)))(heights), values[AMBIENT]
        met = [pixel_means(light, SCENE.image_pixels, lay=Lay(size=size, is_back=False)) for light in fine]
        image = (torch.stack(met) + stray) / (1 + stray)
    image = image.numpy()
    image = image + noise * np.random.default_rng(0).standard_normal(image.shape)
    return CausticImage(image.astype(np.float32), np.full(3, noise))


@pytest.fixture
def truthful(monkeypatch, saved, relief):
    """``direct`` whose network knows the relief but for a little, whatever it sees; nothing is refined."""

    def answers(self, image):
        wrong = 2e-6 * np.random.default_rng(1).standard_normal(relief.shape)
        yield torch.tensor((relief + np.where(relief > 0, wrong, 0.0))[None], dtype=torch.float32)

    monkeypatch.setattr(NetworkAnswers, "__call__", answers)

    def make(**options):
        as_told = {"set_up": "known"} | options
        return create("direct", SCENE, weights=saved("direct", scene=SCENE), refine=False, **as_told)

    return make


def number(result, name):
    return next(each for each in result.counters["bench"]["numbers"] if each["name"] == name)


def test_another_size_is_asked_though_the_first_step_says_something_else(truthful, relief, monkeypatch):
    """Heights that have made up for a picture of another size seem to be off in stray light."""
    image, method = taken(relief), truthful(set_up="estimate")
    search = BenchSearch(method, method.numbers)
    far = {**search.before, "vergence_per_m": 2.0}
    looked_at = []

    def step(heights, values):
        looked_at.append(dict(values))
        astray = {**values, AMBIENT: 0.03} if values == search.before else dict(values)
        return BenchStep(astray, dict.fromkeys(values, 1e-3), 0.0 if values == far else 100.0)

    monkeypatch.setattr(search, "_step_of", lambda image, told: step)
    monkeypatch.setattr(search, "_far_start", lambda image, told, answer: far)
    monkeypatch.setattr(search, "answer", lambda image, told, values: relief)
    found, steps, _ = search._searched(image, method.found(image), relief, search.before, None)
    assert looked_at == [search.before, far] and found == far and len(steps) == 2


def test_a_far_start_that_was_looked_for_is_handed_over_once(truthful, relief, monkeypatch):
    """With the image it is of; an image that was changed since is asked again."""
    asked = []
    monkeypatch.setattr("nets.reconstruct.bench_search.far_start", lambda *about: asked.append(about))
    image, (first, second) = taken(relief), (truthful(set_up="estimate") for _ in range(2))
    search = BenchSearch(first, first.numbers)
    assert not search.is_far(image, first.found(image), relief) and len(asked) == 1
    second.take_over(first)
    second.reconstruct(image)
    assert len(asked) == 1 and first.far is None
    second.reconstruct(image)
    assert len(asked) == 2
    search.is_far(image, first.found(image), relief)
    search.is_far(image, first.found(image), relief)
    assert len(asked) == 4


def test_a_bench_that_is_as_told_leaves_the_result_as_it_is(truthful, relief):
    image = taken(relief)
    known, estimated = (truthful(set_up=how).reconstruct(image) for how in ("known", "estimate"))
    np.testing.assert_array_equal(known.heights_m, estimated.heights_m)
    assert known.residual == estimated.residual
    assert "bench" not in known.counters
    assert not estimated.counters["bench"]["is_kept"]
    assert {each["verdict"] for each in estimated.counters["bench"]["numbers"]} == {"as told", "not told by this image"}
    assert estimated.warnings == known.warnings


@pytest.mark.parametrize(
    ("name", "true", "within"),
    [("vergence_per_m", 2.5, 0.5), ("vergence_per_m", -2.5, 0.5), (AMBIENT, 0.1, 0.01), ("screen_x_m", 3e-4, 2e-5)],
)
def test_what_differs_is_found_warned_of_and_used(truthful, relief, name, true, within):
    image = taken(relief, **{name: true})
    told = truthful().reconstruct(image)
    result = truthful(set_up="estimate").reconstruct(image)
    found = number(result, name)
    assert found["verdict"] == "found"
    assert found["found"] == pytest.approx(true, abs=within)
    assert abs(found["found"] - true) < 3 * found["sigma"]
    assert found["told"] == BenchNumbers.of(SCENE).before[name]
    assert result.counters["bench"]["is_kept"]
    assert result.residual < told.residual
    assert any("another bench than was told" in line and name in line for line in result.warnings)
    # What is left is asked on the bench that was found, and that bench is no doubt; the told one is, having no part in u.
    left, before = result.counters["rest"], told.counters["rest"]
    assert left["beyond_noise"] < 0.5 * before["beyond_noise"] and not any(c["is_bench"] for c in left["causes"])
    assert not result.counters["doubt"]["is_doubtful"]
    assert told.counters["doubt"]["is_doubtful"] == (name != AMBIENT)
    # The caustic that is shown has what the image has, stray light and all.
    off = np.linalg.norm(result.image - image.irradiance) / np.linalg.norm(image.irradiance)
    assert off < np.linalg.norm(told.image - image.irradiance) / np.linalg.norm(image.irradiance)


@pytest.mark.parametrize(("is_picture", "true"), [(True, 4.0), (False, 4.0), (False, -2.5)])
def test_a_picture_that_is_too_large_is_told_from_a_lamp_nearby(truthful, relief, is_picture, true):
    """What is high is enlarged more by a lamp; by 0.8 % here. A picture that is too small is no lamp's."""
    image = taken(relief, is_picture=is_picture, vergence_per_m=true)
    result = truthful(set_up="estimate").reconstruct(image)
    assert result.counters["bench"]["is_kept"] and result.counters["bench"]["is_picture"] == is_picture
    assert number(result, "vergence_per_m")["found"] == pytest.approx(true, abs=0.5)
    assert 1e6 * np.sqrt(np.mean((result.heights_m - relief) ** 2)) < 2
    remark = "too large" if is_picture else "too small" if true < 0 else None
    assert any("(a picture that is" in line for line in result.warnings) == (remark is not None)
    assert remark is None or any(remark in line for line in result.warnings)
    off, sharp = (
        np.linalg.norm(each - image.irradiance) / np.linalg.norm(image.irradiance)
        for each in (result.picture, result.image)
    )
    assert off < 0.06 and off <= sharp, "what the camera shows has the image's size, on the image's pixels"


@pytest.mark.parametrize("true", [4.9, -4.9])
def test_far_away_a_step_says_nothing_and_other_sizes_are_asked(truthful, relief, monkeypatch, true):
    """As where heights have made up for all of it; on a bench that is as told nothing else is asked."""
    asked = []

    def step(model, heights, values, measurement, noise):
        asked.append(values["vergence_per_m"])
        found = bench_step(model, heights, values, measurement, noise)
        far = abs(values["vergence_per_m"] - true) > 3
        return dataclasses.replace(found, values=dict(values)) if far else found

    monkeypatch.setattr("nets.reconstruct.bench_search.bench_step", step)
    monkeypatch.setattr("nets.reconstruct.far_pictures.LEAST_LEFT", 0.0)  # few pixels, and heights that are right
    result = truthful(set_up="estimate").reconstruct(taken(relief, is_picture=true > 0, vergence_per_m=true))
    assert asked[0] == 0 and asked[1] == pytest.approx(np.sign(true) * 2.43, abs=0.01)
    assert number(result, "vergence_per_m")["found"] == pytest.approx(true, abs=0.6)
    asked.clear()
    exact = truthful(set_up="estimate").reconstruct(taken(relief))
    assert set(asked) == {0} and not exact.counters["bench"]["is_kept"]


def test_a_picture_whose_size_is_told_is_not_looked_for(truthful, relief):
    """Nor is one below 0 found then; what its image looks like is for the rest of the image to say."""
    told = {"set_up": "estimate", "priors": {"magnification": 0.0}}
    large = truthful(**told).reconstruct(taken(relief, is_picture=True, vergence_per_m=4.0))
    assert not large.counters["bench"]["is_picture"] and number(large, "vergence_per_m")["found"] > 2
    small = truthful(**told).reconstruct(taken(relief, vergence_per_m=-2.5))
    assert number(small, "vergence_per_m")["found"] == 0.0


def test_a_cpu_looks_for_lines_on_the_bench_that_was_found_without_them(monkeypatch, truthful, saved, relief):
    """Told at a glance; on a bench that is as told lines are looked for at once."""
    method = truthful()
    moved = taken(relief, screen_x_m=3e-4)
    images = [taken(relief), moved, *(taken(relief, vergence_per_m=each) for each in (-2.5, 2.5))]
    found, search = [method.found(image) for image in images], BenchSearch(method, method.numbers)
    told = [search.glance(image, each, each.heights_m) for image, each in zip(images, found, strict=True)]
    assert told == [(False, False), (True, False), (True, True), (True, True)]

    asked = []
    monkeypatch.setattr("nets.reconstruct.fibres.lines_of_image.LinesOfImage.fit", lambda self: asked.append(self))
    options = {"weights": saved("direct", scene=SCENE), "refine": False}
    result = create("fibres", SCENE, left_alone=20, **options).reconstruct(moved)
    assert result.method == "fibres" and result.counters["explained_by"] == "network"
    assert result.counters["bench"]["is_kept"] and len(asked) == 1
    found = asked[0].bench.values["screen_x_m"]
    assert asked[0].is_elsewhere and found == pytest.approx(3e-4, abs=2e-5)
    assert asked[0].view.scene.screen_position_m[0] == found and asked[0].told.scene == SCENE
    create("fibres", SCENE, left_alone=20, set_up="known", **options).reconstruct(moved)
    assert len(asked) == 2 and not asked[1].is_elsewhere


def test_on_another_bench_both_networks_are_asked():
    """One sees the picture as its own bench would have shown it, the other is told of the bench, within its family."""
    method = create("direct", Scene())
    own, told = method.asked
    near = method.on_bench(method.numbers.scene_of({"vergence_per_m": 2.0}))
    assert [each.network.file for each in near.asked] == [own.network.file, told.network.file]
    assert own.bench is None and not near.asked[0].is_told and near.asked[0].bench.is_near
    symmetries = told.symmetries
    before, after = (each.bench.told(None, symmetries)[0] for each in (told, near.asked[1]))
    changed = [told.bench.table.names[k] for k in range(11) if before[k] != after[k]]
    assert changed == ["divergence_1_m"]
    beyond = method.on_bench(method.scene.model_copy(update={"base_thickness_m": 9e-3}))
    assert [each.network.file for each in beyond.asked] == [own.network.file]
    with pytest.raises(MismatchError, match="base_thickness_m"):
        create("direct", Scene(base_thickness_m=4e-3)).on_bench(Scene(base_thickness_m=9e-3))


def test_rounds_are_told_and_an_interrupted_search_leaves_what_was_found_before(truthful, relief):
    image, told = taken(relief, vergence_per_m=2.5), []
    before = truthful().reconstruct(image)

    def interrupt(state):
        told.append(state)
        if state.stage == "looking for the bench":
            raise KeyboardInterrupt

    result = truthful(set_up="estimate").reconstruct(image, progress=interrupt)
    assert told[-1].stage == "looking for the bench" and told[-1].iteration <= told[-1].total
    assert result.stop_reason == "interrupted" and "bench" not in result.counters
    np.testing.assert_array_equal(result.heights_m, before.heights_m)


def test_an_interrupted_refinement_on_the_found_bench_ends_the_run(truthful, relief):
    image, stages = taken(relief, vergence_per_m=2.5), []

    def interrupt(state):
        stages.append(state.stage)
        if state.stage.startswith("found bench"):
            raise KeyboardInterrupt

    result = truthful(set_up="estimate").reconstruct(image, progress=interrupt)
    assert stages[-1].startswith("found bench") and result.stop_reason == "interrupted"


def test_a_bench_is_looked_for_unless_it_is_known_or_time_is_short(truthful, relief):
    image = taken(relief)
    assert "bench" in truthful(set_up=None).reconstruct(image).counters
    assert "bench" not in truthful(set_up=None, max_time_s=1e-3).reconstruct(image).counters
    assert "bench" in truthful(set_up=None, max_time_s=1e4).reconstruct(image).counters


def test_gap_and_base_are_not_told(truthful, relief):
    result = truthful(set_up="estimate", priors={"gap_m": 2e-4}).reconstruct(taken(relief))
    gap = number(result, "gap_m")
    assert (gap["verdict"], gap["sigma"], gap["seen"]) == ("not told by this image", 2e-4, None)
    assert "heights" in gap["why"]


def test_a_bench_that_explains_nothing_better_is_not_kept(truthful, relief, monkeypatch):
    def searched(self, image, told, answer, start, progress):
        values = {**self.before, "vergence_per_m": 3.0}
        return values, [], dict.fromkeys(values, 1e-4)

    monkeypatch.setattr(BenchSearch, "_searched", searched)
    image = taken(relief)
    known, doubted = truthful().reconstruct(image), truthful(set_up="estimate").reconstruct(image)
    np.testing.assert_array_equal(known.heights_m, doubted.heights_m)
    assert number(doubted, "vergence_per_m")["verdict"] == "in doubt"
    assert number(doubted, "vergence_per_m")["found"] == 0.0
    assert any("in doubt" in line for line in doubted.warnings)


def test_a_bench_that_no_network_serves_is_told_and_not_raised(truthful, relief, monkeypatch):
    def refused(self, scene):
        raise MismatchError("beyond the family")

    monkeypatch.setattr(Direct, "on_bench", refused)
    result = truthful(set_up="estimate").reconstruct(taken(relief, vergence_per_m=1.5))
    assert "beyond the family" in result.counters["bench"]["why"]
    assert not result.counters["bench"]["is_kept"]


def test_stray_light_that_is_told_is_taken_off(truthful, relief):
    image = taken(relief, ambient=0.1)
    plain, cleared = truthful().reconstruct(image), truthful(ambient=0.1).reconstruct(image)
    assert cleared.residual < 0.7 * plain.residual
    found = number(truthful(ambient=0.1, set_up="estimate").reconstruct(image), AMBIENT)
    assert (found["told"], found["verdict"]) == (0.1, "as told")


def test_pictures_lie_where_the_networks_own_bench_shows_them(truthful, relief):
    """A lamp nearby magnifies; the network of parallel light sees a picture that is not."""
    method = truthful()
    near = BenchNumbers.of(SCENE).scene_of({"vergence_per_m": 2.0})
    other = method.on_bench(near)
    assert other.scene == near and method.scene == SCENE
    assert other.network.module is method.network.module
    relief = 0.1 * relief  # smooth light
    picture = torch.tensor(taken(relief, 0.0, vergence_per_m=2.0).irradiance)
    own = torch.tensor(taken(relief, 0.0).irradiance)
    inner = (slice(None), slice(8, -8), slice(8, -8))
    plain = float((picture - own)[inner].norm() / own[inner].norm())
    bench = other.asked[0].bench
    moved = bench.picture(picture * bench.light.level(bench.values)[0])
    assert float((moved - own)[inner].norm() / own[inner].norm()) < 0.25 * plain


def test_the_users_samples_come_back(saved, monkeypatch, relief):
    few = SCENE.model_copy(update={"height_samples": 16})
    method = create("direct", few, weights=saved("direct", scene=SCENE), refine=False, set_up="estimate")

    def answers(self, image):
        yield torch.tensor(relief[None], dtype=torch.float32)

    monkeypatch.setattr(NetworkAnswers, "__call__", answers)
    result = method.reconstruct(taken(relief, vergence_per_m=1.5))
    assert result.counters["bench"]["is_kept"]
    assert result.heights_m.shape == (16, 16)


def test_less_is_less_by_a_share_of_what_noise_does_not_explain():
    assert is_less(0.0113, 0.0114, 0.0110) and not is_less(0.1139, 0.1140, 0.0110)
    assert not is_less(0.0114, 0.0114, 0.02)


def test_options_are_checked():
    with pytest.raises(ValueError, match="known"):
        DirectOptions(set_up="guess")
    with pytest.raises(ValueError, match="greater than or equal to 0"):
        DirectOptions(priors={"gap_m": -1})


def test_a_wrong_name_is_refused_at_once(saved):
    with pytest.raises(InputError, match="'gup_m' is not known"):
        create("direct", SCENE, weights=saved("direct", scene=SCENE), priors={"gup_m": 1e-3})


def test_auto_leaves_the_bench_to_methods_that_look_for_it(saved, shipped, image, scene):
    method = create("auto", scene, set_up="estimate", max_iterations=1)
    result = method.reconstruct(CausticImage(np.ones_like(image.irradiance)))
    assert result.method == "refine"
