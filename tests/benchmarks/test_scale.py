"""Time and memory against size: slopes, what is measured, memory that is counted where it is taken."""

import mmap
import sys

import numpy as np
import pytest

from benchmarks import scale


def rows(sizes, exponent):
    return [{"size": size, "image_s": 1e-3 + size**exponent} for size in sizes]


@pytest.mark.parametrize("sizes", [np.geomspace(1e5, 1e8, 7), 4.0 ** np.arange(8, 14), np.array([1e3, 1e6])])
@pytest.mark.parametrize("exponent", [1.0, 1.5])
def test_slope_is_the_exponent_of_the_largest(sizes, exponent):
    """Not of the small ones, where what every call costs hides it."""
    assert scale.slope(rows(sizes, exponent), "image_s") == pytest.approx(exponent, abs=1e-3)


def test_every_axis_grows_alone():
    """But for photons, which are four to a pixel."""
    for axis in ("photons", "pixels", "samples", "batch"):
        cases = [case for case in scale.cases_of("cuda") if case.axis == axis]
        assert len(cases) > 3 and [case.size for case in cases] == sorted({case.size for case in cases})
        for other in {"photons", "pixels", "samples", "batch"} - {axis}:
            if (axis, other) != ("pixels", "photons"):
                assert len({getattr(case, other) for case in cases}) == 1


def test_a_case_has_all_figures():
    row = scale.measure(scale.Case("samples", 900, pixels=20, samples=12), "cpu", 1)
    assert (row["photons"], row["size"]) == (900, 144)
    assert 0 < row["image_s"] < 60 and 0 < row["both_s"] < 60


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux tells a process its memory")
def test_memory_is_counted_though_it_is_given_back():
    memory = scale.Memory("cpu")
    memory.start()
    with mmap.mmap(-1, 2**27) as held:  # an array might lie where an earlier one did
        for _ in range(2**7):
            held.write(bytes(2**20))
    assert memory.most() == pytest.approx(1 / 8, rel=0.2)
