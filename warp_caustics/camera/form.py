"""What of a camera is no number: sizes, and which steps are taken; and whether it is a camera at all."""

import math
from collections.abc import Collection
from dataclasses import dataclass

import torch

from warp_caustics.camera.config import LARGEST_MAGNIFICATION, LEAST_MAGNIFICATION, CameraConfig
from warp_caustics.camera.parameters import CameraParameters
from warp_caustics.camera.placement import Frame, seen_of_window, to_photo
from warp_caustics.camera.psf import psf_reach
from warp_caustics.camera.radiometry import uneven_light
from warp_caustics.errors import InputError, known_names
from warp_caustics.resampling import BLUR_REACH

MOVING = ("shift_px", "magnification", "colour_shift_px", "colour_scale")
"""Parameters that an upright camera is placed by."""
TURNING = ("turn_rad", "homography")
BLURRING = ("psf_px", "box_px")


@dataclass(frozen=True)
class CameraForm:
    """What of a camera is no number to differentiate by.

    Attributes:
        pixels: m of the window.
        frame: size of the photo.
        is_dark: no light beyond the window; else its picture is mirrored there.
        places: pixels are not those of the window: the picture is resampled.
        turns: the camera is turned or looks from the side; upright ones cost less.
        blurs: there is a PSF.
        reach: where the PSF is cut [px].
        mosaic: pattern of the sensor's filters, or None.
    """

    pixels: int
    frame: Frame
    is_dark: bool
    places: bool
    turns: bool
    blurs: bool
    reach: int
    mosaic: str | None


def camera_form(config: CameraConfig, parameters: CameraParameters, pixels: int, free: Collection[str]) -> CameraForm:
    """The form of a camera.

    Args:
        config: the camera.
        parameters: its numbers, float64 on the CPU.
        pixels: m.
        free: fields of the parameters that may change.

    Raises:
        InputError: a camera that does not see the window, or not as a camera can.
    """
    unknown = set(free) - set(CameraParameters._fields)
    if unknown:
        name = min(unknown)
        raise InputError(f"{name!r} is no parameter of a camera; {known_names(name, CameraParameters._fields)}")
    frame = Frame(pixels, pixels) if config.frame_px is None else Frame(*config.frame_px)
    psf, box = float(parameters.psf_px.max()), float(parameters.box_px.max())
    _check_psf(psf, box, frame)
    if config.mosaic is not None and len(parameters.gain) != 3:
        raise InputError(
            f"mosaic {config.mosaic} needs 3 camera channels, red, green, blue, got {len(parameters.gain)}; "
            "leave mosaic out, or give mixing three rows"
        )
    _check_light(parameters, frame)
    turns = bool(parameters.turn_rad != 0) or not torch.equal(
        parameters.homography, torch.eye(3, dtype=parameters.homography.dtype)
    )
    _check_view(parameters, frame, pixels)
    moves = any(bool(values.any()) for values in (parameters.shift_px, parameters.colour_shift_px)) or any(
        bool(values.any()) for values in (parameters.colour_scale, parameters.magnification - 1)
    )
    return CameraForm(
        pixels=pixels,
        frame=frame,
        is_dark=config.frame_px is not None,
        places=turns or moves or frame != (pixels, pixels) or _names(free, MOVING + TURNING),
        turns=turns or _names(free, TURNING),
        blurs=psf > 0 or box > 0 or _names(free, BLURRING),
        reach=psf_reach(psf, box),
        mosaic=config.mosaic,
    )


def _names(free: Collection[str], fields: tuple[str, ...]) -> bool:
    return any(name in free for name in fields)


def _check_psf(psf_px: float, box_px: float, frame: Frame) -> None:
    side = min(frame)
    for name, value, most in (("psf_px", psf_px, side / (2 * BLUR_REACH)), ("box_px", box_px, side / 2)):
        if value > most:
            raise InputError(
                f"{name} {value:g} px is too wide for a photo of {frame.width} x {frame.height} px; "
                f"give at most {math.floor(10 * most) / 10:g}, or a larger frame_px"
            )


def _check_light(parameters: CameraParameters, frame: Frame) -> None:
    """Refuse light that is so uneven that somewhere it is none."""
    # Polynomials of second order do not hide between so many points.
    darkest = float(uneven_light(parameters.light, min(frame.height, 256), min(frame.width, 256)).min())
    if darkest <= 0:
        raise InputError(
            f"light is so uneven that it falls to {darkest:.2g} of even light (it must stay above 0); "
            "lower its coefficients, 0.05 is a poor lamp"
        )


def _check_view(parameters: CameraParameters, frame: Frame, pixels: int) -> None:
    """Refuse cameras that do not see the window, see it from behind the horizon or too coarsely."""
    maps = to_photo(parameters, frame, pixels)
    half = torch.tensor([-0.5, pixels - 0.5], dtype=torch.float64)
    corners = torch.stack([torch.stack((x, y, torch.ones_like(x))) for y in half for x in half])
    mapped = torch.einsum("nij,kj->nki", maps, corners)
    depth = mapped[..., 2]
    if not (torch.isfinite(mapped).all() and (depth > 1e-6).all()):
        raise InputError(
            "homography puts a corner of the window at the horizon; lower its last row's first two numbers"
        )
    x, y = mapped[..., 0] / depth, mapped[..., 1] / depth
    misses = (x.max() < 0) | (y.max() < 0) | (x.min() > frame.width - 1) | (y.min() > frame.height - 1)
    if bool(misses):
        raise InputError(
            f"the camera sees nothing of the window: it lies at x {float(x.min()):.0f} to {float(x.max()):.0f}, "
            f"y {float(y.min()):.0f} to {float(y.max()):.0f}, the photo has {frame.width} x {frame.height} px; "
            "lower shift_px, or raise frame_px"
        )
    ends = [torch.linspace(0, size - 1, min(size, 33), dtype=torch.float64) for size in frame]
    seen = seen_of_window(torch.linalg.inv(maps), ends[1], ends[0])
    inside = (seen.x.abs() < 2 * pixels) & (seen.y.abs() < 2 * pixels)
    sizes = torch.cat((seen.width[inside], seen.height[inside]))
    if sizes.numel() and float(sizes.max()) > 1.0001 / LEAST_MAGNIFICATION:
        raise InputError(
            f"a camera pixel is {float(sizes.max()):.3g} px of the window wide (limit {1 / LEAST_MAGNIFICATION:g}); "
            "magnify, give frame_px and corners_px further apart, or lower scene.image_pixels"
        )
    if sizes.numel() and float(sizes.min()) < 0.9999 / (2 * LARGEST_MAGNIFICATION):
        raise InputError(
            f"the window is magnified {1 / float(sizes.min()):.3g} times (limit {2 * LARGEST_MAGNIFICATION:g}); "
            "raise scene.image_pixels, or magnify less"
        )
