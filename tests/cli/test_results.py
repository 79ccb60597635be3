"""Lines of a summary that say what is in the model of the camera."""

import pytest

from cli.results import made_words, rest_lines

CAMERA = {"shift_px": [[0.2, 0.0], [0.0, 0.0]], "blur_px": [0.0, 0.7]}


@pytest.mark.parametrize(
    ("counters", "line"),
    [
        ({"camera": CAMERA}, "camera     channels 0.2 px apart, blur of 0.7 px: in the model"),
        (
            {"camera": {"shift_px": [], "blur_px": [0.52], "spread": {}}},
            "camera     blur of 0.52 px by its point spread: in the model",
        ),
        ({"mosaic": "rggb"}, "camera     colour filters rggb, pixels made up between them: in the model"),
        (
            {"camera": CAMERA, "mosaic": "grbg"},
            "camera     channels 0.2 px apart, blur of 0.7 px, colour filters grbg, pixels made up between them: in the model",
        ),
    ],
)
def test_what_is_in_the_model_of_the_camera_is_said(counters, line):
    assert rest_lines({"counters": counters}) == [line]


def test_nothing_is_said_of_a_perfect_camera():
    assert rest_lines({"counters": {"camera": {"shift_px": [[0.0, 0.0]], "blur_px": [0.0]}}}) == []
    assert rest_lines({}) == []


@pytest.mark.parametrize(
    ("counters", "words"),
    [
        ({}, ""),
        ({"section": {"exponent": 0.5, "thicker": 0.0, "is_cap": False}}, ""),
        ({"section": {"cut": 0.0603}}, ", cut off at 6 % of their crown"),
        ({"section": {"thicker": 0.2989, "is_cap": True}}, ", circular caps, 30 % thicker at their ends"),
        (
            {"waves": {"thickness": 0.0197, "aside_m": 2.49e-5}},
            ", 2 % thicker and thinner and 25 um aside along their way (root mean squares)",
        ),
    ],
)
def test_how_lines_are_made_is_told(counters, words):
    assert made_words({"counters": counters}) == words
    assert made_words({}) == ""
