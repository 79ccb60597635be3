"""Photographs as files that ``nsfc capture`` and ``nsfc reconstruct`` read."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

from warp_caustics.camera.operator import Camera
from warp_caustics.camera.photographs import Photographs
from warp_caustics.errors import InputError
from warp_caustics.io.atomic import write_text
from warp_caustics.io.images import write_image

SUFFIXES = (".tif", ".tiff", ".png")
"""Of files with whole numbers of 16 bits."""
CORNERS = ("-x-y", "+x-y", "+x+y", "-x+y")


def photograph_files(path: str | os.PathLike[str], camera: Camera) -> dict[str, Path]:
    """Names of all files beside a photo, by what they are: photo, dark, flat, capture; corners and mixing if needed.

    Raises:
        InputError: a suffix of files that hold no counts.
    """
    photo = Path(os.fspath(path))
    if photo.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"suffix of {str(photo)!r} is not one of a camera's files; use {', '.join(SUFFIXES)}, for 16-bit counts"
        )
    if len(camera.parameters.gain) not in (1, 3) and photo.suffix.lower() == ".png":
        raise InputError(f"PNG holds 1 or 3 channels, the camera has {len(camera.parameters.gain)}; use .tif")
    names = {"photo": photo.name, "dark": f"{photo.stem}_dark{photo.suffix}"}
    names |= {"flat": f"{photo.stem}_flat{photo.suffix}", "capture": f"{photo.stem}_capture.yaml"}
    if _needs_corners(camera):
        names["corners"] = f"{photo.stem}_corners.yaml"
    if _needs_mixing(camera):
        names["mixing"] = f"{photo.stem}_mixing.yaml"
    return {kind: photo.with_name(name) for kind, name in names.items()}


def write_photographs(files: Mapping[str, Path], frames: Photographs, camera: Camera) -> None:
    """Write frames, and beside them what a person on the bench would know: a capture file with frames and corners.

    Args:
        files: see :func:`photograph_files`.
        frames: the counts.
        camera: that took them.
    """
    wavelengths = None if _needs_mixing(camera) else camera.scene.wavelengths_m
    for kind in ("photo", "dark", "flat"):
        write_image(files[kind], getattr(frames, kind), wavelengths_m=wavelengths)
    known = {kind: files[kind].name for kind in ("dark", "flat", "corners", "mixing") if kind in files}
    write_text(files["capture"], _yaml(known))
    if "corners" in files:
        corners = [[round(float(value), 3) for value in place] for place in camera.corners_px()]
        write_text(files["corners"], _yaml({"corners": dict(zip(CORNERS, corners, strict=True))}))
    if "mixing" in files:
        matrix = (camera.parameters.mixing * camera.parameters.gain[:, None]).double().cpu().numpy()
        waves = list(camera.scene.wavelengths_m)
        write_text(files["mixing"], _yaml({"wavelengths_m": waves, "matrix": np.round(matrix, 6).tolist()}))


def _needs_mixing(camera: Camera) -> bool:
    """Whether channels are not the wavelengths; where they are, what each sees of the others is not told: few know."""
    return len(camera.parameters.gain) != camera.scene.n_wavelengths


def _needs_corners(camera: Camera) -> bool:
    """Where the photo is the window, a small shift is not told."""
    return camera.config.frame_px is not None


def _yaml(tree: Mapping[str, object]) -> str:
    text: str = yaml.safe_dump(dict(tree), sort_keys=False, default_flow_style=None, width=120)
    return text
