"""What methods are told of a bench that is exactly as told."""

import pytest

from nets.evaluation.bench.runs import on_exact_bench
from nets.evaluation.method_spec import parse_methods


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("direct", [{"bench_uncertainty": False}]),
        ("fibres:set_up=known", [{"set_up": "known", "bench_uncertainty": False}]),
        ("direct:bench_uncertainty=true", [{"bench_uncertainty": True}]),
        ("transport+refine", [{}, {}]),
    ],
)
def test_methods_that_count_the_bench_are_told_that_it_is_exact(text, options):
    """Under the same name, so that tables compare; a setting of the user's wins, and others know none."""
    (spec,) = parse_methods([text])
    told = on_exact_bench(spec)
    assert told.label == spec.label
    assert [dict(stage.options) for stage in told.stages] == options
