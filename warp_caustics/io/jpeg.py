"""JPEG in, for photos of which nothing better exists: 8 bits, lossy, and toned by the camera.

Only with ``transfer="srgb"``: the standard tells what the numbers mean, cameras
follow it more or less.
"""

from pathlib import Path

import numpy as np

from warp_caustics.errors import CausticsError, DamagedDataError, InputError
from warp_caustics.io.atomic import reason
from warp_caustics.io.decoded import Decoded
from warp_caustics.io.image_file import FitsCheck, check_image

_ORIENTATION = 0x0112
_TURNS = {
    2: "mirrored",
    3: "turned by 180 deg",
    4: "mirrored upside down",
    5: "mirrored and turned by 90 deg",
    6: "turned by 90 deg clockwise",
    7: "mirrored and turned by 270 deg",
    8: "turned by 90 deg counterclockwise",
}


def read_jpeg(path: Path, max_pixels: int, fits: FitsCheck | None = None) -> Decoded:
    """A JPEG, uint8 [C, H, W], upright as its EXIF orientation asks.

    Raises:
        InputError: other than gray or RGB, or too large.
        DamagedDataError: truncated or corrupt.
    """
    from PIL import Image, ImageOps

    name = repr(str(path))
    try:
        with Image.open(path, formats=("JPEG", "MPO")) as picture:
            if picture.mode not in ("L", "RGB"):
                raise InputError(f"{name} is a JPEG of kind {picture.mode}; export gray or RGB")
            turn = picture.getexif().get(_ORIENTATION, 1)
            sides = (picture.height, picture.width)
            # From 5 on the picture lies on its side.
            rows, columns = sides[::-1] if turn in (5, 6, 7, 8) else sides
            check_image(name, (len(picture.getbands()), rows, columns), max_pixels, fits)
            notes = [f"{name} is a JPEG: lossy, 8 bits and toned by the camera; export a 16-bit linear TIFF if you can"]
            frames = int(getattr(picture, "n_frames", 1))
            if frames > 1:
                notes.append(f"{name} holds {frames} pictures (MPO); the first was read")
            if "icc_profile" in picture.info:
                notes.append(f"{name} carries a colour profile, which is not applied; sRGB was assumed")
            upright = ImageOps.exif_transpose(picture)
            if turn in _TURNS:
                notes.append(
                    f"{name} was {_TURNS[turn]}, as its EXIF orientation {turn} asks; frames must agree in that"
                )
            array = np.array(upright)
    except CausticsError:
        raise
    except Image.DecompressionBombError as error:
        raise InputError(f"{name} claims more pixels than are read ({max_pixels:.3g}); crop it") from error
    except Exception as error:
        raise DamagedDataError(f"{name}: JPEG cannot be decoded ({reason(error)}); copy or export it again") from error
    return Decoded(array[None] if array.ndim == 2 else np.moveaxis(array, -1, 0), notes=notes)
