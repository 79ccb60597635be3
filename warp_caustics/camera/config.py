"""A camera as a record: lens, geometry, colours, sensor. The default is a perfect one.

Channels are those of the scene's wavelengths, in its order, up to the mixing;
behind it they are the camera's. Lengths are camera pixels, angles radians,
light is relative to that behind a flat plate.
"""

import os
from typing import Annotated, Literal

import pydantic
from pydantic import AfterValidator, Field, model_validator

from warp_caustics.errors import InputError
from warp_caustics.io.atomic import regular_file
from warp_caustics.io.yaml_file import read_yaml
from warp_caustics.scene import validation_lines
from warp_caustics.strict import Finite, Positive, Strict

EXAMPLE = "psf_px: 0.5"
LARGEST_FRAME_PX = 8192
LEAST_MAGNIFICATION, LARGEST_MAGNIFICATION = 0.5, 8.0
"""Camera pixels per pixel of the window. Below, a camera pixel would reach over more than two of the window's."""
LARGEST_COLOUR_SCALE = 0.05


def _rising(value: tuple[float, float]) -> tuple[float, float]:
    low, high = value
    if low > high:
        raise ValueError(f"{low:g} to {high:g} runs backwards; the smaller comes first, write [{high:g}, {low:g}]")
    return value


Share = Annotated[Finite, Field(ge=0, le=1)]
Pair = tuple[Finite, Finite]
Width = Annotated[Finite, Field(ge=0, le=LARGEST_FRAME_PX)]
Level = Annotated[Finite, Field(ge=0, le=100)]
Gain = Annotated[Finite, Field(gt=0, le=1e6)]
ColourScale = Annotated[Finite, Field(ge=-LARGEST_COLOUR_SCALE, le=LARGEST_COLOUR_SCALE)]
Side = Annotated[int, Field(ge=2, le=LARGEST_FRAME_PX)]
Row = tuple[Finite, Finite, Finite]
Radii = Annotated[tuple[Positive, Positive], AfterValidator(_rising)]
Shares = Annotated[tuple[Share, Share], AfterValidator(_rising)]
Unevenness = Annotated[Finite, Field(ge=-1, le=1)]
Coefficients = tuple[Unevenness, Unevenness, Unevenness, Unevenness, Unevenness]
Bayer = Literal["rggb", "bggr", "grbg", "gbrg"]


class SensorConfig(Strict):
    """What the sensor adds that is drawn anew or differs between pixels; 0 or None leaves an effect out."""

    exposure: Annotated[Finite, Field(gt=0, le=1)] = 0.05
    """Part of full scale that a flat plate's light fills, in the wavelength with most of it."""
    full_well_electrons: Annotated[Finite, Field(ge=1, le=1e9)] | None = None
    """Electrons at full scale, which shot and read noise follow from; None: light is no quanta."""
    read_noise_electrons: Annotated[Finite, Field(ge=0, le=1e6)] = 0.0
    """Standard deviation of what reading adds to each pixel of each exposure."""
    black_level: Annotated[Finite, Field(ge=0, lt=1)] = 0.0
    """What a pixel without light shows, as part of full scale."""
    bits: Annotated[int, Field(ge=1, le=16)] | None = 16
    """Of the converter; files have 16 bits, with the same full scale. None: no quantisation before the file's."""
    photo_frames: Annotated[int, Field(ge=1, le=4096)] = 1
    """Exposures of the plate whose mean is the photo."""
    calibration_frames: Annotated[int, Field(ge=1, le=4096)] = 16
    """Exposures whose mean is the dark frame; the same for the flat frame."""
    speckle_contrast: Share = 0.0
    """Standard deviation over mean of speckle, the same in all exposures of a photo, another in the flat frame."""
    speckle_width_px: Annotated[Finite, Field(gt=0, le=64)] = 1.0
    """w [px]: speckle d pixels apart correlates by exp(-d^2 / (4 w^2))."""
    dust_grains: Annotated[int, Field(ge=0, le=100_000)] = 0
    """Grains that darken photo and flat frame alike."""
    fresh_dust_grains: Annotated[int, Field(ge=0, le=100_000)] = 0
    """Grains that fell after the flat frame was taken."""
    dust_radius_px: Radii = (1.0, 4.0)
    """Range of their radii [px]."""
    dust_depth: Shares = (0.1, 0.6)
    """Range of the light that they take."""
    hot_pixels: Annotated[int, Field(ge=0, le=10_000_000)] = 0
    """Pixels that shine in the dark, too."""
    hot_level: Shares = (0.02, 0.5)
    """Range of their level, as part of full scale."""

    @model_validator(mode="after")
    def _consistent(self) -> "SensorConfig":
        if self.read_noise_electrons > 0 and self.full_well_electrons is None:
            raise ValueError(
                f"read_noise_electrons {self.read_noise_electrons:g} means nothing without a full well; "
                "give full_well_electrons, for example 30000"
            )
        if self.black_level + self.exposure > 1:
            raise ValueError(
                f"black_level {self.black_level:g} and exposure {self.exposure:g} add up to more than full scale (1): "
                f"a flat plate saturates; expose at most {1 - self.black_level:g}, a tenth of it suits a caustic"
            )
        return self


class CameraConfig(Strict):
    """A camera; one value for a channel's effect stands for all channels. 0 or None leaves an effect out."""

    psf_px: Width | tuple[Width, ...] = 0.0
    """Standard deviation of the lens's PSF, a Gaussian [px], of each wavelength."""
    box_px: Width | tuple[Width, ...] = 0.0
    """Width of a square that the light is averaged over beyond the pixel's own [px], such as an anti-alias filter's."""
    frame_px: tuple[Side, Side] | None = None
    """Width and height of the photo [px], dark beyond the window; None: the photo is the window."""
    shift_px: Pair = (0.0, 0.0)
    """How far the window's picture lies towards larger x and y from the middle of the photo [px]."""
    turn_rad: Annotated[Finite, Field(ge=-3.2, le=3.2)] = 0.0
    """How far it is turned from x towards y [rad]."""
    magnification: Annotated[Finite, Field(ge=LEAST_MAGNIFICATION, le=LARGEST_MAGNIFICATION)] = 1.0
    """Camera pixels per pixel of the window."""
    homography: tuple[Row, Row, Row] | None = None
    """Applied before these, on positions from -1 to 1 over the window; the last row is the perspective."""
    corners_px: tuple[Pair, Pair, Pair, Pair] | None = None
    """Instead: where the window's corners -x-y, +x-y, +x+y, -x+y lie, (x, y) from the centre of the first pixel."""
    colour_shift_px: tuple[Pair, ...] | None = None
    """Shift of each wavelength's picture [px]."""
    colour_scale: ColourScale | tuple[ColourScale, ...] = 0.0
    """Magnification of each wavelength's picture about the middle of the photo, less 1."""
    light: Coefficients | tuple[Coefficients, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Unevenness: coefficients of x, y, x^2 - mean, x y, y^2 - mean, each from -1 to 1 over the photo."""
    ambient: Level | tuple[Level, ...] = 0.0
    """Light of the lamp that goes other ways, relative to that of a flat plate, of each wavelength."""
    ambient_in_dark: bool = False
    """It is the room's and not the lamp's, and stays in the dark frame."""
    mixing: tuple[tuple[Level, ...], ...] | None = None
    """Part of each wavelength's light (columns) in each camera channel (rows); None: a channel for a wavelength."""
    gain: Gain | tuple[Gain, ...] = 1.0
    """Of each camera channel."""
    mosaic: Bayer | None = None
    """Colour filters of the sensor, from its first pixel; needs three camera channels, red, green, blue."""
    sensor: SensorConfig = SensorConfig()

    @model_validator(mode="after")
    def _consistent(self) -> "CameraConfig":
        if self.corners_px is not None:
            placed = self.turn_rad != 0 or self.magnification != 1 or any(self.shift_px) or self.homography is not None
            if placed:
                raise ValueError(
                    "corners_px says all of where the window lies; leave out shift_px, turn_rad, magnification and "
                    "homography"
                )
            if self.frame_px is None:
                raise ValueError("corners_px needs the size of the photo; give frame_px: [width, height]")
        widths = {len(row) for row in self.mixing or ()}
        if self.mixing is not None and (len(widths) != 1 or 0 in widths):
            raise ValueError(f"mixing has rows of {sorted(widths)} numbers; give one row per camera channel, all alike")
        if self.mixing is not None and not all(map(any, self.mixing)):
            raise ValueError("mixing has a row of zeros: that channel sees no light; leave it out or give its parts")
        return self


def read_camera(path: str | os.PathLike[str]) -> CameraConfig:
    """A camera from a YAML file with the names of :class:`CameraConfig`.

    Raises:
        InputError: no readable YAML, an unknown key or a value out of range.
    """
    file = regular_file(path)
    try:
        return CameraConfig.model_validate(read_yaml(file, EXAMPLE))
    except pydantic.ValidationError as error:
        raise InputError("; ".join(validation_lines(error, str(file))[:3])) from error
