"""Searches of lines ask benches anywhere within what a bench may be, with beliefs that were widened beyond that."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT, Bench
from nets.reconstruct.fibres.bench.bench_of_lines import numbers_of_lines
from nets.reconstruct.fibres.bench.gap_of_lines import along, by_number, likeliest
from nets.reconstruct.fibres.bench.less_believed import less_believed
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.scene import Scene

TOLD = (
    Scene(),
    Scene(screen_position_m=(0.0, 0.0, -0.1), light_tilt_rad=(0.05, 0.0)),
    Scene(emission_half_angle_rad=0.2, light_position_m=(0.0, 0.0, 0.3), base_thickness_m=0.01),
)
LONG_M = 0.5
"""Of lengths drawn here: on real benches no more."""


@st.composite
def benches(draw):
    """What is told, and a bench within its ranges, to their ends, that light goes through."""
    told = numbers_of_lines(BenchNumbers.of(draw(st.sampled_from(TOLD))))
    values = dict(Bench.told(told).values)
    for p in told.parameters:
        if p.name in BEND_LIGHT or draw(st.booleans()):
            values[p.name] = draw(st.floats(max(p.low, -LONG_M), min(p.high, LONG_M)))
    try:
        told.scene_of(values)
    except InputError:  # light that misses the plate
        reject()
    return told, dataclasses.replace(Bench.told(told), values=values)


def linear(told, bench):
    return ThinRelief.of(told.scene_of(bench.values)).linear


@settings(max_examples=300, deadline=None)
@given(benches(), st.floats(1.0, 1e6))
def test_how_far_light_goes_is_asked_within_what_a_bench_may_be(drawn, wider):
    told, bench = drawn
    for p in told.parameters:
        if p.name in BEND_LIGHT:
            slope = by_number(told, bench, dataclasses.replace(p, prior=wider * p.prior))
            assert slope > 0 and math.isfinite(slope)


@settings(max_examples=300, deadline=None)
@given(benches(), st.floats(-0.9, 3.0))
def test_benches_farther_away_are_within_their_ranges_or_refused(drawn, share):
    told, bench = drawn
    believed = less_believed(told, bench)
    ranges = {p.name: (p.low, p.high) for p in told.parameters}
    found = [likeliest(believed, bench)]
    try:
        found.append(along(believed, bench, share))
    except InputError as error:
        assert "no bench on which light goes" in str(error)
    for each in found:
        assert linear(told, each) > 0
        assert all(ranges[name][0] <= value <= ranges[name][1] for name, value in each.values.items())


def test_a_belief_wider_than_a_range_is_asked_by_a_part_of_it():
    """Of an index the whole range is 0.4: glass that was believed to 0.5 sent a difference to -0.34, no glass."""
    told = numbers_of_lines(BenchNumbers.of(Scene()))
    (index,) = (p for p in told.parameters if p.name == "index_offset")
    bench = dataclasses.replace(Bench.told(told), values={**Bench.told(told).values, "index_offset": 0.15})
    # (n - 1) d / n, by its ends: d (1 / n_low - 1 / n) over what lies between.
    scene, low = (told.scene_of({**bench.values, "index_offset": value}) for value in (0.15, -0.2))
    ends = [scene.base_thickness_m * np.mean([1 / n for n in each.glass_indices]) for each in (low, scene)]
    slope = by_number(told, bench, dataclasses.replace(index, prior=0.5))
    assert slope == pytest.approx((ends[0] - ends[1]) / 0.35, rel=0.01)
