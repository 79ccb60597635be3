"""Sections that lines have in common, against those of prints."""

import numpy as np
import pytest

from warp_caustics.prints.line import section_height
from warp_caustics.prints.line_shape import Shape, half_height, line_section, section_edge


@pytest.mark.parametrize(
    ("shape", "family", "exponent"),
    [
        (Shape(0.35), "cosine", 0.35),
        (Shape(1.7), "cosine", 1.7),
        (Shape(0.5, 1.0), "parabola", 0.5),
        (Shape(1.0, 1.0), "parabola", 1.0),
    ],
)
def test_the_ends_of_the_family_are_the_sections_of_prints(shape, family, exponent):
    t = np.linspace(0, 1, 101)
    np.testing.assert_allclose(line_section(shape, t), section_height(t, family, exponent), atol=1e-9)


@pytest.mark.parametrize(
    "shape", [Shape(0.35), Shape(2.0), Shape(1.0, 1.0), Shape(6.0, cut=0.06), Shape(0.8, 0.3, cut=0.2)]
)
def test_half_its_height_and_its_edge_are_where_a_section_says(shape):
    assert line_section(shape, np.array(half_height(shape))) == pytest.approx(0.5, abs=1e-10)
    inside, beyond = np.linspace(0, 0.99 * section_edge(shape), 50), np.linspace(section_edge(shape), 1, 50)
    assert (line_section(shape, inside) > 0).all() and line_section(shape, beyond).max() <= 1.01e-6
    assert (np.diff(line_section(shape, inside)) < 0).all() and line_section(shape, np.array(0.0)) == 1


def test_a_cap_is_told_by_its_line():
    cap = Shape(1.0, 1.0, is_cap=True)
    assert half_height(cap) == pytest.approx(np.sqrt(0.5)) and section_edge(cap) == 1
    assert Shape(cut=0.1, overlap=0.3).with_section(cap) == Shape(1.0, 1.0, 0.3, is_cap=True)
