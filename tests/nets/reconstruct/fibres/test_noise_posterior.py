"""How far lines may be from where steps by noise end."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres import lines_result
from nets.reconstruct.fibres.bench.line_posterior import JointCovariance, height_deviation
from nets.reconstruct.fibres.bench.noise_fits import fit_by_noise
from nets.reconstruct.fibres.bench.noise_place import Place
from nets.reconstruct.fibres.bench.noise_posterior import noise_posterior
from nets.reconstruct.fibres.bench.noise_steps import NoiseSteps
from nets.reconstruct.fibres.image.descent_numbers import DescentNumbers, moving
from nets.reconstruct.fibres.trust.beliefs import SIMULATED_SHARE, left_open_by_simulation
from tests.nets.reconstruct.fibres.test_bench_fits import NOISE, NUMBERS, bench_with
from tests.nets.reconstruct.fibres.test_noise_steps import FARTHER, left_as_told
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.setup.optical import with_optical_values

BESIDE = len(NUMBERS.parameters) + len(bench_with().field)


@pytest.fixture
def model():
    return LineModel(SCENE)


def informed(size, seed=0):
    """Of numbers that go together, those of lines in metres."""
    rows = np.random.default_rng(seed).standard_normal((3 * size, size))
    rows[:, : LINES.numel()] *= 1e6
    return rows.T @ rows


def test_it_is_the_inverse_without_the_lens():
    """To the ridge."""
    kept, lens = LINES.numel() + 5, 4
    information = informed(kept + lens)
    found = noise_posterior(information, Shape(), (), len(LINES), 5)
    expected = np.linalg.inv(information)[:kept, :kept]
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.matrix / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-6)
    assert found.is_by_noise and found.places == ()


def test_with_a_section_heights_deviate_as_its_numbers_say(model):
    """Widths in steps are those of a cosine that is as wide at half its height."""
    model.shape = Shape(exponent=2.5)
    places = moving(model.shape)
    numbers = DescentNumbers(model, len(LINES), True)
    information = informed(numbers.size + 5)
    found = noise_posterior(information, model.shape, places, len(LINES), 5)
    slopes = numbers.derivatives(LINES, model.with_jacobian(LINES)[1]).flatten(1).double().numpy()
    own = np.linalg.inv(information)[: numbers.size, : numbers.size]
    expected = np.sqrt(np.einsum("pi,pq,qi->i", slopes, own, slopes)).reshape(model.n, model.n)
    np.testing.assert_allclose(height_deviation(model, LINES, found), expected, rtol=1e-3, atol=1e-12)


def test_noise_moves_heights_by_as_much(model):
    """Forty images of one plate, a step from the truth on each; what is believed beside it keeps steps a bit shorter."""
    true = bench_with(gap_m=2e-5)
    run = left_as_told(model, true)
    run.lines, run.bench = LINES.clone(), true
    steps, here = NoiseSteps(run), Place(LINES, model.shape, true, run.view.camera)
    picture = steps._at(here)
    steps._ask_noise(picture, true)
    slopes = steps._slopes(here, picture)
    steps._about(here, picture, steps._ways(here), slopes)
    found = noise_posterior(steps.information, model.shape, (), len(LINES), BESIDE)
    deviation, derivatives = height_deviation(model, LINES, found), model.with_jacobian(LINES)[1].double()
    rng, moved = np.random.default_rng(3), []
    for _ in range(40):
        rest = steps._misfit.deviations(NOISE * torch.from_numpy(rng.standard_normal(picture.shape)))
        step = np.linalg.solve(steps.information, slopes.gradient(rest, steps._misfit.weight(rest)))
        moved.append(torch.einsum("k,kij->ij", torch.from_numpy(step[: LINES.numel()]), derivatives))
    spread = torch.stack(moved).square().mean(0).sqrt().numpy()
    told = deviation > 1e-9
    assert told.sum() > 100 and 1e-8 < deviation[told].mean() < 1e-6
    ratio = np.sqrt(np.mean((spread / deviation.clip(1e-12))[told] ** 2))
    assert 0.7 < ratio < 1.15


def test_a_hundred_pixels_together_leave_more_open(model):
    run = left_as_told(model, bench_with(**FARTHER))
    assert fit_by_noise(run) is not None
    by_noise = height_deviation(model, run.lines, run.covariance)
    together = height_deviation(model, run.lines, run.together().covariance(run.lines, run.bench))
    assert by_noise.mean() < 0.3 * together.mean()
    assert run.bench.sigma["gap_m"] > 3e-6, "of its numbers is stated what a hundred leave"


def test_what_simulations_lack_is_stated_beside_it(model):
    heights = model.heights(LINES).numpy()
    scene = with_optical_values(SCENE, {"gap_m": 1.5e-4})
    relief = ThinRelief.of(scene)
    off = relief.unbent(relief.bent(heights) + SIMULATED_SHARE * relief.linear * heights) - heights
    np.testing.assert_allclose(left_open_by_simulation(heights, scene), np.abs(off), rtol=0.02, atol=1e-12)
    view = SimpleNamespace(scene=scene)
    options = SimpleNamespace(options=SimpleNamespace(bench_uncertainty=True))
    run = SimpleNamespace(view=view, told=view, numbers=NUMBERS, bench=bench_with(), hinted=0.0, method=options)
    for covariance, expected in (
        (None, 0.0),
        (JointCovariance(np.eye(18)), 0.0),
        (JointCovariance(np.eye(18), is_by_noise=True), left_open_by_simulation(heights, scene)),
    ):
        run.covariance = covariance
        np.testing.assert_array_equal(
            lines_result._left_open_by_bench(run, heights, 1.0), np.broadcast_to(expected, heights.shape)
        )
    assert not left_open_by_simulation(np.zeros((8, 8)), SCENE).any()
