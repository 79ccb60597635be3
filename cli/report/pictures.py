"""Pictures as data URIs."""

import base64
import io
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from PIL import Image

from cli.figures import DISPLAY_GAMMA
from cli.report.arrays import reduced
from cli.report.colours import MISSING_RGB, palette

if TYPE_CHECKING:
    from warp_caustics.types import FloatArray

CAUSTIC_PIXELS = 768
STAGE_PIXELS = 256
JPEG_QUALITY = 85


def light_picture(image: "FloatArray", channels: list[int], white: float, limit: int) -> str:
    """Light as a JPEG, row 0 on top.

    Args:
        image: shape [channels, rows, columns].
        channels: the ones shown as red, green and blue.
        white: value shown as white.
        limit: of the longer side [px]; larger images are block means.
    """
    shown = np.nan_to_num(reduced(image[channels], limit) / white)
    codes = np.round(255 * np.clip(shown, 0.0, 1.0) ** (1 / DISPLAY_GAMMA)).astype(np.uint8)
    same = all((codes[0] == channel).all() for channel in codes[1:])
    picture = Image.fromarray(codes[0] if same else np.moveaxis(codes, 0, -1))
    return _uri(picture, "jpeg", quality=JPEG_QUALITY, subsampling=0)


def map_picture(values: "FloatArray", low: float, high: float, colours: str, limit: int) -> str:
    """A map as a PNG of 255 colours and one for what is missing, row 0 on top.

    Args:
        values: shape [rows, columns].
        low: value of the first colour.
        high: value of the last one.
        colours: name of the colour map.
        limit: of the longer side [px].
    """
    part = (reduced(values, limit) - low) / (high - low)
    codes = np.round(254 * np.clip(np.nan_to_num(part), 0.0, 1.0)).astype(np.uint8)
    codes[np.isnan(part)] = 255
    picture = Image.fromarray(codes)
    picture.putpalette(np.vstack([palette(colours, 255), MISSING_RGB]).astype(np.uint8).tobytes())
    return _uri(picture, "png", optimize=True)


def rgb_picture(shown: npt.NDArray[np.floating]) -> str:
    """Display values between 0 and 1, shape [rows, columns, 3], as a JPEG, row 0 on top."""
    codes = np.round(255 * np.clip(shown, 0.0, 1.0)).astype(np.uint8)
    return _uri(Image.fromarray(codes), "jpeg", quality=JPEG_QUALITY)


def _uri(picture: Image.Image, kind: str, **options: object) -> str:
    buffer = io.BytesIO()
    picture.save(buffer, format=kind, **options)
    return f"data:image/{kind};base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
