"""Strokes of lines with corners and curves, of drops and of text: what their configurations say."""

import numpy as np
import pytest

from data_gen.config import CurvesConfig, DropsConfig, MeandersConfig, PolylinesConfig, TextConfig
from data_gen.dataset_config import sample_generator
from data_gen.patterns import draw_strokes
from warp_caustics.prints.chains import chains_of_rows
from warp_caustics.prints.rows import BEGIN, JOINED, SEGMENT

SHAPES = [PolylinesConfig(), CurvesConfig(), MeandersConfig(), DropsConfig(), TextConfig()]


def drawn(config, sample=0):
    return draw_strokes(config, sample_generator("f" * 64, "relief", sample))


@pytest.mark.parametrize("config", SHAPES, ids=lambda config: config.pattern)
def test_numbers_and_sizes_are_within_their_ranges(config):
    counts = set()
    for sample in range(60):
        chains = chains_of_rows(drawn(config, sample))
        if hasattr(config, "line_count"):
            counts.add(len(chains.first))
        for values, interval in ((chains.widths_m, config.line_width_m), (chains.heights_m, config.line_height_m)):
            assert interval[0] <= values.min() and values.max() <= interval[1]
    if counts:
        assert (min(counts), max(counts)) == config.line_count


@pytest.mark.parametrize("config", SHAPES, ids=lambda config: config.pattern)
def test_a_relief_depends_on_its_number_alone(config):
    first = drawn(config, 7)
    np.testing.assert_array_equal(first, drawn(config, 7))
    assert first.tobytes() != drawn(config, 8).tobytes()


def test_polylines_have_pieces_of_their_length_and_corners_of_their_angle():
    config = PolylinesConfig(line_count=(1, 1), pieces=(5, 5), piece_m=(4e-3, 6e-3), turn_rad=(0.3, 0.5))
    points = drawn(config)[:, 3:5]
    steps = np.diff(points, axis=0)
    lengths = np.hypot(*steps.T)
    assert len(lengths) == 5 and (lengths >= 4e-3).all() and (lengths <= 6e-3).all()
    turns = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    assert (turns >= 0.3).all() and (turns <= 0.5).all()


def test_curves_stay_within_their_control_points():
    """The convex hull of a Bezier curve."""
    for sample in range(20):
        points = drawn(CurvesConfig(control_m=(-0.01, 0.01)), sample)[:, 3:5]
        assert np.abs(points).max() <= 0.01 and len(points) > 20


def test_drops_are_single_rows():
    rows = drawn(DropsConfig())
    assert (rows[:, 0] == SEGMENT).all()
    np.testing.assert_array_equal(rows[:, 1:3], rows[:, 3:5])


def test_text_that_is_given_is_written():
    """The same strokes whatever the sample, but for place, size and direction."""
    config = TextConfig(text="N-SfC".upper(), angle_rad=(0.0, 0.0), cap_height_m=(8e-3, 8e-3), centre_m=(0.0, 0.0))
    first, second = drawn(config, 1), drawn(config, 2)
    np.testing.assert_allclose(first[:, :5], second[:, :5], atol=1e-15)
    assert set(first[:, 0]) == {BEGIN, JOINED}
    assert np.ptp(first[:, 4]) == pytest.approx(8e-3, rel=0.05)
    lengths = {len(drawn(TextConfig(characters=(3, 3)), k)) for k in range(10)}
    assert len(lengths) > 5, "always the same characters"
