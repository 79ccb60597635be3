"""Derivatives by the numbers of a bench, in closed form."""

import pytest
import torch

from nets.reconstruct.fibres.bench.noise_bench import ByBench
from tests.nets.reconstruct.fibres.test_bench_fits import NUMBERS, bench_with
from warp_caustics.found_bench.bench_numbers import AMBIENT

ASKED = NUMBERS.only(["gap_m", "screen_x_m", AMBIENT])
HERE, THERE = bench_with(gap_m=1e-3, screen_x_m=2e-5), bench_with(gap_m=3e-3, screen_x_m=5e-5)
STRAY = torch.full((1, 2, 2), 0.25, dtype=torch.float64)


class Parabola:
    """Shows gap and shift squared; counts pictures."""

    def __init__(self):
        self.pictures = 0

    def __call__(self, bench):
        self.pictures += 1
        light = sum(bench.values[name] ** 2 for name in ("gap_m", "screen_x_m"))
        return torch.full((1, 2, 2), light, dtype=torch.float64)


def rows(by_bench, bench, shown):
    found = by_bench(ASKED, bench, 64, shown, STRAY)
    return {p.name: float(row[0, 0, 0]) / p.prior for p, row in zip(ASKED.parameters, found, strict=True)}


@pytest.mark.parametrize("renews", [True, False])
def test_derivatives_are_in_the_widths_of_what_is_believed(renews):
    """Central differences are exact for a square."""
    shown = Parabola()
    found = rows(ByBench(renews), HERE, shown)
    assert list(found) == list(ASKED.names) and shown.pictures == 4, "stray light needs none"
    assert found["gap_m"] == pytest.approx(2 * 1e-3) and found["screen_x_m"] == pytest.approx(2 * 2e-5)
    assert found[AMBIENT] == pytest.approx(0.25)


@pytest.mark.parametrize(("renews", "pictures", "gap_m"), [(True, 8, 3e-3), (False, 4, 1e-3)])
def test_those_of_the_first_place_serve_for_all_where_pictures_take_long(renews, pictures, gap_m):
    by_bench, shown = ByBench(renews), Parabola()
    rows(by_bench, HERE, shown)
    found = rows(by_bench, THERE, shown)
    assert shown.pictures == pictures and found["gap_m"] == pytest.approx(2 * gap_m)


def test_a_number_that_was_not_asked_before_is_taken_where_it_is():
    by_bench, shown = ByBench(renews=False), Parabola()
    next(by_bench(NUMBERS.only(["screen_x_m"]), HERE, 64, shown, None))
    assert rows(by_bench, THERE, shown)["gap_m"] == pytest.approx(2 * 3e-3) and shown.pictures == 4
