"""Pictures of what was done to the frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cli.figures import rgb_channels, white_level
from cli.report.frame import Frame
from cli.report.number import number
from cli.report.pictures import STAGE_PIXELS, light_picture

if TYPE_CHECKING:
    from warp_caustics.capture.stage import CaptureStage
    from warp_caustics.types import FloatArray

_WIDTH = 300.0

MAX_DOTS = 200
"""Marks that are drawn: more would cover the picture and make the page slow."""


@dataclass(frozen=True, eq=False)
class ShownStage:
    """A step as the page shows it.

    Attributes:
        name: a word or two.
        text: one line.
        pictures: caption and picture.
        figures: name and number.
    """

    name: str
    text: str
    pictures: Sequence[tuple[str, Frame]]
    figures: Sequence[tuple[str, str]]


def shown_stages(stages: "Sequence[CaptureStage]", wavelengths_m: tuple[float, ...]) -> list[ShownStage]:
    """Every step with its pictures; an image that several steps share is encoded once."""
    made: dict[int, Frame] = {}
    shown = []
    for stage in stages:
        pictures = []
        for caption, image in (("before", stage.before), ("after", stage.after)):
            if image is None or image.ndim != 3 or not image.size:
                continue
            if id(image) not in made:
                made[id(image)] = _frame(image, wavelengths_m)
            shown_caption = caption
            frame = replace(made[id(image)], alt=f"The image {caption} the step {stage.name}")
            if caption == "before" and stage.marks_px is not None:
                frame = replace(frame, dots=_dots(stage, frame))
                if len(stage.marks_px) > MAX_DOTS:
                    shown_caption = f"before, with {MAX_DOTS} of {len(stage.marks_px)} marks"
            pictures.append((shown_caption, frame))
        figures = [(name.replace("_", " "), number(float(value), 4)) for name, value in stage.figures.items()]
        shown.append(ShownStage(stage.name, stage.text, pictures, figures))
    return shown


def _frame(image: "FloatArray", wavelengths_m: tuple[float, ...]) -> Frame:
    channels = rgb_channels(wavelengths_m, len(image))
    height = _WIDTH * image.shape[1] / image.shape[2]
    uri = light_picture(image, channels, white_level(image[channels]), STAGE_PIXELS)
    return Frame(uri, "", (_WIDTH, height), (0.0, 0.0, _WIDTH, height), smooth=True)


def _dots(stage: "CaptureStage", frame: Frame) -> list[tuple[float, float]]:
    assert stage.before is not None and stage.marks_px is not None
    _, rows, columns = stage.before.shape
    return [
        (_WIDTH * (float(x) + 0.5) / columns, frame.size[1] * (float(y) + 0.5) / rows)
        for x, y in stage.marks_px[:MAX_DOTS]
    ]
