"""Everything that says how a photo becomes irradiance, as one record."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import Field

from warp_caustics.errors import InputError
from warp_caustics.io.atomic import regular_file
from warp_caustics.io.yaml_file import read_yaml
from warp_caustics.scene import validation_lines
from warp_caustics.strict import Positive, Strict

AUTO = "auto"
"""Value of ``corners`` that is no file; a file of that name is ./auto."""
PATHS = ("dark", "flat", "flat_dark", "corners", "distortion", "mixing")
"""Settings that name files."""
CAPTURE_SUFFIXES = (".yaml", ".yml")


class FrameSettings(Strict):
    """One of several frames of the same view."""

    file: str
    exposure_s: Positive
    """Exposure time [s]; only ratios matter."""
    dark: str | None = None
    """Dark frame of the same exposure time; without it the common one."""


class CaptureSettings(Strict):
    """How to read a photo and turn it into irradiance in the scene's window; nothing set: the photo is the window."""

    frames: tuple[FrameSettings, ...] = ()
    """Frames of one view with different exposure times, to be merged."""
    dark: str | None = None
    """Frame of the same camera with the light off."""
    flat: str | None = None
    """Frame of the same camera with a plate without relief."""
    flat_dark: str | None = None
    """Dark frame of the flat field, where its exposure time differs; without it the common one."""
    flat_exposure_s: Positive | None = None
    """Exposure time of the flat field [s], where frames name theirs."""
    exposure: Positive | tuple[Positive, ...] | None = None
    """With a flat field: exposure of the image divided by the flat's; without: value in the file per W/m^2."""
    corners: str | None = None
    """``auto`` to find the lit window, or a file with its corners, known points or marks; see capture/corners.py."""
    mirrored: bool = False
    """The photo shows the screen from behind, so that left and right are exchanged."""
    turned_deg: Literal[0, 90, 180, 270] = 0
    """How far the window's +x is turned from the photo's columns towards its rows; only for ``auto``."""
    distortion: str | None = None
    """File with the lens distortion; see capture/distortion.py."""
    mixing: str | None = None
    """File with the mixing matrix of the colour filters; see capture/mixing.py."""
    hot_pixels: bool | None = None
    """Replace and mask pixels that lie; None: where the photo is registered or merged."""
    blur_px: Annotated[float, Field(gt=0, le=3)] | None = None
    """Standard deviation of the blur of lens and sensor, in pixels of the scene's image, to be divided out."""
    wavelength_order: str | None = None
    """Wavelength of each file channel [nm], for example ``610,530,430``."""
    transfer: Literal["linear", "srgb"] | None = None
    """Tone curve of integer frames."""
    page: Annotated[int, Field(ge=0)] | None = None
    """Page of a TIFF with several."""
    dataset: str | None = None
    """Array in an HDF5 or NPZ file."""


def check_consistent(settings: CaptureSettings) -> None:
    """Refuse settings that contradict each other; a file that is but a part of them may do so.

    Raises:
        InputError: what contradicts what.
    """
    problem = None
    needy = [name for name in ("distortion", "mirrored", "turned_deg") if getattr(settings, name)]
    if settings.corners is None and needy:
        problem = f"{needy[0]} needs corners: a file, or auto"
    elif settings.mixing is not None and settings.wavelength_order is not None:
        problem = "mixing and wavelength_order exclude each other; the matrix says what each channel sees"
    elif len(settings.frames) == 1:
        problem = "frames lists one frame; give it as the image, or two or more with different exposure_s"
    elif settings.flat_exposure_s is not None and not settings.frames:
        problem = "flat_exposure_s is for frames with exposure_s; give exposure, image over flat, instead"
    elif settings.exposure is not None and settings.flat_exposure_s is not None:
        problem = "exposure and flat_exposure_s exclude each other; give one"
    if problem is not None:
        raise InputError(problem)


def capture_from_tree(tree: Mapping[str, Any], name: str = "") -> CaptureSettings:
    """Settings of a mapping as YAML holds it.

    Raises:
        InputError: an unknown key or a value out of range.
    """
    try:
        return CaptureSettings.model_validate(dict(tree))
    except pydantic.ValidationError as error:
        raise InputError("; ".join(validation_lines(error, name)[:3])) from error


def read_capture_tree(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Keys and values of a capture file; paths in it are relative to its folder and come back complete.

    Raises:
        InputError: no readable YAML, an unknown key or a value out of range.
    """
    file = regular_file(path)
    tree = read_yaml(file, "dark: dark.tif")
    capture_from_tree(tree, str(file))
    beside = file.parent
    for key in PATHS:
        if tree.get(key) not in (None, AUTO):
            tree[key] = str(beside / tree[key])
    for frame in tree.get("frames") or ():
        for key in ("file", "dark"):
            if frame.get(key) is not None:
                frame[key] = str(beside / frame[key])
    return tree


def capture_settings(options: Mapping[str, Any], image: str | None = None) -> CaptureSettings:
    """The settings that options describe; options win over the image's own capture file, that over a common one.

    Args:
        options: fields of :class:`CaptureSettings` that were given, and ``capture``, path of a common capture file.
        image: photo or capture file.

    Raises:
        InputError: an unreadable file, an unknown key or a value out of range.
    """
    files = [path for path in (options.get("capture"), image if image and is_capture_file(image) else None) if path]
    tree: dict[str, Any] = {}
    for path in files:
        tree |= {key: value for key, value in read_capture_tree(path).items() if value is not None}
    return capture_from_tree(tree | {key: value for key, value in options.items() if key != "capture"})


def is_capture_file(image: str | os.PathLike[str]) -> bool:
    """Whether an image is a capture file, which lists the frames of one view."""
    return Path(os.fspath(image)).suffix.lower() in CAPTURE_SUFFIXES


def capture_files(image: str | None, settings: CaptureSettings) -> dict[str, str]:
    """Every file that a capture is read from, by its role (``image``, ``dark``, ``frame 1``...)."""
    files = {} if image is None else {"image": image}
    for number, frame in enumerate(settings.frames, 1):
        files[f"frame {number}"] = frame.file
        if frame.dark is not None:
            files[f"dark of frame {number}"] = frame.dark
    named = {kind: getattr(settings, kind) for kind in PATHS}
    return files | {kind: path for kind, path in named.items() if path not in (None, AUTO)}
