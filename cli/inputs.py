"""What a reconstruction reads: images by name, folder or pattern, and one image with all that belongs to it."""

import glob
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cli.provenance import file_records
from warp_caustics.capture.read import read_capture
from warp_caustics.capture.settings import CaptureSettings, capture_files, capture_settings
from warp_caustics.errors import CausticsError, InputError
from warp_caustics.prints.relief_file import read_relief
from warp_caustics.scene import Scene

if TYPE_CHECKING:
    from warp_caustics.capture.shot import Capture
    from warp_caustics.reconstruct.base import CausticImage
    from warp_caustics.types import FloatArray

SUFFIXES = (".tif", ".tiff", ".png", ".exr", ".npy", ".npz", ".h5", ".hdf5")
"""Files of a folder that are taken for images."""


def image_list(images: Sequence[str]) -> str | list[str]:
    """The one image of a single reconstruction, or all those of a batch.

    Args:
        images: as given: files, folders (their images, not those of folders within) and patterns such as ``*.tif``.

    Raises:
        InputError: a folder or a pattern without images.
    """
    if len(images) == 1 and not os.path.isdir(images[0]) and (os.path.exists(images[0]) or not _is_pattern(images[0])):
        return images[0]
    found: list[str] = []
    for name in images:
        if os.path.isdir(name):
            entries = sorted(os.listdir(name))
            held = [os.path.join(name, entry) for entry in entries if entry.lower().endswith(SUFFIXES)]
            if not held:
                raise InputError(f"folder {name!r} holds no images ({', '.join(SUFFIXES)}); name images, or another")
        elif _is_pattern(name) and not os.path.exists(name):
            held = sorted(glob.glob(name))
            if not held:
                raise InputError(f"no file matches {name!r}; check the pattern")
        else:
            held = [name]
        found += [path for path in held if path not in found]
    return found


def _is_pattern(name: str) -> bool:
    return any(character in name for character in "*?[")


@dataclass(frozen=True, eq=False)
class Inputs:
    """All that was read.

    Attributes:
        capture: calibrated image.
        initial: relief to start from [m], shape [n, n].
        reference: true relief [m], shape [n, n].
        files: path and sha256 of each file, by its role.
    """

    capture: "Capture"
    initial: "FloatArray | None"
    reference: "FloatArray | None"
    files: Mapping[str, Mapping[str, str]]

    @property
    def caustic(self) -> "CausticImage":
        """The image as methods take it."""
        return self.capture.caustic


def read_files(image: str, files: Mapping[str, str], capture: Mapping[str, Any]) -> list[str]:
    """Paths of all that is read for an image: itself or its frames, calibration, and files by role.

    Args:
        image: path.
        files: paths by role: initial, reference and others.
        capture: options on how to read the image, see :mod:`cli.capture_options`.
    """
    try:
        frames = capture_files(image, capture_settings(capture, image))
    except CausticsError:
        frames = {}  # what is wrong with it is said when it is read
    return [image, *frames.values(), *files.values()]


def read_inputs(files: Mapping[str, str], scene: Scene, settings: CaptureSettings) -> Inputs:
    """Read and check everything a reconstruction needs, before any of it is computed.

    Args:
        files: paths by role: image, and where given initial, reference and others, which are only put on record.
        scene: what they must fit.
        settings: how to read and calibrate the image.
    """
    image, n, size = files["image"], scene.height_samples, scene.plate_size_m
    capture = read_capture(image, scene, settings)
    reliefs = {kind: read_relief(files[kind], n, size, kind) for kind in ("initial", "reference") if kind in files}
    return Inputs(
        capture=capture,
        initial=reliefs.get("initial"),
        reference=reliefs.get("reference"),
        files=file_records({**capture_files(image, settings), **files}),
    )
