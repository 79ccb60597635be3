"""Benches that lay a picture aside as another one does: by light from aside, or by a screen that was moved.

To first order both are one. What is high lies a little farther aside under slanted light, and lines that make up for
that, by tens of nanometres, hold the bench where it was found: of ten plates in light slanted by 0.2 degrees five were
told as moved by some or all of it, twelve deviations away from the slant, and 0.3 um off where the others were 0.1.
"""

import dataclasses
import math
from collections.abc import Iterator

from nets.reconstruct.fibres.bench.bench_and_light import Bench
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.way_of_light import way_of_light_m

SCREEN = ("screen_x_m", "screen_y_m")
TILT, LAMP = ("tilt_x_rad", "tilt_y_rad"), ("lamp_x_m", "lamp_y_m")
LAMP_DISTANCE = "lamp_distance_m"


def names_of_place(numbers: BenchNumbers) -> tuple[str, ...]:
    """Numbers that lay a picture aside, of those that are looked for: of the screen, then of the light."""
    return tuple(name for name in (*SCREEN, *TILT, *LAMP) if name in numbers.names)


def other_places(numbers: BenchNumbers, bench: Bench) -> Iterator[Bench]:
    """The bench with its picture aside by light alone, and by the screen alone; those that are other than it is.

    Light at a slant a lands D tan(a) aside, D the way of light through base and gap; that of a lamp at a distance L
    which is beside the middle by l lands D l / L aside, the other way.

    Args:
        numbers: that the bench's are; none where screen or light are known exactly.
        bench: that was found.
    """
    slants = TILT if TILT[0] in numbers.names else LAMP
    if not {*SCREEN, *slants} <= set(numbers.names):
        return
    way = way_of_light_m(numbers.scene_of(bench.values))
    by_light, by_screen = dict(bench.values), dict(bench.values)
    for screen, slant in zip(SCREEN, slants, strict=True):
        told_screen, told_slant = numbers.before[screen], numbers.before[slant]
        aside = _aside(numbers, bench, slant, bench.values[slant], way) - bench.values[screen]
        by_light[screen], by_screen[slant] = told_screen, told_slant
        by_light[slant] = _slant(numbers, bench, slant, aside + told_screen, way)
        by_screen[screen] = _aside(numbers, bench, slant, told_slant, way) - aside
    for values in (by_light, by_screen):
        within = numbers.within(values)
        if any(not math.isclose(within[name], bench.values[name], abs_tol=1e-12) for name in within):
            yield dataclasses.replace(bench, values={**bench.values, **within})


def _aside(numbers: BenchNumbers, bench: Bench, name: str, value: float, way: float) -> float:
    """How far aside light of such a slant lands [m]."""
    return way * math.tan(value) if name in TILT else -way * value / _lamp_distance(numbers, bench)


def _slant(numbers: BenchNumbers, bench: Bench, name: str, aside: float, way: float) -> float:
    """The inverse of :func:`_aside`."""
    return math.atan(aside / way) if name in TILT else -aside * _lamp_distance(numbers, bench) / way


def _lamp_distance(numbers: BenchNumbers, bench: Bench) -> float:
    return bench.values.get(LAMP_DISTANCE, numbers.before[LAMP_DISTANCE])
