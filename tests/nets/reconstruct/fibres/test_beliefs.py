"""What is stated of lines and a bench that were found together, and of lines by noise alone."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from nets.reconstruct.fibres.bench.bench_of_lines import numbers_of_lines
from nets.reconstruct.fibres.bench.line_posterior import (
    SHAPE_WIDTHS,
    JointCovariance,
    height_deviation,
    noise_covariance,
)
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.trust.beliefs import (
    as_believed,
    independent_share,
    stated_widths,
    times_less_known,
    told_together,
)
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_uncertainty import GLASS
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.simulator import CausticSimulator


def numbers(**widths):
    return numbers_of_lines(BenchNumbers.of(SCENE, widths))


def moved(**values):
    told = Bench.told(numbers())
    found = {name: told.values[name] + value for name, value in values.items()}
    return Bench({**told.values, **found}, told.field)


@pytest.mark.parametrize(
    "values, widths, times",
    [
        ({}, {}, 1.0),
        ({"gap_m": 5e-6}, {}, 1.0),
        ({"gap_m": 58e-6}, {}, 5.8),
        ({"gap_m": 58e-6}, {"gap_m": 29e-6}, 2.0),
        ({"gap_m": 30e-6, "base_thickness_m": -20e-6}, {}, 5.0),
        ({"screen_x_m": 1e-3}, {}, 1.0),
    ],
)
def test_gap_base_and_index_are_less_known_by_as_much_as_they_were_found_away(values, widths, times):
    assert times_less_known(numbers(**widths), moved(**values)) == pytest.approx(times)


def test_what_the_user_said_is_not_widened():
    widths = stated_widths(numbers(gap_m=29e-6), moved(gap_m=58e-6))
    assert widths == pytest.approx({"base_thickness_m": 2 * 5e-6, "index_offset": 2 * 3e-4})


def test_another_dispersion_is_another_glass():
    """Where that is found by more than four deviations."""
    told, careful = numbers(), stated_widths(numbers(), moved())["index_offset"]
    for sigma, is_other in ((0.07, True), (0.3, False)):
        bench = replace(moved(dispersion_scale=-1.0), sigma={"dispersion_scale": sigma})
        expected = math.hypot(careful, GLASS) if is_other else careful
        assert stated_widths(told, bench)["index_offset"] == pytest.approx(expected)
    assert "index_offset" not in stated_widths(numbers(index_offset=1e-4), bench)


def linear(seed=0, lines=12, places=(0, 3), fields=2):
    """Data and beliefs about lines, shape and a bench: information of each."""
    asked = numbers().only(("gap_m", "base_thickness_m", "screen_x_m"))
    size = lines + len(places) + len(asked.parameters) + fields
    rows = np.random.default_rng(seed).standard_normal((3 * size, size))
    # Lengths are of micrometres.
    rows[:, :lines] *= 1e6
    beliefs = np.zeros(size)
    beliefs[lines : lines + len(places)] = [SHAPE_WIDTHS[place] ** -2 for place in places]
    beliefs[lines + len(places) :] = 1.0
    return rows.T @ rows, beliefs, asked, JointCovariance(np.linalg.inv(rows.T @ rows + np.diag(beliefs)), places)


def test_other_beliefs_are_those_of_the_same_data():
    data, beliefs, asked, covariance = linear()
    same = as_believed(covariance, asked, {}, 5)
    np.testing.assert_allclose(same.matrix, covariance.matrix, rtol=1e-7, atol=1e-20)
    number = 14 + asked.names.index("gap_m")
    prior = asked.parameters[asked.names.index("gap_m")].prior
    others = beliefs.copy()
    others[number] = 9.0
    expected = np.linalg.inv(7 * data + np.diag(others))
    found = as_believed(covariance, asked, {"gap_m": prior / 3, "index_offset": 1.0}, 5, 7.0)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.matrix / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-8)
    assert found.places == covariance.places


def test_noise_does_not_err_together():
    assert independent_share(0.005, 1.0) == independent_share(0.02, 1.2) == 1.0
    assert independent_share(0.1, 1.0) == pytest.approx(20, rel=0.1)
    # What lines leave beside noise does.
    assert independent_share(0.1, 3.0) == pytest.approx(1.1, rel=0.03)


def test_lines_deviate_by_as_much_as_noise_moves_them():
    """Lines fitted to an image with noise of their own, time and again."""
    model, noise = LineModel(SCENE), 0.06
    exact = CausticSimulator(SCENE, "lattice", n_photons=16 * SCENE.image_pixels**2)(model.heights(LINES)).numpy()
    found = []
    for seed in range(12):
        white = noise * np.random.default_rng(seed).standard_normal(exact.shape)
        image = CausticImage((exact + white).astype(np.float32), np.full(len(exact), noise))
        fit = ImageFit(SCENE, image, model, SCENE.image_pixels, photons_per_pixel=16)
        found.append(model.heights(fit.descend(LINES, 15).lines))
    errors = torch.stack(found) - model.heights(LINES)
    view = LinesView(Resimulation(CausticSimulator(SCENE, "lattice"), image, np.ones(len(exact))), model)
    covariance = noise_covariance(view, LINES)
    deviation = torch.as_tensor(height_deviation(model, LINES, covariance))
    printed = model.heights(LINES) > 1e-5
    ratio = (errors / deviation)[:, printed]
    assert 0.6 < float(ratio.square().mean().sqrt()) < 1.3
    assert 1e-7 < float(deviation[printed].mean()) < 1e-5


def test_noise_that_nobody_told_is_estimated():
    """As what lines leave is judged by it; where it cannot be told, nothing is said."""
    model, noise = LineModel(SCENE), 0.06
    exact = CausticSimulator(SCENE, "lattice", n_photons=16 * SCENE.image_pixels**2)(model.heights(LINES)).numpy()
    shown = (exact + noise * np.random.default_rng(1).standard_normal(exact.shape)).astype(np.float32)

    def stated(image):
        view = LinesView(Resimulation(CausticSimulator(SCENE, "lattice"), image, np.ones(len(exact))), model)
        covariance = noise_covariance(view, LINES)
        return None if covariance is None else height_deviation(model, LINES, covariance)

    told = stated(CausticImage(shown, np.full(len(exact), noise)))
    assert np.sqrt(np.mean(stated(CausticImage(shown)) ** 2)) == pytest.approx(np.sqrt(np.mean(told**2)), rel=0.1)
    hidden = np.zeros(shown.shape, bool)
    hidden[:, :1, :1] = True
    assert stated(CausticImage(shown, mask=hidden)) is None


def test_gap_base_and_index_are_told_together():
    """As one factor: of a base that was thicker, too, lines would have told as so much less gap."""
    bend_light = {"gap_m", "base_thickness_m", "index_offset"}
    assert told_together(("gap_m", "ambient")) == {"ambient", *bend_light}
    assert told_together(("index_offset",)) == bend_light
    assert told_together(("screen_x_m", "ambient")) == {"screen_x_m", "ambient"}
