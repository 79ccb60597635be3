"""The bench's part of an uncertainty: what no image tells is as uncertain as the care that it shows."""

from dataclasses import asdict

import numpy as np
import pytest

from nets.reconstruct.with_bench import FLATNESS, FLATNESS_M, with_bench
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import FoundNumber
from warp_caustics.found_bench.bench_uncertainty import careful_widths
from warp_caustics.found_bench.care import CAREFUL, UNTOLD
from warp_caustics.found_bench.rest_causes import UNEVEN, Cause
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=32, image_pixels=64)
NUMBERS = BenchNumbers.of(SCENE)
CAREFUL_WIDTHS = careful_widths(SCENE)


def hill():
    x = np.linspace(-1, 1, 32)
    return 4e-4 * np.exp(-4 * (x[:, None] ** 2 + x**2))


def result(uneven=0.0, aside=0.0, **others):
    """Heights known to 1 um, on a bench whose light and place are off by so many widths of a careful one."""
    place = next(p for p in NUMBERS.parameters if p.name == "screen_x_m")
    found = FoundNumber.of(place, 0.0, aside * CAREFUL_WIDTHS["screen_x_m"], 1e-9, is_used=True)
    cause = Cause(UNEVEN, "uneven", uneven * CAREFUL[UNEVEN], 1e-4, 0.5)
    counters = {"rest": {"ratio": 0.5, "causes": [asdict(cause)]}, "bench": {"numbers": [asdict(found)]}}
    return Reconstruction(
        "direct", hill(), np.zeros((3, 64, 64)), 0.1, "converged",
        uncertainty_m=np.full((32, 32), 1e-6), counters=counters | others,
    )  # fmt: skip


def test_with_care_the_numbers_are_those_of_a_careful_user():
    parts = with_bench(result(uneven=1, aside=1), NUMBERS).counters["uncertainty"]
    assert parts["numbers"]["gap_m"]["sigma"] == pytest.approx(CAREFUL_WIDTHS["gap_m"])
    assert parts["care"]["times"] == 1 and parts["care"]["line"] == "" and parts["care"]["widened"] == []


def test_without_care_heights_are_uncertain_by_the_factor_that_no_image_tells():
    """Ten times less care: a gap known to 100 um, and with base and index 5.3 % of the height in all."""
    careful, careless = (with_bench(result(uneven=u, aside=10), NUMBERS) for u in (0, 20))
    parts = careless.counters["uncertainty"]
    assert parts["care"]["times"] == pytest.approx(10) and "10 times less care" in parts["care"]["line"]
    assert parts["care"]["widened"] == [*UNTOLD, FLATNESS]
    for name in UNTOLD:
        before = careful.counters["uncertainty"]["numbers"][name]
        assert parts["numbers"][name]["sigma"] == pytest.approx(10 * before["sigma"])
        assert parts["numbers"][name]["um"] == pytest.approx(10 * before["um"])
    top = np.unravel_index(np.argmax(hill()), (32, 32))
    assert careless.uncertainty_m[top] == pytest.approx(0.053 * hill()[top], rel=0.15)
    for found, times in ((careful, 1), (careless, 10)):
        assert found.uncertainty_m[0, 0] == pytest.approx(np.hypot(1e-6, times * FLATNESS_M), rel=0.01)


def test_what_the_user_says_of_the_gap_is_believed_without_care_too():
    told = BenchNumbers.of(SCENE, {"gap_m": 2e-5})
    parts = with_bench(result(uneven=20, aside=10), told).counters["uncertainty"]
    assert parts["numbers"]["gap_m"]["sigma"] == 2e-5
    assert parts["care"]["widened"] == ["base_thickness_m", "index_offset", FLATNESS]
    assert "gap_m +-" not in parts["care"]["line"]


def test_a_base_is_as_flat_as_the_bench_is_careful_unless_somebody_says():
    """A bow of 10 um, as of a careless bench, lifts bare plate by as much as is said of it; no image shows it."""
    parts = with_bench(result(uneven=20, aside=10), NUMBERS).counters["uncertainty"]
    assert parts["numbers"][FLATNESS] == {"sigma": pytest.approx(10 * FLATNESS_M), "um": pytest.approx(5.0)}
    assert parts["bench_um"] > 5.0
    assert "flatness_m +- 5e-06" in parts["care"]["line"]
    said = with_bench(result(uneven=20, aside=10), NUMBERS, flatness_m=3e-6).counters["uncertainty"]
    assert said["numbers"][FLATNESS]["sigma"] == 3e-6 and "flatness_m" not in said["care"]["line"]
    told = with_bench(result(uneven=20, aside=10), NUMBERS, flatness_m=0.0)
    assert FLATNESS not in told.counters["uncertainty"]["numbers"]
    assert FLATNESS not in told.counters["uncertainty"]["care"]["line"]
    assert told.uncertainty_m[0, 0] == pytest.approx(1e-6, rel=0.3)


def test_numbers_that_were_found_with_lines_are_not_counted_again():
    parts = with_bench(result(uneven=20, aside=10), NUMBERS, UNTOLD).counters["uncertainty"]
    assert not set(UNTOLD) & set(parts["numbers"]) and parts["care"]["widened"] == [FLATNESS]


def test_without_an_uncertainty_nothing_is_added():
    bare = Reconstruction("refine", hill(), np.zeros((3, 64, 64)), 0.1, "converged")
    assert with_bench(bare, NUMBERS) is bare
