"""Reconstruction with a design, and the choice between reliefs part by part."""

import dataclasses

import numpy as np
import pytest
import torch

from nets.inspection.from_nominal import FromNominal, FromNominalOptions
from nets.inspection.line_candidates import limits_around
from nets.inspection.selection import MisfitMap, better_parts, parts
from nets.reconstruct.fibres.bench.bench_and_light import Bench, lit
from nets.reconstruct.fibres.bench.bench_of_lines import numbers_of_lines
from nets.reconstruct.fibres.image.discrepancy import LARGEST_OF_NOISE, Discrepancy, is_explained
from nets.reconstruct.fibres.trust.uncertainty import EXPLAINED_LINES, LINES, RELIEF, SPREADS, design_uncertainty
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION
from warp_caustics.extrapolated import ExtrapolatedCaustic
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.inspection.nominal import Nominal
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.prints.model import Limits, LineModel, rows_of
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import blur_matrices, blurred, resampled, spline_reach
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=32, image_pixels=64)
TWO = [Line((-0.018, -0.015), (-0.018, 0.015), 5e-3, 3e-4), Line((0.015, -0.012), (0.015, 0.015), 5e-3, 2e-4)]

PLATE = Nominal.of_lines(TWO, SCENE)


def relief(*lines):
    return line_relief(lines, 32, SCENE.plate_size_m)


@pytest.fixture(scope="module")
def simulator():
    return CausticSimulator(SCENE, "lattice")


def image_of(heights, simulator):
    """Without the error of the simulator's lattice."""
    shown = ExtrapolatedCaustic(simulator, 16)(torch.tensor(heights, dtype=torch.float32))
    return CausticImage(shown.numpy(), np.full(3, 0.01))


def test_lines_are_fitted_to_channels_that_lie_together(method, simulator):
    """Red and blue half a pixel apart from green: as good as an image whose channels never were apart."""
    free = FreeOfCamera(relief(*TWO), np.full((32, 32), 1e-6))
    free.camera = ChannelCamera.perfect(3, 64)
    free.camera.shift[0], free.camera.shift[2] = (0.5, 0.2), (-0.3, -0.4)
    image = image_of(relief(*TWO), simulator)
    shift = torch.tensor(free.camera.shift)
    moved = resampled(
        torch.tensor(image.irradiance).double(), shift, torch.zeros(3), torch.zeros(3).double(), spline_reach(0)
    )
    method.free, method.options = free, method.options.model_copy(update={"fit_lines": None})
    found = method.reconstruct(CausticImage(moved.numpy(), image.noise_std), PLATE).reconstruction
    assert found.counters["camera"]["shift_px"] == free.camera.shift.tolist()
    assert found.counters["explained_by_lines"] and np.abs(found.heights_m - relief(*TWO)).max() < 1e-5
    method.free = Free(relief(*TWO), free.spread)
    control = method.reconstruct(CausticImage(moved.numpy(), image.noise_std), PLATE).reconstruction
    assert control.residual > 1.5 * found.residual


def test_misfit_is_where_the_relief_is_wrong(simulator):
    misfit = MisfitMap(
        simulator, CausticImage(simulator(torch.tensor(relief(*TWO), dtype=torch.float32)).numpy(), np.full(3, 0.01))
    )
    assert misfit(relief(*TWO)).max() < 1e-6
    wrong = misfit(relief(TWO[0]))
    assert wrong[:, :12].sum() < 0.02 * wrong[:, 16:].sum()


def test_parts_are_connected_and_not_tiny():
    difference = np.zeros((32, 32))
    difference[2:5, 2:5] = 1e-4
    difference[5, 5] = -1e-4  # across the corner
    difference[20, 20] = 1e-4  # alone
    labels = parts(difference, 5e-5)
    assert labels.max() == 1 and (labels > 0).sum() == 10


def test_each_part_comes_from_the_relief_that_fits_there(simulator):
    """Either candidate lacks one of two lines."""
    misfit = MisfitMap(simulator, image_of(relief(*TWO), simulator))
    first, second = relief(TWO[0]), relief(TWO[1])
    found = better_parts(misfit, first, [second], SCENE.sample_pitch_m[0], rounds=2)
    assert np.abs(found - relief(*TWO)).max() < 5e-5 < np.abs(first - relief(*TWO)).max()
    assert misfit(found).sum() < 0.3 * misfit(first).sum()


def test_a_worse_candidate_changes_nothing(simulator):
    misfit = MisfitMap(simulator, image_of(relief(*TWO), simulator))
    found = better_parts(misfit, relief(*TWO), [relief(TWO[0]), np.zeros((32, 32))], SCENE.sample_pitch_m[0])
    np.testing.assert_array_equal(found, relief(*TWO))


class Free:
    """Stands in for a method that knows no design: answers what it is given."""

    name = "direct"

    def __init__(self, answer, spread):
        self.answer, self.spread = answer, spread

    def reconstruct(self, image, *, initial=None, progress=None):
        sigma = DIRECT_CALIBRATION.scale / SPREADS * self.spread
        return Reconstruction("direct", self.answer, image.irradiance, 0.1, "converged", uncertainty_m=sigma)


class FreeOfCamera(Free):
    """One that also finds what the camera did."""

    camera = ChannelCamera.perfect(3, 64)

    def reconstruct(self, image, *, initial=None, progress=None):
        found = super().reconstruct(image)
        return dataclasses.replace(found, counters={"camera": self.camera.record})


@pytest.fixture(scope="module")
def method():
    plain = {"causes": False, "bench_uncertainty": False}
    return FromNominal(SCENE, FromNominalOptions(coarse_iterations=0, iterations=3, step_m=1e-6, **plain))


@pytest.mark.parametrize(
    ("lines", "fit_lines", "kind", "largest_m", "exposure"),
    [
        (TWO, None, EXPLAINED_LINES, 5e-6, 1.0),
        (TWO, None, EXPLAINED_LINES, 5e-6, 0.94),
        (TWO, False, LINES, 3e-5, 1.0),
        ([], None, RELIEF, 3e-5, 1.0),
        ([], None, RELIEF, 3e-5, 1.06),
    ],
)
def test_a_missing_fibre_is_found_and_the_design_corrects_the_rest(
    method, simulator, lines, fit_lines, kind, largest_m, exposure
):
    """The free answer sees that the second line is missing, and errs on the first, which the design knows."""
    answer = relief(TWO[0]).copy()
    answer[8:14, 2:7] += 1e-4
    spread = np.full((32, 32), 1e-6)
    spread[8:14, 2:7] = 5e-5
    method.free, method.options = Free(answer, spread), method.options.model_copy(update={"fit_lines": fit_lines})
    image = image_of(relief(TWO[0]), simulator)
    image = CausticImage(image.irradiance * np.float32(exposure), image.noise_std)
    found = method.reconstruct(image, PLATE if lines else Nominal(PLATE.relief_m))
    np.testing.assert_allclose(found.reconstruction.counters["exposure"], exposure, rtol=1e-3)
    heights = found.reconstruction.heights_m
    assert np.abs(heights - relief(TWO[0])).max() < largest_m
    assert len(found.lines) == len(lines)
    if lines:
        assert found.lines[1].line.height_m < 1e-5 and found.lines[0].height_error_m == pytest.approx(0, abs=1e-5)
    np.testing.assert_allclose(found.reconstruction.uncertainty_m, design_uncertainty(spread, kind), rtol=1e-6)


def test_what_is_no_line_is_not_explained_by_lines_and_is_found_all_the_same(method, simulator):
    """A drop beside the lines: the lines leave a part of the image, so parts of the network's answer are taken.

    Most of the image is as the lines say: its RMS is within the noise.
    """
    y, x = np.mgrid[:32, :32]
    truth = relief(*TWO) + 3e-4 * np.exp(-((y - 16) ** 2 + (x - 16) ** 2) / (2 * 2.0**2))
    method.free = Free(truth + 2e-6, np.full((32, 32), 1e-6))
    method.options = method.options.model_copy(update={"fit_lines": None})
    found = method.reconstruct(image_of(truth, simulator), PLATE).reconstruction
    assert found.counters["discrepancy"] < LARGEST_OF_NOISE
    assert np.abs(found.heights_m - truth)[12:21, 12:21].max() < 2e-5
    np.testing.assert_allclose(found.uncertainty_m, design_uncertainty(np.full((32, 32), 1e-6), LINES), rtol=1e-6)


def test_left_of_an_image_in_units_of_its_noise(simulator):
    truth = relief(*TWO)
    clean = simulator(torch.tensor(truth, dtype=torch.float32)).numpy()
    rng = np.random.default_rng(1)
    image = CausticImage(clean + rng.normal(0, 0.01, clean.shape).astype(np.float32), np.full(3, 0.01))
    left = Discrepancy(SCENE, image, "cpu")
    assert left(truth) == pytest.approx(1, abs=0.02) and is_explained(left(truth))
    assert left(relief(TWO[0])) > LARGEST_OF_NOISE and not is_explained(left(relief(TWO[0])))
    unknown = Discrepancy(SCENE, CausticImage(image.irradiance), "cpu")
    assert unknown(truth) is None and not is_explained(unknown(truth))


def test_lines_of_a_design_are_never_out_of_the_limits():
    large = Line((-0.03, 0.0), (0.03, 0.001), 6e-3, 4e-3)
    thin = Line((0.0, 0.0), (0.01, 0.0), 5e-5, 1e-4)
    model = LineModel(SCENE, limits=limits_around([large, thin], SCENE.plate_size_m))
    rows = rows_of([large, thin])
    assert torch.equal(model.clamped(rows), rows)
    assert limits_around([], SCENE.plate_size_m) == Limits()


def test_ctrl_c_returns_what_is_there(method, simulator):
    def stop(state):
        raise KeyboardInterrupt

    method.free = Free(relief(*TWO), np.full((32, 32), 1e-6))
    found = method.reconstruct(image_of(relief(*TWO), simulator), Nominal(relief(*TWO)), progress=stop)
    assert found.reconstruction.stop_reason == "interrupted"


def test_uncertainty_grows_with_the_spread_and_has_a_floor():
    sigma = design_uncertainty(np.array([[0.0, 1e-6], [1e-5, 1e-4]]), LINES)
    assert sigma[0, 0] == LINES.floor_m and sigma[0, 1] == pytest.approx(LINES.scale_m)
    assert sigma[0, 1] < sigma[1, 0] < sigma[1, 1]


def test_lines_of_another_section_are_looked_for_with_it(method, simulator):
    """Fibres that are steep at their edges; raised cosines come near them only with other widths and heights."""
    plate = Nominal.of_lines(TWO, SCENE, "quarter")
    image = image_of(plate.relief_m, simulator)
    method.free = Free(plate.relief_m + 2e-6, np.full((32, 32), 1e-6))
    method.options = method.options.model_copy(update={"fit_lines": None})
    found = method.reconstruct(image, plate)
    assert found.reconstruction.counters["explained_by_lines"]
    assert np.abs(found.reconstruction.heights_m - plate.relief_m).max() < 5e-6
    assert all(abs(fit.height_error_m) < 5e-6 for fit in found.lines)
    taken = method.reconstruct(image, Nominal(plate.relief_m, plate.lines))
    assert taken.reconstruction.counters["discrepancy"] > 5 * found.reconstruction.counters["discrepancy"]
    assert max(abs(fit.height_error_m) for fit in taken.lines) > 2e-5


def test_lines_are_fitted_with_the_blur_of_the_camera(method, simulator):
    """A lens out of focus by 2.5 px: heights are bent to it, where the blur is not in the model."""
    free = FreeOfCamera(relief(*TWO) + 2e-6, np.full((32, 32), 1e-6))
    free.camera = ChannelCamera.perfect(3, 64)
    free.camera.blur[:] = 2.5
    sharp = torch.tensor(image_of(relief(*TWO), simulator).irradiance)
    image = CausticImage(blurred(sharp, blur_matrices(64, free.camera.blur, "cpu")).numpy(), np.full(3, 0.01))
    method.options = method.options.model_copy(update={"fit_lines": None})
    method.free = free
    found = method.reconstruct(image, PLATE).reconstruction
    assert found.counters["explained_by_lines"] and np.abs(found.heights_m - relief(*TWO)).max() < 5e-6
    method.free = Free(relief(*TWO) + 2e-6, free.spread)
    sharp_only = method.reconstruct(image, PLATE).reconstruction
    assert np.abs(sharp_only.heights_m - relief(*TWO)).max() > 1e-5
    assert sharp_only.counters["discrepancy"] > 1.3 * found.counters["discrepancy"]


def test_a_fibre_that_nobody_designed_is_a_line_too(method, simulator):
    """The design has one of two lines; both are found, and what is left of the image is noise."""
    method.free = Free(relief(*TWO) + 2e-6, np.full((32, 32), 1e-6))
    method.options = method.options.model_copy(update={"fit_lines": None})
    found = method.reconstruct(image_of(relief(*TWO), simulator), Nominal.of_lines(TWO[:1], SCENE))
    assert found.reconstruction.counters["explained_by_lines"] and len(found.lines) == 1
    assert np.abs(found.reconstruction.heights_m - relief(*TWO)).max() < 1e-5


def test_uncertainty_knows_the_bench_and_what_is_left_of_the_image(simulator):
    """With a gap known to 1 mm only heights are 30 % uncertain; where heights are 40 % off, more than the spread says."""
    image = CausticImage(image_of(relief(*TWO), simulator).irradiance, np.full(3, 0.002))
    free = Free(relief(*TWO) + 2e-6, np.full((32, 32), 1e-6))
    vague = FromNominal(SCENE, FromNominalOptions(priors={"gap_m": 1e-3}))
    vague.free = free
    found = vague.reconstruct(image, PLATE).reconstruction
    assert found.counters["explained_by_lines"] and found.uncertainty_m.max() > 5e-5
    assert found.counters["uncertainty"]["numbers"]["gap_m"]["sigma"] == 1e-3
    off = relief(*TWO) * 1.4
    known = FromNominal(SCENE, FromNominalOptions(coarse_iterations=0, iterations=0, bench_uncertainty=False))
    known.free = Free(off, free.spread)
    left = known.reconstruct(image, Nominal(off)).reconstruction
    spread_alone = design_uncertainty(free.spread, RELIEF)
    assert left.counters["rest"]["of_contrast"] > 0.02
    assert left.uncertainty_m[8:24, 3:7].mean() > 1.2 * spread_alone.mean()
    np.testing.assert_allclose(left.uncertainty_m[:, 30:], spread_alone[:, 30:], rtol=2e-2)


@pytest.mark.parametrize("set_up", ["known", "estimate"])
def test_the_bench_is_found_with_the_lines_of_the_design(set_up):
    """A gap 0.1 mm wider, stray light, a moved picture and uneven light: what lines tell, and not all heights are."""
    scene = Scene(height_samples=24, image_pixels=96, screen_position_m=(0.0, 0.0, -1e-3))
    lines = [
        Line((-0.015, -0.012), (0.014, 0.009), 4e-3, 9e-4),
        Line((-0.009, 0.015), (0.010, -0.016), 3.2e-3, 1.2e-3),
        Line((-0.018, 0.005), (0.012, 0.016), 3.6e-3, 1e-3),
    ]
    truth = line_relief(lines, 24, scene.plate_size_m)
    numbers = numbers_of_lines(BenchNumbers.of(scene))
    told = Bench.told(numbers)
    field = np.where(np.arange(len(told.field)) == 3, 0.03, 0.0)
    bench = Bench({**told.values, "gap_m": 1.1e-3, "ambient": 0.03, "screen_x_m": 4e-5}, field)
    shown = CausticSimulator(numbers.scene_of(bench.values), "lattice")(torch.tensor(truth, dtype=torch.float32))
    seen = lit(shown.numpy().astype(np.float64), numbers, bench, np.ones(3))
    seen += 0.005 * np.random.default_rng(0).standard_normal(seen.shape)
    method = FromNominal(scene, FromNominalOptions(set_up=set_up, causes=False))
    method.free = Free(truth + 1e-5 * (truth > 1e-4), np.full((24, 24), 1e-6))
    found = method.reconstruct(CausticImage(seen, np.full(3, 0.005)), Nominal.of_lines(lines, scene))
    result = found.reconstruction
    error = np.sqrt(np.mean((result.heights_m - truth) ** 2))
    if set_up == "known":
        assert not result.counters["explained_by_lines"] and "bench" not in result.counters and error > 6e-6
        return
    assert result.counters["explained_by_lines"] and error < 4e-6
    values = {number["name"]: number["found"] for number in result.counters["bench"]["numbers"]}
    throw = values["gap_m"] + (values["base_thickness_m"] - 3e-3) / 1.46
    assert throw == pytest.approx(1.1e-3, abs=4e-5) and values["ambient"] == pytest.approx(0.03, abs=5e-3)
    np.testing.assert_allclose(result.image.mean(), seen.mean(), rtol=5e-3)
    assert all(abs(fit.height_error_m) < 2e-5 for fit in found.lines)
