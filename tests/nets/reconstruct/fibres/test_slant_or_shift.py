"""Benches that lay a picture aside as another one does."""

import pytest

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from nets.reconstruct.fibres.bench.bench_of_lines import numbers_of_lines
from nets.reconstruct.fibres.bench.slant_or_shift import names_of_place, other_places
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.scene import Scene

PARALLEL = Scene(height_samples=32, image_pixels=64, screen_position_m=(0.0, 0.0, -1e-3))
LAMP = Scene(height_samples=32, image_pixels=64, emission_half_angle_rad=0.08, light_position_m=(0.0, 0.0, 0.5))


def of(scene, widths=None, **values):
    numbers = numbers_of_lines(BenchNumbers.of(scene, widths or {}))
    told = Bench.told(numbers)
    return numbers, Bench({**told.values, **values}, told.field)


@pytest.mark.parametrize(
    "scene, found",
    [
        (PARALLEL, {"tilt_x_rad": 0.01, "screen_x_m": 5e-6, "screen_y_m": -3e-5, "tilt_y_rad": -0.002}),
        (PARALLEL, {"tilt_x_rad": 0.01, "gap_m": 1.3e-3}),
        (LAMP, {"lamp_x_m": 2e-3, "screen_y_m": 4e-5, "lamp_distance_m": 0.45}),
    ],
)
def test_they_lay_the_picture_aside_alike(scene, found):
    """By the middle of the picture in closed form, in which both are one number."""
    numbers, bench = of(scene, **found)
    others = list(other_places(numbers, bench))
    offset = ThinRelief.of(numbers.scene_of(bench.values)).offset_m
    slants = [name for name in names_of_place(numbers) if not name.startswith("screen")]
    assert others and len(slants) == 2
    for other in others:
        assert ThinRelief.of(numbers.scene_of(other.values)).offset_m == pytest.approx(offset, rel=1e-6, abs=1e-12)
        is_light = all(other.values[name] == 0 for name in ("screen_x_m", "screen_y_m"))
        assert is_light or all(other.values[name] == 0 for name in slants)
        assert all(other.values[n] == v for n, v in bench.values.items() if n not in names_of_place(numbers))


def test_a_move_is_only_a_slant_and_a_slant_only_a_move():
    for name in ("screen_x_m", "tilt_x_rad"):
        (other,) = other_places(*of(PARALLEL, **{name: 1e-5}))
        assert other.values[name] == 0.0
    assert list(other_places(*of(PARALLEL))) == []
    assert list(other_places(*of(PARALLEL, ambient=0.02))) == []


def test_what_is_known_exactly_stays():
    widths = {name: 0.0 for name in ("tilt_x_rad", "tilt_y_rad")}
    assert list(other_places(*of(PARALLEL, widths, screen_x_m=1e-5))) == []
