"""The better of two searches for a bench."""

import dataclasses

import numpy as np

from nets.reconstruct.tried_bench import TriedBench
from warp_caustics.found_bench.bench_record import FoundBench
from warp_caustics.reconstruct.base import Reconstruction


def tried(left, seconds, stop="converged", is_kept=True):
    told = Reconstruction("direct", np.zeros((2, 2)), np.zeros((3, 2, 2)), 0.2, "converged", timings_s={"network": 1.0})
    kept = dataclasses.replace(told, residual=left, stop_reason=stop)
    return TriedBench(told, kept, FoundBench((), is_kept, "", 2), {}, left, {"bench": seconds})


def test_of_two_searches_the_better_counts_and_the_time_of_both():
    for first, second, better in ((0.1, 0.05, 0.05), (0.05, 0.1, 0.05)):
        result = tried(first, 3.0).or_better(tried(second, 2.0)).recorded()
        assert result.residual == better and result.timings_s == {"network": 1.0, "bench": 5.0}
    assert tried(0.1, 3.0).or_better(tried(0.05, 2.0, is_kept=False)).kept.residual == 0.1
    assert tried(0.05, 3.0).or_better(tried(0.1, 2.0, "interrupted")).kept.stop_reason == "interrupted"
