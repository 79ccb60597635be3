"""Lines with corners and curves fitted to an image, on a small scene."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

import nets.reconstruct.network_answers as answers_module
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.lines_of_image import LinesOfImage
from nets.reconstruct.fibres.shapes.curves_fit import _Descent, curved_heights, fitted_to_image
from nets.reconstruct.fibres.shapes.curves_of_image import Curved, CurvesOfImage, are_crowd
from nets.reconstruct.fibres.shapes.curves_paths import paths_of, section_of
from nets.reconstruct.methods import create
from tests.nets.reconstruct.cameras import blurring, through_lens
from tests.nets.reconstruct.exact_light import light_of
from tests.nets.reconstruct.fibres.three_lines import LINES
from warp_caustics.prints.chain_model import ChainModel
from warp_caustics.prints.curves import bezier_points, ring_points
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.paths import paths_relief, uniform_path
from warp_caustics.prints.smooth_chains import Track, track_through
from warp_caustics.prints.vectorise.curved import straight_lines
from warp_caustics.prints.vectorise.curved_lines import CurvedLines
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

N = 64
SCENE = Scene(height_samples=N, image_pixels=2 * N)
NOISE = 0.01
PLATE = SCENE.plate_size_m[0]
CURVE = PLATE * bezier_points(np.array([[-0.4, -0.3], [-0.1, 0.5], [0.1, -0.6], [0.4, 0.35]]))
CORNER = PLATE * np.array([[-0.35, 0.3], [0.05, 0.38], [0.3, 0.0]])


@pytest.fixture
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def truth():
    """A curve and a line with a corner."""
    corner = Track(CORNER, (1,))
    sizes = np.array([[0.05 * PLATE, 0.01 * PLATE], [0.04 * PLATE, 0.007 * PLATE]])
    return CurvedLines([track_through(CURVE, node_m=PLATE / 20), corner], sizes)


@pytest.fixture(scope="module")
def heights(truth):
    return curved_heights(ChainModel(LineModel(SCENE)), truth)


@pytest.fixture(scope="module")
def image(heights):
    shown = light_of(SCENE, heights).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    return CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE))


def moved(lines, by_m=4e-5, larger=1.03):
    rng = np.random.default_rng(1)
    tracks = [track.at(track.nodes_m + by_m * rng.standard_normal(track.nodes_m.shape)) for track in lines.tracks]
    return CurvedLines(tracks, larger * lines.sizes)


def error_um(found, heights):
    return 1e6 * float((found - heights).square().mean().sqrt())


def test_lines_come_back_to_the_image(model, truth, heights, image):
    start = moved(truth)
    fit = ImageFit(SCENE, image, model, SCENE.image_pixels)
    found, loss = fitted_to_image(fit, start, 40, NOISE)
    chains = ChainModel(model)
    before, after = (error_um(curved_heights(chains, lines), heights) for lines in (start, found))
    assert after < 0.25 * before and loss < fit.loss(curved_heights(chains, start))
    assert loss == pytest.approx(fit.loss(curved_heights(chains, found)), rel=5e-3)


@pytest.mark.parametrize("shape", [Shape(), Shape(1.3, 0.4)])
def test_gradient_of_all_numbers(model, truth, image, shape):
    """Against differences of the misfit along a direction in which all of them change, the section's, too."""
    model.shape = shape
    descent = _Descent(ImageFit(SCENE, image, model, SCENE.image_pixels), moved(truth), NOISE, with_section=True)
    rng = np.random.default_rng(3)
    at, way = 0.3 * rng.standard_normal(descent.size), rng.standard_normal(descent.size)
    at[-2:] = np.abs(at[-2:])
    _, gradient = descent(at)
    values = [descent(at + step * way)[0] for step in (0.02, -0.02)]
    assert float(gradient @ way) == pytest.approx((values[0] - values[1]) / 0.04, rel=0.03)
    only = np.zeros(descent.size)
    only[-2:] = 1.0
    values = [descent(at + step * only)[0] for step in (0.2, -0.2)]
    assert float(gradient @ only) == pytest.approx((values[0] - values[1]) / 0.4, rel=0.1)


def test_the_section_is_found_with_them(model, truth, image):
    """A cosine from a crown that is flatter, as wide at half its height."""
    model.shape = Shape(0.8)
    fit = ImageFit(SCENE, image, model, SCENE.image_pixels)
    fitted_to_image(fit, truth, 60, NOISE, with_section=True)
    assert model.shape.exponent + model.shape.parabola == pytest.approx(1.0, abs=0.12)


def search(model, image, network=None):
    plain = Resimulation(CausticSimulator(SCENE), image, np.ones(3))
    view = LinesView(plain.through(ChannelCamera.perfect(3, SCENE.image_pixels)), model)
    method = SimpleNamespace(options=SimpleNamespace(most_lines=20), finds_section=False)
    return CurvesOfImage(method, view, model, lambda loss: None, network), view


def said(heights_m, uncertainty_m=None):
    return Reconstruction("direct", heights_m, np.zeros((3, 1, 1)), 0.0, "converged", uncertainty_m=uncertainty_m)


def test_lines_are_found_in_the_ridges_of_a_result(model, truth, heights, image):
    """Of a relief that is 3 % too high and noisy; what is taken leaves nothing but noise."""
    rough = 1.03 * heights.numpy() + 1e-6 * np.random.default_rng(5).standard_normal((N, N)).astype(np.float32)
    curves, view = search(model, image)
    found = curves(said(rough, np.full((N, N), 2e-6)))
    assert found is not None and found.record["lines"] == 2
    before, after = error_um(torch.from_numpy(rough), heights), error_um(found.heights, heights)
    assert after < 0.3 * before and view.is_relief_explained(view.glass(found.heights))


def test_a_short_line_that_makes_up_for_another_is_left_out(model, truth, image, monkeypatch):
    """And a short one that is printed stays; nothing is asked of lines that leave nothing but noise."""
    junk = CurvedLines(
        [Track(CURVE[len(CURVE) // 2] + 1e-3 * np.array([[0.0, -0.6], [0.4, 0.6]]))], truth.sizes[:1] / 3
    )
    found, _ = search(model, image)
    monkeypatch.setattr(found, "_is_settled", lambda lines: False)
    lines, loss = found._without_short(*found._fitted(moved(truth).with_more(junk)))
    assert len(lines) == 2 and loss == pytest.approx(found._fitted(lines)[1], rel=1e-3)
    middle = CORNER.mean(axis=0) + np.array([0.0, -0.2 * PLATE])
    printed = truth.with_more(
        CurvedLines([Track(middle + 1e-3 * np.array([[-1.0, 0.0], [1.0, 0.3]]))], truth.sizes[1:])
    )
    with_it = CausticImage(light_of(SCENE, curved_heights(ChainModel(model), printed)).numpy(), np.full(3, NOISE))
    other, _ = search(model, with_it)
    begun = other._fitted(moved(printed, by_m=8e-5))
    monkeypatch.setattr(other, "_is_settled", lambda lines: False)
    assert len(other._without_short(*begun)[0]) == 3
    monkeypatch.setattr(other, "_is_settled", lambda lines: True)
    assert other._without_short(*begun) is not None and other._without_short(*begun)[0] is begun[0]


@pytest.mark.parametrize("is_ring", [True, False])
def test_a_ring_that_is_told_in_part_is_one_where_the_image_says_so(model, is_ring):
    """Three quarters of a ring: the image shows whether the rest was printed."""
    points = ring_points((0.05 * PLATE, -0.02 * PLATE), 0.28 * PLATE)[:-1]
    part = points[: 3 * len(points) // 4]
    size = np.array([[0.045 * PLATE, 0.008 * PLATE]])
    told = CurvedLines([track_through(part, node_m=PLATE / 20)], size)
    true = CurvedLines([track_through(points, is_closed=True, node_m=PLATE / 20)], size) if is_ring else told
    relief = curved_heights(ChainModel(model), true)
    image = CausticImage(light_of(SCENE, relief).numpy(), np.full(3, NOISE))
    curves, _ = search(model, image)
    lines, loss = curves._fitted(told)
    found, left = curves._round(lines, loss)
    assert [track.is_closed for track in found.tracks] == [is_ring]
    assert left < 0.1 * loss if is_ring else (found is lines and left == loss)


def test_the_method_finds_them(monkeypatch, saved, heights, image):
    """From a network whose answer is nearly right, where straight lines tell it worse."""

    def answers(images):
        rough = 1.03 * heights + 2e-6 * torch.randn(N, N, generator=torch.Generator().manual_seed(4))
        return rough.expand(len(images), N, N).clone()

    monkeypatch.setattr(answers_module, "Replayed", lambda module: answers)
    asked = []

    def are_rather(self):
        asked.append(self)
        self.are_rather = True
        return True

    monkeypatch.setattr(Curved, "__call__", are_rather)
    weights = saved("direct", scene=SCENE)
    about = {"weights": weights, "symmetries": False, "set_up": "known", "bench_uncertainty": False}
    found = create("fibres", SCENE, **about).reconstruct(image)
    assert found.paths is not None and found.fibres_m is None and found.counters["explained_by"] == "fibres"
    assert len(found.paths) == found.counters["fibres"] == found.counters["curves"]["lines"]
    assert error_um(torch.from_numpy(found.heights_m), heights) < 2.0
    assert {"curves", "without lines"} <= set(found.timings_s)
    assert asked, "some end where others begin"

    def interrupt(progress):
        if progress.stage == "fibres":
            raise KeyboardInterrupt

    stopped = create("fibres", SCENE, **about).reconstruct(image, progress=interrupt)
    assert stopped.stop_reason == "interrupted" and stopped.paths is None
    plain = create("fibres", SCENE, curves=False, jumps=0, **about).reconstruct(image)
    assert plain.paths is None and "curves" not in plain.counters


def test_curves_tell_the_lens(model, heights):
    """Half a pixel of blur before the pixels, which spectra took for a Gaussian in their band."""
    image = through_lens(SCENE, heights, 0.5, 0.5 * NOISE)
    curves, view = search(model, image)
    curves.view = LinesView(view.resimulation.blurred_by(blurring(0.5, 2 * N)), model)
    found = curves(said(1.03 * heights.numpy(), np.full((N, N), 2e-6)))
    assert found is not None
    np.testing.assert_allclose(curves.view.camera.spread.lens_px, 0.5, atol=0.05)
    assert curves.view.is_relief_explained(curves.view.glass(found.heights))
    # Once nothing but noise is left the search ends: 1.7 um off at most on one processor, 2.5 on another.
    assert error_um(found.heights, heights) < 1.3 * error_um(1.03 * heights, heights)


def test_what_no_line_tells_is_left(model):
    """A hill is no line: what is found along its ridge leaves more than noise, and more than its own relief."""
    y, x = (np.mgrid[0:N, 0:N] + 0.5) / N - 0.5
    hill = torch.from_numpy((5e-4 * np.exp(-(x**2 + 2 * y**2) / 0.03)).astype(np.float32))
    shown = light_of(SCENE, hill).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    curves, _ = search(model, CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE)))
    assert curves(said(hill.numpy())) is None
    assert curves(said(np.zeros((N, N), np.float32))) is None, "no ridges"


def test_straight_lines_are_not_rather_curved(model, heights):
    """Curves are told by straight lines so badly that it is worth while to ask."""
    sure = torch.full((N, N), 1e-6)
    straight = Curved(model, LINES, model.heights(LINES), sure)
    assert not straight.may_be and not straight() and not straight.are_rather
    told, curved = model.shape, Curved(model, LINES[:0], heights, sure)
    model.shape = told._replace(exponent=1.5)
    assert curved.may_be and curved() and curved.are_rather
    assert model.shape.exponent == 1.5, "they are asked in the middle of a search"
    model.shape = told


def test_a_crowd_ends_where_nothing_begins():
    """Two dozen straight lines at random, and as many along a ring."""
    rng = np.random.default_rng(0)
    size = torch.tensor([[1e-3, 3e-4]]).double().expand(24, 2)
    crowd = torch.cat([torch.from_numpy(rng.uniform(-0.02, 0.02, (24, 4))), size], dim=1)
    turns = np.linspace(0, 2 * np.pi, 25)
    ring = torch.from_numpy(0.015 * np.stack([np.cos(turns), np.sin(turns)], axis=1))
    along = torch.cat([ring[:-1], ring[1:], size], dim=1)
    assert are_crowd(crowd) and not are_crowd(along) and not are_crowd(crowd[:10])


def test_paths_print_the_relief(truth, heights):
    printed = paths_relief(paths_of(truth, Shape()), N, SCENE.plate_size_m)
    np.testing.assert_allclose(printed, heights.double().numpy(), atol=5e-9)
    assert section_of(Shape(0.5, 1.0)).kind == "parabola" and section_of(Shape(64.0)).kind == "cosine"


def test_a_way_is_written_and_read_as_a_design(tmp_path, truth, heights):
    from warp_caustics.prints.design_file import design_relief, read_design
    from warp_caustics.prints.design_writer import write_paths

    write_paths(tmp_path / "lines.yaml", paths_of(truth, Shape()))
    found = design_relief(read_design(tmp_path / "lines.yaml"), N, SCENE.plate_size_m)
    np.testing.assert_allclose(found, heights.double().numpy(), atol=3e-7)


def test_a_path_with_one_size_prints_as_a_uniform_one():
    (path,) = paths_of(CurvedLines([Track(CORNER, (1,))], np.array([[1e-3, 2e-4]])), Shape())
    expected = paths_relief([uniform_path(CORNER, 1e-3, 2e-4)], N, SCENE.plate_size_m)
    np.testing.assert_allclose(paths_relief([path], N, SCENE.plate_size_m), expected, atol=1e-9)


def test_curves_may_begin_with_straight_lines(model):
    """Two that cross at a small angle, where a ridge leads from one to the other."""
    rows = PLATE * torch.tensor(
        [[-0.36, -0.1, 0.36, 0.1, 0.045, 0.008], [-0.36, 0.08, 0.36, -0.12, 0.045, 0.006]], dtype=torch.float64
    )
    heights = model.heights(rows)
    begun = straight_lines(model, heights, torch.full_like(heights, 1e-6))
    assert len(begun) == 2 and not any(track.is_closed or track.corners for track in begun.tracks)
    assert error_um(curved_heights(ChainModel(model), begun), heights) < 1.0
    assert not len(straight_lines(model, torch.zeros_like(heights), torch.full_like(heights, 1e-6)))


@pytest.mark.parametrize("is_with_ridges", [True, False])
def test_the_image_says_where_curves_begin(model, truth, heights, image, monkeypatch, is_with_ridges):
    """One of both ways misses a line."""
    tried = []

    def told(model, relief, spread, *, most, start=None):
        tried.append(start is None)
        return truth if (start is None) == is_with_ridges else truth.kept([0])

    monkeypatch.setattr("nets.reconstruct.fibres.shapes.curves_of_image.curved_lines_of_relief", told)
    found, loss = search(model, image)[0]._begun(heights, torch.full_like(heights, 1e-6))
    assert len(found) == len(truth) == 2 and loss > 0
    assert tried == ([True] if len(tried) == 1 else [True, False])
    assert is_with_ridges or len(tried) == 2


def test_straight_pieces_that_meet_are_asked_for_a_ring(monkeypatch, saved, model):
    """A ring that two dozen straight lines tell nearly to the noise; those that leave nothing but noise are left."""
    turns = np.linspace(0, 2 * np.pi, 19)
    at = 0.3 * PLATE * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    size = np.tile([0.05 * PLATE, 0.01 * PLATE], (18, 1))
    pieces = torch.from_numpy(np.concatenate([at[:-1], at[1:], size], axis=1))
    points = ring_points((0.0, 0.0), 0.3 * PLATE)[:-1]
    ring = CurvedLines([track_through(points, is_closed=True, node_m=PLATE / 20)], size[:1])
    heights = curved_heights(ChainModel(model), ring)
    image = CausticImage(light_of(SCENE, heights).numpy(), np.full(3, NOISE))
    monkeypatch.setattr(
        answers_module, "Replayed", lambda module: lambda images: heights.expand(len(images), N, N).clone()
    )
    monkeypatch.setattr("nets.reconstruct.fibres.lines_of_image.Curved", lambda *_: None)
    asked = []

    def taken(self, settled):
        def fit_to(answer):
            self.lines, self.counters["lines_of_relief"] = pieces, len(pieces)

        def fit_curves(found):
            asked.append(found.fibres_m)
            return False

        self.fit_to, self.fit_curves = fit_to, fit_curves
        self.view.is_settled = lambda lines: settled

    weights = saved("direct", scene=SCENE)
    about = {"weights": weights, "symmetries": False, "set_up": "known", "bench_uncertainty": False, "looks": 0}
    begin = LinesOfImage.__init__
    for settled, expected in ((True, 0), (False, 1)):

        def init(self, *args, settled=settled, **settings):
            begin(self, *args, **settings)
            taken(self, settled)

        monkeypatch.setattr(LinesOfImage, "__init__", init)
        monkeypatch.setattr(LinesOfImage, "_fit_with_all", lambda self: None)
        asked.clear()
        fibres = create("fibres", SCENE, waves=False, refine_iterations=2, **about)
        for name in ("takes_lines", "is_noise_left"):
            always = property(lambda self: True, lambda self, value: None)
            monkeypatch.setattr(LinesOfImage, name, always, raising=False)
        found = fibres.reconstruct(image)
        assert len(asked) == expected and found.fibres_m is not None


def test_curves_must_leave_less_than_straight_lines(model, heights, image):
    """Free heights may leave less than noise, a few straight lines may not."""
    curves, view = search(model, image)
    true = view.glass(heights)
    nearly = view.glass(1.002 * heights)
    assert curves._is_better(nearly, true, view) and not curves._is_better(nearly, true, view, are_lines=True)
    assert curves._is_better(true, view.glass(1.03 * heights), view, are_lines=True)


@pytest.mark.parametrize("left, is_left", [(0.9, True), (3.0, False)])
def test_many_lines_that_tell_nothing_are_pieces_of_rings(monkeypatch, saved, image, left, is_left):
    """A crowd of straight lines leaves hardly more of the image than the relief they were found in."""
    runs = []

    def fit_to(self, answer):
        self.lines, self.is_left_alone, self.is_crowd, self.is_in_vain = LINES, True, True, True
        self.left = lambda: (self.view.relief(LINES), left, 1.0)
        runs.append(self)

    monkeypatch.setattr(LinesOfImage, "fit_to", fit_to)
    about = {"weights": saved("direct", scene=SCENE), "symmetries": False, "set_up": "known", "waves": False}
    fibres = create("fibres", SCENE, bench_uncertainty=False, **about)
    answer = fibres.network.found(image)
    run = LinesOfImage(fibres, image, answer, 0.0, None)
    run.fit()
    assert runs == [run] and run.is_left_alone == is_left and not run.takes_lines
