"""On which machine, and for what, a bench is looked for without lines before they are searched for."""

from types import SimpleNamespace

import pytest

from nets.reconstruct.bench_search import Glance
from nets.reconstruct.fibres.method import Fibres


@pytest.mark.parametrize(
    ("is_gpu", "glance", "is_far", "expected"),
    [
        (True, Glance(True, False), False, False),
        (False, Glance(True, False), False, True),
        (True, Glance(True, True), False, True),
        (True, Glance(False, False), True, True),
        (False, Glance(False, False), True, True),
        (False, Glance(False, False), False, False),
    ],
)
def test_where_a_bench_is_looked_for_without_lines_first(is_gpu, glance, is_far, expected):
    """A GPU finds most with lines, but not the size of a picture, which lines that lie further out explain nearly."""
    method = SimpleNamespace(finds_other_with_lines=is_gpu)
    search = SimpleNamespace(glance=lambda *of: glance, is_far=lambda *of: is_far)
    assert Fibres._looks_other(method, search, None, SimpleNamespace(heights_m=None)) == expected
