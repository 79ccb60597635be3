"""Lens distortion after Brown and Conrady, in OpenCV's convention.

An ideal pixel (u, v) is normalised, x = (u - c_x) / f_x, y = (v - c_y) / f_y,
and with r^2 = x^2 + y^2 the lens shows it at

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
    y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

(D. C. Brown, Photogrammetric Engineering 32, 444 (1966)). Pixel coordinates
start at the centre of the first pixel.
"""

import os
from typing import Annotated

import numpy as np
import numpy.typing as npt
import pydantic
from pydantic import Field

from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.atomic import regular_file
from warp_caustics.io.yaml_file import read_yaml
from warp_caustics.scene import validation_lines
from warp_caustics.strict import Finite, Strict

Points = npt.NDArray[np.float64]
Focal = Annotated[float, Field(gt=0, allow_inf_nan=False)]

EXAMPLE = "{f_px: [3000, 3000], c_px: [1999.5, 1499.5], k1: -0.08}"
MAX_ITERATIONS = 50
TOLERANCE_PX = 1e-6


class Distortion(Strict):
    """A lens: five coefficients, and the camera matrix that they were fitted with."""

    f_px: tuple[Focal, Focal]
    """Focal length along x and y [px]."""
    c_px: tuple[Finite, Finite]
    """Principal point (x, y) [px]."""
    k1: Finite = 0.0
    k2: Finite = 0.0
    p1: Finite = 0.0
    p2: Finite = 0.0
    k3: Finite = 0.0
    image_px: tuple[int, int] | None = None
    """Width and height of the photos it was fitted with [px]; others are refused."""

    def distort(self, ideal_px: npt.ArrayLike) -> Points:
        """Where the lens shows ideal pixels (x, y), shape [..., 2]."""
        focal, centre = np.array(self.f_px), np.array(self.c_px)
        normal = (np.asarray(ideal_px, np.float64) - centre) / focal
        x, y = normal[..., 0], normal[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        shown_x = x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        shown_y = y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        return np.asarray(np.stack([shown_x, shown_y], axis=-1) * focal + centre, np.float64)

    def undistort(self, shown_px: npt.ArrayLike) -> Points:
        """The ideal pixels of pixels (x, y) in the photo, shape [..., 2], by fixed-point iteration.

        Raises:
            InputError: the coefficients fold the picture, so that there is none.
        """
        shown = np.asarray(shown_px, np.float64)
        ideal = np.array(shown)
        for _ in range(MAX_ITERATIONS):
            with np.errstate(over="ignore", invalid="ignore"):
                step = shown - self.distort(ideal)
            ideal = ideal + step
            size = float(np.abs(step).max(initial=0.0))
            if size < TOLERANCE_PX:
                return ideal
            if not size < 1e9:
                break
        raise InputError("the distortion folds the picture within the photo; check its coefficients and f_px")

    def check_image(self, height: int, width: int) -> None:
        """Refuse photos of another size.

        Raises:
            MismatchError: not the size of the photos it was fitted with.
        """
        if self.image_px is not None and self.image_px != (width, height):
            fitted = f"{self.image_px[0]} x {self.image_px[1]}"
            raise MismatchError(
                f"the distortion was fitted with photos of {fitted} pixels, this one has {width} x {height}; "
                "fit it again, or give uncropped photos"
            )


def read_distortion(path: str | os.PathLike[str]) -> Distortion:
    """A lens from a YAML file with the names of :class:`Distortion`.

    Raises:
        InputError: no readable YAML, an unknown key or a value out of range.
    """
    file = regular_file(path)
    try:
        return Distortion.model_validate(read_yaml(file, EXAMPLE))
    except pydantic.ValidationError as error:
        raise InputError(
            "; ".join(validation_lines(error, str(file))[:3]) + f"; write for example {EXAMPLE}"
        ) from error
