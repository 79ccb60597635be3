"""Benches on which light goes farther than was told, as lines with corners and curves tell it."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

import nets.reconstruct.network_answers as answers_module
from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench, seen_on
from nets.reconstruct.fibres.bench.bench_of_lines import numbers_of_lines
from nets.reconstruct.fibres.bench.gap_of_lines import along, by_number
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.lines_of_image import LinesOfImage
from nets.reconstruct.fibres.method import _as_told
from nets.reconstruct.fibres.search.line_search import Answer
from nets.reconstruct.fibres.shapes import curves_bench
from nets.reconstruct.fibres.shapes.curves_bench import ToldWay, as_shown, curves_on_their_bench, way_told
from nets.reconstruct.fibres.shapes.curves_fit import curved_heights
from nets.reconstruct.fibres.shapes.curves_of_image import CurvesOfImage
from nets.reconstruct.fibres.trust.told_bench import AS_TOLD, with_way
from nets.reconstruct.methods import create
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.test_curves import CORNER, CURVE, PLATE, SCENE, N
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_uncertainty import careful_widths
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.prints.chain_model import ChainModel
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.smooth_chains import Track, track_through
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.simulator import CausticSimulator

NUMBERS = numbers_of_lines(BenchNumbers.of(SCENE))
TOLD = Bench.told(NUMBERS)
NOISE = 0.004
FAR_M = 6e-4
"""Of air where none was told: light goes 29 % farther."""
TRUE = CurvedLines(
    [track_through(CURVE, node_m=PLATE / 20), Track(CORNER, (1,))],
    np.array([[0.09 * PLATE, 0.018 * PLATE], [0.08 * PLATE, 0.013 * PLATE]]),
)


@pytest.fixture
def model():
    return LineModel(SCENE)


def bench_with(**values):
    return Bench({**TOLD.values, **values}, TOLD.field)


def scene_of(bench):
    return NUMBERS.scene_of(bench.values)


def farther(bench):
    """Share by which light goes farther than was told."""
    return ThinRelief.of(scene_of(bench)).linear / ThinRelief.of(SCENE).linear - 1


class Photographed:
    """The plate on a bench, and a run that was told another."""

    def __init__(self, model, bench):
        self.model, self.chains = model, ChainModel(model)
        self.heights = curved_heights(self.chains, TRUE)
        shown = light_of(scene_of(bench), self.heights).numpy()
        noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
        self.image = CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE))
        # Free heights that send light to the same places on the told bench, as networks and refinement find them.
        true, told = ThinRelief.of(scene_of(bench)), ThinRelief.of(SCENE)
        self.free = told.unbent(true.bent(self.heights.double().numpy())).astype(np.float32)
        self.begun = CurvedLines(
            TRUE.tracks, np.column_stack([TRUE.sizes[:, 0], told.unbent(true.bent(TRUE.sizes[:, 1]))])
        )

    def said(self):
        return Answer(torch.from_numpy(self.free), torch.full((N, N), 1e-6))

    def found(self):
        return Reconstruction(
            "direct", self.free, np.zeros((3, 1, 1)), 0.0, "converged", uncertainty_m=np.full((N, N), 1e-6)
        )

    def run(self, numbers=NUMBERS):
        view = LinesView(Resimulation(CausticSimulator(SCENE), self.image), self.model)
        options = SimpleNamespace(most_lines=20)
        # No network to be shown what is left.
        network = SimpleNamespace(looked_again=lambda *_: None, on_bench=lambda scene: network)
        method = SimpleNamespace(options=options, finds_section=False, takes_bench_as_told=False, network=network)
        run = SimpleNamespace(view=view, told=view, model=self.model, bench=TOLD, numbers=numbers, method=method)
        run.note, run.way_sigma = lambda loss: None, None

        def on(bench, camera=None):
            seen = seen_on(self.image, NUMBERS, bench)
            return LinesView(Resimulation(CausticSimulator(scene_of(bench)), seen), self.model)

        run.on = on
        return run


@pytest.mark.parametrize("others", [{"gap_m": FAR_M}, {"base_thickness_m": 2e-3}])
def test_light_that_goes_farther_or_less_far_is_told(model, others):
    bench = bench_with(**others)
    plate = Photographed(model, bench)
    told = way_told(plate.run(), plate.begun, plate.said())
    assert told.share == pytest.approx(farther(bench), abs=max(0.01, 3 * told.sigma))
    assert farther(told.bench) == pytest.approx(told.share, rel=1e-3)
    assert abs(told.share) > 4 * told.sigma


def test_a_bench_that_is_as_told_stays(model):
    plate = Photographed(model, TOLD)
    shape = model.shape
    assert way_told(plate.run(), plate.begun, plate.said()) is None
    assert model.shape is shape


def test_nothing_is_asked_where_nobody_can_tell(model):
    plate = Photographed(model, bench_with(gap_m=FAR_M))
    assert way_told(plate.run(), plate.begun.kept([]), plate.said()) is None
    assert way_told(plate.run(numbers=NUMBERS.only({"screen_x_m"})), plate.begun, plate.said()) is None


@pytest.mark.parametrize(("is_known", "is_taken"), [(False, True), (False, False), (True, True)])
def test_curves_begin_anew_on_the_bench_they_tell(model, monkeypatch, is_known, is_taken):
    """Heights follow there; who says that the bench is as told is not told otherwise; curves not taken tell nothing."""
    plate = Photographed(model, bench_with(gap_m=FAR_M))
    run = plate.run()
    run.method.takes_bench_as_told = is_known
    view, begun, curves, ways = run.view, [], object(), iter([1.0, 0.1, None])

    def begin(self, found):
        begun.append((self.view.scene, found.heights_m.max()))
        return plate.begun, 1.0

    def tell(run, lines, said, significant):
        share = next(ways)
        return None if share is None else ToldWay(along(NUMBERS, run.bench, share), share, 0.02)

    def end(self, lines, found, judged_by):
        assert judged_by[1] is view and judged_by[0].heights_m.max() == plate.free.max()
        return curves if is_taken else None

    monkeypatch.setattr(CurvesOfImage, "begun", begin)
    monkeypatch.setattr(CurvesOfImage, "ended", end)
    monkeypatch.setattr(curves_bench, "way_told", tell)
    assert curves_on_their_bench(run, plate.found()) is (curves if is_taken else None)
    scenes, heights = zip(*begun, strict=True)
    ways_m = [ThinRelief.of(scene).linear / ThinRelief.of(SCENE).linear for scene in scenes]
    assert ways_m == pytest.approx([1.0] if is_known else [1.0, 2.0, 2.2], rel=1e-3)
    assert all(np.diff(heights) < 0)
    if is_known or not is_taken:
        assert run.view is view and run.bench is TOLD and run.way_sigma is None
    else:
        assert run.view.scene == scene_of(run.bench) == scenes[-1] and run.way_sigma == 0.02


def test_a_result_shows_on_another_bench_what_it_did():
    there = scene_of(bench_with(gap_m=FAR_M))
    heights = np.linspace(0, 1e-3, 50).reshape(5, 10)
    found = Reconstruction("direct", heights, np.zeros((3, 1, 1)), 0.0, "converged", uncertainty_m=0.1 * heights)
    moved = as_shown(found, SCENE, there)
    np.testing.assert_allclose(ThinRelief.of(there).bent(moved.heights_m), ThinRelief.of(SCENE).bent(heights))
    assert np.all(moved.uncertainty_m[1:] < found.uncertainty_m[1:])
    plain = Reconstruction("direct", heights, np.zeros((3, 1, 1)), 0.0, "converged")
    assert as_shown(plain, SCENE, there).uncertainty_m is None


def test_what_was_moved_is_as_uncertain_as_the_others_leave_it():
    """GUM: sigma_k^2 = (sigma^2 + sum of (a_j w_j)^2) / a_k^2; the others stay as they were known."""
    bench, sigma = bench_with(gap_m=FAR_M), 0.01
    known = with_way(NUMBERS, bench, sigma).sigma
    far = ThinRelief.of(scene_of(bench)).linear
    slopes = {p.name: by_number(NUMBERS, bench, p) / far for p in NUMBERS.parameters if p.name in BEND_LIGHT}
    widths = careful_widths(SCENE)
    others = sum((slopes[name] * widths[name]) ** 2 for name in BEND_LIGHT if name != "gap_m")
    assert set(known) == {"gap_m"}
    assert known["gap_m"] == pytest.approx(np.sqrt(sigma**2 + others) / slopes["gap_m"])


def test_heights_are_as_uncertain_as_the_way_of_light():
    """Whatever is believed of gap, base and index far from what was told: a share of the heights, to first order."""
    heights = np.linspace(0, 2e-4, 20).reshape(4, 5)
    run = SimpleNamespace(way_sigma=0.02, numbers=NUMBERS, bench=bench_with(gap_m=FAR_M), relief=lambda: heights)
    known = _as_told(run).known(dict.fromkeys(BEND_LIGHT, 1.0))
    np.testing.assert_allclose(known.deviation_m, np.hypot(0.02, AS_TOLD) * heights, rtol=0.1)


def test_the_method_states_what_curves_tell_of_the_bench(monkeypatch, saved, model):
    """From a network whose answer is what the told bench makes of the plate."""
    bench = bench_with(gap_m=FAR_M)
    plate = Photographed(model, bench)
    free = torch.from_numpy(plate.free)
    monkeypatch.setattr(
        answers_module, "Replayed", lambda module: lambda images: free.expand(len(images), N, N).clone()
    )
    monkeypatch.setattr(LinesOfImage, "fit_to", lambda self, answer: None)
    about = {"symmetries": False, "looks": 0, "waves": False, "refine_iterations": 2}
    fibres = create("fibres", SCENE, weights=saved("direct", scene=SCENE), **about)
    found = fibres.reconstruct(plate.image)
    assert found.counters["explained_by"] == "fibres" and found.counters["curves"]["lines"] == 2
    rms = [1e6 * float(np.sqrt(np.mean((each - plate.heights.numpy()) ** 2))) for each in (plate.free, found.heights_m)]
    assert rms[1] < 0.2 * rms[0]
    gap = next(number for number in found.counters["bench"]["numbers"] if number["name"] == "gap_m")
    assert gap["verdict"] == "found" and abs(gap["found"] - FAR_M) < 4 * gap["sigma"] < FAR_M
    assert any("another bench" in each for each in found.warnings)
