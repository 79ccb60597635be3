"""Printed batches against the float64 reference, one relief at a time."""

import math

import numpy as np
import pytest
import torch

from data_gen.config import PictureConfig, ReliefConfig, RingsConfig
from data_gen.dataset_config import sample_generator
from data_gen.patterns import RING, draw_strokes, padded
from data_gen.reliefs import print_strokes
from warp_caustics import Scene
from warp_caustics.errors import InputError
from warp_caustics.prints.line import Line, line_relief

SCENE = Scene(height_samples=64, image_pixels=128)


@pytest.mark.parametrize("profile", ["cosine", "quarter"])
def test_same_as_the_reference(profile):
    """Within 0.02 um on reliefs of millimetres; the quarter profile has a kink at its edge."""
    config = ReliefConfig(profile=profile)
    drawn = [draw_strokes(config, sample_generator("0" * 64, "relief", k)) for k in range(6)]
    heights = print_strokes(torch.from_numpy(padded(drawn)), SCENE, config).numpy()
    for strokes, relief in zip(drawn, heights, strict=True):
        lines = [Line((s[1], s[2]), (s[3], s[4]), s[5], s[6]) for s in strokes.tolist()]
        expected = line_relief(lines, 64, SCENE.plate_size_m, section=profile)
        np.testing.assert_allclose(relief, expected, rtol=0, atol=2e-8 if profile == "cosine" else 2e-7)


def test_volume_of_a_ring():
    """Cross-section w H / 2 times the circumference of the centre line (Pappus), H above 0 on the centre line."""
    stroke = np.array([[RING, 0.001, -0.002, 0.015, 0.0, 3e-3, 1e-3]])
    heights = print_strokes(torch.from_numpy(padded([stroke])), SCENE, RingsConfig())[0].double()
    volume = float(heights.sum()) * math.prod(SCENE.sample_pitch_m)
    assert volume == pytest.approx(3e-3 * 1e-3 / 2 * 2 * math.pi * 0.015, rel=1e-3)


def test_rectangular_plates_and_orientation():
    scene = SCENE.model_copy(update={"plate_size_m": (0.05, 0.025)})
    stroke = np.array([[0.0, 0.02, -0.01, 0.02, -0.01, 4e-3, 1e-3]])
    relief = print_strokes(torch.from_numpy(padded([stroke])), scene, ReliefConfig())[0]
    row, column = np.unravel_index(int(relief.argmax()), relief.shape)
    assert abs((column + 0.5) / 64 * 0.05 - 0.025 - 0.02) < 1e-3
    assert abs((row + 0.5) / 64 * 0.025 - 0.0125 + 0.01) < 1e-3


def test_a_drop_is_a_line_without_length():
    stroke = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 8e-3, 1e-3]])
    relief = print_strokes(torch.from_numpy(padded([stroke])), SCENE, ReliefConfig())[0].double().numpy()
    expected = line_relief([Line((0.0, 0.0), (0.0, 0.0), 8e-3, 1e-3)], 64, SCENE.plate_size_m)
    np.testing.assert_allclose(relief, expected, rtol=0, atol=1e-9)


def test_a_picture_can_be_read_off_the_plate():
    """F: not symmetric in any way."""
    rows = ("####", "#...", "###.", "#...", "#...")
    config = PictureConfig(rows=rows, size_m=(0.04, 0.04), centre_m=(0.0, 0.0), line_width_m=(4e-3, 4e-3))
    strokes = draw_strokes(config, sample_generator("0" * 64, "relief", 0))
    relief = print_strokes(torch.from_numpy(padded([strokes])), SCENE, config)[0].numpy()
    cell = 0.04 / 5
    for r, text in enumerate(rows):
        for c, character in enumerate(text):
            x, y = (c - 1.5) * cell, (2 - r) * cell
            here = relief[round((y / 0.05 + 0.5) * 64 - 0.5), round((x / 0.05 + 0.5) * 64 - 0.5)]
            assert (here > 5e-5) == (character == "#")


def test_wrong_strokes_are_refused():
    for bad in (torch.zeros(2, 3, 6), torch.zeros(3, 7), torch.zeros(1, 1, 7, dtype=torch.float64)):
        with pytest.raises(InputError, match="strokes"):
            print_strokes(bad, SCENE, ReliefConfig())
