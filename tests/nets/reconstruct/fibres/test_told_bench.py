"""What lines tell of a bench that is as told, and what is believed of it, put together."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.bench_of_lines import numbers_of_lines
from nets.reconstruct.fibres.method import _as_told
from nets.reconstruct.fibres.trust.told_bench import AS_TOLD, told_bench
from nets.reconstruct.with_bench import FLATNESS_M, with_bench
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_uncertainty import bench_uncertainty, careful_widths
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import with_optical_values

SCENE = Scene(height_samples=32, image_pixels=64)
NUMBERS = numbers_of_lines(BenchNumbers.of(SCENE))
CAREFUL = careful_widths(SCENE)
GAP_M, GAP_SLOPE = -SCENE.screen_position_m[2], SCENE.glass_indices[1] - 1
WIDTHS = {name: CAREFUL[name] for name in BEND_LIGHT}


def hill():
    x = np.linspace(-1, 1, 32)
    return 4e-4 * np.exp(-4 * (x[:, None] ** 2 + x**2))


def teller(share, sigma, numbers=NUMBERS):
    return told_bench((share, sigma), numbers, Bench.told(numbers), hill())


def test_an_image_that_says_nothing_leaves_what_is_believed():
    """As the bench's part of heights that are free: the same closed form."""
    known = teller(0.0, 1e3).known(WIDTHS)
    expected = bench_uncertainty(SCENE, hill(), WIDTHS).total_m
    np.testing.assert_allclose(known.deviation_m, expected, rtol=0.02, atol=1e-9)
    assert known.sigma == pytest.approx(WIDTHS, rel=1e-6)


def test_an_image_that_says_it_exactly_leaves_what_it_says():
    """A share t: heights of the told bench are too high by what sends light so much farther."""
    share = 0.02
    wide = {name: 100 * width for name, width in WIDTHS.items()}
    known = teller(share, 0.0).known(wide)
    there = with_optical_values(SCENE, {"gap_m": GAP_M + share * ThinRelief.of(SCENE).linear / GAP_SLOPE})
    heights = ThinRelief.of(there).unbent(ThinRelief.of(SCENE).bent(hill()))
    expected = np.hypot(hill() - heights, AS_TOLD * hill())
    np.testing.assert_allclose(known.deviation_m, expected, rtol=0.05, atol=1e-8)
    # What all of them do together is known, which of them does it is not.
    assert 0.2 * wide["gap_m"] < known.sigma["gap_m"] < wide["gap_m"]


def test_both_count_by_their_weights():
    """Of one number alone: the mean and variance of a product of two Gaussians."""
    only = dict.fromkeys(BEND_LIGHT, 0.0) | {"gap_m": CAREFUL["gap_m"]}
    told = teller(0.01, 0.003)
    believed, seen = told.slopes["gap_m"] * CAREFUL["gap_m"], np.hypot(0.003, AS_TOLD)
    variance = 1 / (believed**-2 + seen**-2)
    square = variance + (0.01 * variance / seen**2) ** 2
    known = told.known(only)
    np.testing.assert_allclose(known.deviation_m, np.sqrt(square) * told.response_m, rtol=1e-6)
    assert known.sigma["gap_m"] == pytest.approx(CAREFUL["gap_m"] * np.sqrt(variance) / believed)
    assert known.sigma["index_offset"] == 0.0


def test_known_exactly_or_not_asked_it_tells_nothing():
    assert told_bench(None, NUMBERS, Bench.told(NUMBERS), hill()) is None
    exactly = numbers_of_lines(BenchNumbers.of(SCENE, dict.fromkeys(BEND_LIGHT, 0.0)))
    assert teller(0.01, 0.003, exactly) is None
    assert not teller(0.01, 0.003).known(dict.fromkeys(BEND_LIGHT, 0.0)).deviation_m.any()


def test_a_result_states_what_is_left_open_of_gap_base_and_index():
    found = Reconstruction(
        "fibres", hill(), np.zeros((3, 64, 64)), 0.1, "converged", uncertainty_m=np.full((32, 32), 1e-7), counters={}
    )
    plain, sure = (with_bench(found, NUMBERS, told=told) for told in (None, teller(0.0, 0.001)))
    parts, before = (each.counters["uncertainty"] for each in (sure, plain))
    assert parts["bench_um"] < 0.95 * before["bench_um"]
    others = [name for name in before["numbers"] if name not in BEND_LIGHT]
    assert {name: parts["numbers"][name] for name in others} == {name: before["numbers"][name] for name in others}
    for name in BEND_LIGHT:
        assert parts["numbers"][name]["sigma"] < before["numbers"][name]["sigma"]
    # Their shares are those of the whole that is left open.
    rms = np.sqrt(sum(part["um"] ** 2 for part in parts["numbers"].values()))
    assert rms == pytest.approx(parts["bench_um"], rel=1e-6)
    assert sure.uncertainty_m.min() == pytest.approx(np.hypot(1e-7, FLATNESS_M), rel=0.05)


def test_what_was_counted_with_the_lines_is_not_counted_twice():
    found = Reconstruction(
        "fibres", hill(), np.zeros((3, 64, 64)), 0.1, "converged", uncertainty_m=np.full((32, 32), 1e-7), counters={}
    )
    counted = with_bench(found, NUMBERS, BEND_LIGHT, told=teller(0.02, 0.001))
    np.testing.assert_array_equal(counted.uncertainty_m, with_bench(found, NUMBERS, BEND_LIGHT).uncertainty_m)
    assert (
        dataclasses.asdict(counted)["counters"]
        == dataclasses.asdict(with_bench(found, NUMBERS, BEND_LIGHT))["counters"]
    )


def run_with(**others):
    known = {
        "takes_lines": True, "is_noise_left": True, "curves": None, "waves": None, "told_share": (0.02, 0.001),
        "hinted": 0.0, "way_sigma": None, "numbers": NUMBERS, "bench": Bench.told(NUMBERS), "relief": hill,
    }  # fmt: skip
    return SimpleNamespace(**known | others)


def test_lines_that_explain_an_image_tell_and_others_do_not():
    told = _as_told(run_with())
    assert (told.share, told.sigma) == (0.02, 0.001)
    assert _as_told(run_with(hinted=0.02)).share == 0.0, "which is stated already"
    for others in ({"takes_lines": False}, {"is_noise_left": False}, {"waves": 1}, {"curves": 1}, {"told_share": None}):
        assert _as_told(run_with(**others)) is None, others
