"""Curves, the stroke font, and what a machine does to lines: closed forms and symmetries."""

import math
from itertools import pairwise

import numpy as np
import pytest

from warp_caustics.errors import InputError
from warp_caustics.prints.chains import chains_of, chains_of_rows, rows_of, subdivided
from warp_caustics.prints.curves import FLATNESS_M, arc_points, bezier_points, meander_points, placed, ring_points
from warp_caustics.prints.font import GLYPHS, text_lines
from warp_caustics.prints.imperfections import thick_ends, wavy

CONTROL = np.array([[-0.02, -0.02], [0.0, 0.04], [0.01, -0.04], [0.02, 0.02]])


def distance_to_chain(points, chain):
    """Of each point from the nearest piece of a chain."""
    a, d = chain[:-1, None], np.diff(chain, axis=0)[:, None]
    t = np.clip(((points - a) * d).sum(-1) / (d * d).sum(-1), 0, 1)
    return np.linalg.norm(points - a - t[..., None] * d, axis=-1).min(axis=0)


def test_a_bezier_curve_is_flat_enough():
    """Against de Casteljau at other places; a straight line needs one piece."""
    chain = bezier_points(CONTROL)
    t = np.linspace(0, 1, 1733)[:, None]
    level = [np.broadcast_to(point, (len(t), 2)) for point in CONTROL]
    while len(level) > 1:
        level = [(1 - t) * a + t * b for a, b in pairwise(level)]
    assert distance_to_chain(level[0], chain).max() <= FLATNESS_M
    np.testing.assert_allclose(chain[[0, -1]], CONTROL[[0, -1]], atol=1e-18)
    assert len(bezier_points(np.array([[0.0, 0.0], [0.01, 0.0]]))) == 2


def test_rings_and_arcs():
    ring = ring_points((0.001, 0.002), 0.015)
    assert (ring[0] == ring[-1]).all()
    np.testing.assert_allclose(np.hypot(*(ring - (0.001, 0.002)).T), 0.015, rtol=1e-12)
    middles = (ring[1:] + ring[:-1]) / 2
    assert 0.015 - np.hypot(*(middles - (0.001, 0.002)).T).min() <= FLATNESS_M * (1 + 1e-9)
    arc = arc_points((0.0, 0.0), 0.01, 0.0, math.pi / 2)
    np.testing.assert_allclose(arc[-1], (0.0, 0.01), atol=1e-15)
    assert len(ring_points((0.0, 0.0), 0.0)) == 1


def test_a_meander_has_the_length_it_says():
    """Rows and half circles; it begins and ends at its corners, and turns never cut the rows."""
    points = meander_points((0.0, 0.0), 0.02, 3e-3, 5)
    length = np.hypot(*np.diff(points, axis=0).T).sum()
    assert length == pytest.approx(5 * 0.02 + 4 * math.pi * 1.5e-3, rel=1e-3)
    np.testing.assert_allclose(points[0], (-0.01, -6e-3), atol=1e-15)
    np.testing.assert_allclose(points[-1], (0.01, 6e-3), atol=1e-15)
    assert np.abs(points[:, 0]).max() == pytest.approx(0.01 + 1.5e-3, rel=1e-2)
    np.testing.assert_allclose(placed(points, (0.001, 0.0), math.pi / 2)[0], (0.007, -0.01), atol=1e-15)


def test_the_font_has_capitals_and_digits():
    for character in "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789":
        strokes = text_lines(character, 6e-3)
        points = np.concatenate(strokes)
        assert np.ptp(points[:, 1]) == pytest.approx(6e-3, rel=0.1), character
        assert np.ptp(points[:, 0]) <= 5.5e-3, character
    drawn = {c: np.concatenate(text_lines(c, 6e-3)).round(6).tobytes() for c in GLYPHS if c.strip()}
    assert len(set(drawn.values())) == len(drawn), "two characters look the same"


@pytest.mark.parametrize("character", "AHIMTUVWXYO")
def test_letters_that_are_symmetric(character):
    """Left and right of the middle: every point's mirror image lies on a stroke."""
    strokes = text_lines(character, 6e-3)
    points = np.concatenate(strokes)
    middle = (points[:, 0].max() + points[:, 0].min()) / 2
    mirrored = points * (-1, 1) + (2 * middle, 0)
    near = np.min([distance_to_chain(mirrored, stroke) for stroke in strokes], axis=0)
    assert near.max() < 2e-5


def test_text_is_centred_turned_and_broken_into_lines():
    points = np.concatenate(text_lines("HH\nHH", 6e-3, (0.001, 0.002)))
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose((low + high) / 2, (0.001, 0.002), atol=1e-12)
    turned = np.concatenate(text_lines("HH\nHH", 6e-3, (0.0, 0.0), math.pi / 2))
    np.testing.assert_allclose(np.ptp(turned, axis=0), (high - low)[::-1], atol=1e-12)


def test_text_that_cannot_be_written():
    with pytest.raises(InputError, match="'a', which the stroke font does not have; use capitals"):
        text_lines("Aa", 6e-3)
    with pytest.raises(InputError, match="'@'.*use .*ABC"):
        text_lines("@", 6e-3)
    with pytest.raises(InputError, match="text of 0 characters"):
        text_lines("  ", 6e-3)
    with pytest.raises(InputError, match="above 0"):
        text_lines("A", 0.0)
    with pytest.raises(InputError, match="Bezier"):
        bezier_points(np.zeros((1, 2)))
    with pytest.raises(InputError, match="meander of 0 rows"):
        meander_points((0.0, 0.0), 0.02, 3e-3, 0)


MANY = chains_of(
    [np.array([[-0.02, 0.0], [0.02, 0.001]]), ring_points((0.0, 0.0), 0.01), np.array([[0.01, 0.01]]), CONTROL],
    [1e-3, 2e-3, 3e-3, 1e-3],
    [1e-4, 2e-4, 3e-4, 4e-4],
)


def test_rows_and_back():
    back = chains_of_rows(rows_of(MANY))
    for name in ("points_m", "widths_m", "heights_m", "first"):
        np.testing.assert_array_equal(getattr(back, name), getattr(MANY, name))
    np.testing.assert_array_equal(MANY.closed, [False, True, False, False])
    assert MANY.lengths_m[1] == pytest.approx(2 * math.pi * 0.01, rel=1e-3) and MANY.lengths_m[2] == 0


def test_points_between_points_change_nothing():
    finer = subdivided(MANY, np.array([1e-3, 2e-4, 1e-3, 5e-3]))
    np.testing.assert_allclose(finer.lengths_m, MANY.lengths_m, rtol=1e-12)
    np.testing.assert_array_equal(finer.closed, MANY.closed)
    assert np.hypot(*np.diff(finer.points_m[:41], axis=0).T).max() <= 1.001e-3
    for k in range(4):
        own = finer.line == k
        assert set(finer.widths_m[own]) == {MANY.widths_m[MANY.first[k]]}
        np.testing.assert_array_equal(finer.points_m[own][[0, -1]], MANY.points_m[[MANY.first[k], MANY.last[k]]])


def test_waves_keep_their_amplitude_and_the_proportions():
    """Width over height stays, the changes reach the share but not over it, and closed lines stay closed."""
    whole, phases = np.ones(4), np.random.default_rng(0).uniform(0, 2 * np.pi, (4, 4))
    waves = wavy(MANY, 0.1 * whole, 1e-4 * whole, 3e-3 * whole, phases)
    factor = waves.widths_m / MANY.widths_m[MANY.first][waves.line]
    np.testing.assert_allclose(
        waves.heights_m / waves.widths_m, (MANY.heights_m / MANY.widths_m)[MANY.first][waves.line]
    )
    assert 0.9 <= factor.min() < 0.93 and 1.07 < factor.max() <= 1.1
    away = distance_to_chain(waves.points_m[waves.line == 0], MANY.points_m[:2])
    assert 0.8e-4 < away.max() <= 1e-4 * (1 + 1e-9)
    np.testing.assert_array_equal(waves.closed, MANY.closed)
    ring = waves.widths_m[waves.line == 1]
    assert ring[0] == pytest.approx(ring[-1], abs=1e-5 * 2e-3)
    still = wavy(MANY, 0 * whole, 0 * whole, 3e-3 * whole, phases)
    np.testing.assert_allclose(still.lengths_m, MANY.lengths_m, rtol=1e-12)


def test_ends_are_thicker_by_what_they_should():
    """1 + share at both ends, 1 + share / e one length away, and nothing in the middle; a drop has no ends."""
    whole = np.ones(4)
    thick = thick_ends(MANY, 0.4 * whole, 1e-3 * whole)
    own = thick.line == 0
    factor, arc = thick.widths_m[own] / 1e-3, thick.arc_m[own]
    assert factor[0] == pytest.approx(1.4) and factor[-1] == pytest.approx(1.4)
    assert factor[np.argmin(np.abs(arc - 1e-3))] == pytest.approx(1 + 0.4 / math.e, rel=1e-6)
    assert np.interp(0.02, arc, factor) == pytest.approx(1.0, abs=1e-3)
    assert thick.widths_m[thick.line == 2] == pytest.approx(3e-3)
    seam = thick.widths_m[thick.line == 1] / 2e-3
    assert seam[0] == seam[-1] == pytest.approx(1.4)
