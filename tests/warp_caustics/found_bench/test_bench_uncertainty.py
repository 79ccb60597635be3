"""What of the heights' uncertainty is the bench's."""

import math

import numpy as np
import pytest

from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import FoundNumber
from warp_caustics.found_bench.bench_uncertainty import GLASS, bench_uncertainty, bench_widths, careful_widths
from warp_caustics.found_bench.thin_relief import MAGNIFICATION, TURN, relief_responses
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=64, image_pixels=256, screen_position_m=(0, 0, -1e-3))
LAMP = Scene(light_position_m=(0.0, 0.0, 0.5), emission_half_angle_rad=0.1)


@pytest.fixture
def heights():
    x = np.linspace(-1, 1, 64)
    return 5e-4 * np.exp(-8 * (x[None, :] ** 2 + (x[:, None] - 0.2) ** 2))


def test_it_covers_heights_found_on_benches_that_differ_by_so_much(heights):
    """Benches drawn with these deviations move heights by as much as is said, at every point, to first order."""
    widths = careful_widths(SCENE)
    responses = relief_responses(SCENE, heights, widths)
    drawn = np.random.default_rng(3).standard_normal((4000, len(widths)))
    moved = np.tensordot(drawn * list(widths.values()), np.stack([responses[name] for name in widths]), 1)
    found = bench_uncertainty(SCENE, heights, widths)
    np.testing.assert_allclose(moved.std(0), found.total_m, rtol=0.07, atol=1e-12)


def test_a_careful_user_knows_the_gap_to_10_um_on_the_screen_too():
    assert careful_widths(Scene())["gap_m"] == pytest.approx(1e-5)  # a gap of 1 um, as in Tab. 1
    assert careful_widths(SCENE)["gap_m"] == pytest.approx(1e-5)
    assert careful_widths(SCENE)["screen_x_m"] == pytest.approx(0.025 * max(SCENE.pixel_size_m))


def test_numbers_that_are_exact_leave_nothing(heights):
    exact = dict.fromkeys(careful_widths(SCENE), 0.0)
    assert bench_widths(SCENE, exact) == {}
    found = bench_uncertainty(SCENE, heights, {})
    assert not found.total_m.any() and found.record == {"bench_um": 0.0, "numbers": {}}


def test_what_the_user_says_is_taken_and_its_share_told(heights):
    widths = bench_widths(SCENE, dict.fromkeys(careful_widths(SCENE), 0.0) | {"gap_m": 1e-4})
    assert widths == {"gap_m": 1e-4}
    record = bench_uncertainty(SCENE, heights, widths).record
    way = 3e-3 / 1.46 + 1e-3
    assert record["bench_um"] == pytest.approx(1e6 * np.sqrt((heights**2).mean()) * 1e-4 / way, rel=0.1)
    assert record["numbers"]["gap_m"]["um"] == pytest.approx(record["bench_um"])


def test_the_largest_part_comes_first(heights):
    numbers = bench_uncertainty(SCENE, heights, careful_widths(SCENE)).record["numbers"]
    parts = [number["um"] for number in numbers.values()]
    assert parts == sorted(parts, reverse=True) and len(parts) == 8


def test_a_lamp_nearby_has_its_distance():
    assert careful_widths(LAMP)["lamp_distance_m"] == pytest.approx(0.01 * 0.497)
    assert "vergence_per_m" not in careful_widths(LAMP)
    assert careful_widths(LAMP)[TURN] == careful_widths(LAMP)[MAGNIFICATION]


def found_number(seen, sigma, is_used):
    parameter = next(p for p in BenchNumbers.of(SCENE).parameters if p.name == "vergence_per_m")
    number = FoundNumber.of(parameter, 0.0, seen, sigma, is_used=is_used)
    return vars(number)


def test_what_the_image_told_takes_the_place_of_what_was_believed():
    widths = bench_widths(SCENE, {}, [found_number(1.0, 0.05, True)])
    assert widths["vergence_per_m"] == pytest.approx(0.05)
    in_doubt = bench_widths(SCENE, {}, [found_number(1.0, 0.05, False)])
    assert in_doubt["vergence_per_m"] == pytest.approx(np.hypot(1.0, 0.05))
    untold = bench_widths(SCENE, {"vergence_per_m": 0.3}, [found_number(0.0, None, False)])
    assert untold["vergence_per_m"] == 0.3


def test_another_dispersion_is_another_glass():
    """Whose index nobody knows; unless somebody says so, or the image tells it."""
    number = {"name": "dispersion_scale", "told": 1.0, "seen": 0.2, "found": 0.2, "sigma": 0.05, "verdict": "found"}
    index = {"name": "index_offset", "told": 0.0, "seen": 0.03, "found": 0.03, "sigma": 1e-3, "verdict": "found"}
    careful = careful_widths(SCENE)["index_offset"]
    assert bench_widths(SCENE, {}, [number])["index_offset"] == pytest.approx(math.hypot(careful, 0.8 * GLASS))
    assert bench_widths(SCENE, {}, [number | {"verdict": "as told"}])["index_offset"] == careful
    assert bench_widths(SCENE, {"index_offset": 1e-4}, [number])["index_offset"] == 1e-4
    assert bench_widths(SCENE, {}, [number, index])["index_offset"] == 1e-3
