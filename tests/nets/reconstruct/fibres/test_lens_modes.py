"""What a lens that is a little other changes of an image."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from nets.reconstruct.fibres.bench.bench_of_lines import BenchOfLines
from nets.reconstruct.fibres.bench.camera_of_lines import fit_with_spread
from nets.reconstruct.fibres.bench.gap_fits import fit_with_gap_and_lens
from nets.reconstruct.fibres.bench.gap_of_lines import GapOfLines
from nets.reconstruct.fibres.bench.lens_modes import PAIRS, lens_beside, lens_modes
from nets.reconstruct.fibres.image.lines_view import LinesView
from tests.nets.reconstruct.fibres.test_gap_of_lines import LINES, NOISE, SCENE, SHARP, N, error_um, numbers
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.exact_picture import ExactPicture
from warp_caustics.reconstruct.seen_camera.point_spread import REACH, PointSpread
from warp_caustics.setup.optical import with_optical_values
from warp_caustics.simulator import CausticSimulator

SIDE, CHANNELS = 24, 2


def sharp():
    return torch.rand(CHANNELS, SIDE, SIDE, generator=torch.Generator().manual_seed(4))


def test_pairs_are_all_weights_but_the_middle_once():
    both = [*PAIRS, *((-i, -j) for i, j in PAIRS)]
    assert len(set(both)) == len(both) == (2 * REACH + 1) ** 2 - 1 and (0, 0) not in both


@pytest.mark.parametrize("number", [0, 7, len(PAIRS) - 1])
@pytest.mark.parametrize("channel", range(CHANNELS))
def test_a_mode_is_what_a_pair_of_weights_changes(number, channel):
    light, amount = sharp(), 0.01
    plain = PointSpread.of_lens(np.zeros(CHANNELS))
    weights = plain.weights.copy()
    i, j = PAIRS[number]
    weights[channel, [REACH + i, REACH - i], [REACH + j, REACH - j]] += amount
    weights[channel, REACH, REACH] -= 2 * amount
    other = dataclasses.replace(plain, weights=weights)
    change = (other(light, SIDE) - plain(light, SIDE)) / amount
    modes = lens_modes(light).unflatten(0, (len(PAIRS), CHANNELS))
    torch.testing.assert_close(modes[number, channel], change, rtol=0, atol=2e-4)


def test_even_light_has_none():
    assert float(lens_modes(torch.full((1, SIDE, SIDE), 0.7)).abs().max()) < 1e-6


def test_modes_are_of_what_the_camera_shows():
    """With what the simulation misses of it."""
    light, missing = sharp(), 0.1 * sharp().flip(-1)
    fit = SimpleNamespace(seen=lambda heights: light, missing=missing)
    beside = lens_beside(fit, torch.zeros(3, 3), 0.5)
    torch.testing.assert_close(beside.modes, 0.1 * lens_modes(light + missing))
    assert beside.weight == 0.5 and not beside.before.any() and len(beside.before) == len(PAIRS) * CHANNELS


LENS_PX, WIDER_M = 0.7, 5e-5


@pytest.fixture(scope="module")
def run():
    """Lines behind a lens, both found on a bench whose gap is told too small."""
    model, lens = LineModel(SCENE), np.full(3, LENS_PX)
    told = numbers(gap_m=4e-4, base_thickness_m=1e-6, index_offset=1e-6)
    gap_m = told.before["gap_m"] + WIDER_M
    sharp = CausticSimulator(with_optical_values(SCENE, {"gap_m": gap_m}), "lattice")
    behind = dataclasses.replace(SHARP, blur=lens, spread=PointSpread.of_lens(lens))
    shown = ExactPicture(sharp, behind)(model.heights(LINES)).numpy()
    noise = NOISE * np.random.default_rng(0).standard_normal(shown.shape)
    image = CausticImage((shown + noise).astype(np.float32), np.full(3, NOISE))
    run = SimpleNamespace(model=model, lines=LINES.clone(), numbers=told, bench=Bench.told(told), note=None)
    run.covariance, run.counted, run.asked, run.is_elsewhere, run.moves_section = None, None, (), False, False

    def on(bench, camera=None):
        light = Resimulation(CausticSimulator(told.scene_of(bench.values), "lattice"), image, np.ones(3))
        return LinesView(light.through(camera or run.view.camera), model)

    def together(names=None):
        return BenchOfLines(told, run.view.image, model, 2 * N, run.view.camera)

    run.on, run.together = on, together
    run.view = on(run.bench, dataclasses.replace(SHARP, blur=lens))
    for _ in range(3):
        fit_with_spread(run, 1.0)
    return run


def test_a_lens_hides_how_far_light_goes(run):
    """Found on a bench it makes up for that: with it as it is lines tell less of another."""
    assert run.view.camera.spread is not None and error_um(run.model, run.lines) > 4
    there = GapOfLines(run.together(), has_lens=True), GapOfLines(run.together())
    for valley in there:
        valley(run.lines, run.bench)
    (along, deviation), (alone, less) = (valley.told for valley in there)
    assert along > 1.2 * alone > 0
    assert deviation > 1.2 * less


def test_gap_and_lens_are_found_together(run):
    before = run.lines, run.bench, run.view
    run.covariance, run.asked = "known", ("gap_m",)
    fit_with_gap_and_lens(run)
    by_lens = error_um(run.model, run.lines)
    assert run.bench.values["gap_m"] > before[1].values["gap_m"] + 0.7 * WIDER_M
    assert by_lens < 0.35 * error_um(run.model, before[0])
    assert run.view.camera.spread is not None
