"""Cross-talk of the colour filters: camera channels are a matrix times the light of each wavelength.

    counts_c = sum_i M[c, i] E_i

M may be in any unit as long as its rows, one per camera channel, share it. The
light follows by least squares; with more channels than wavelengths the rest
tells how well M describes the camera.
"""

import csv
import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from warp_caustics.capture.preview import preview
from warp_caustics.capture.stage import Work
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.atomic import read_text, regular_file
from warp_caustics.io.channels import WAVELENGTH_TOLERANCE_M, in_nm
from warp_caustics.io.image_file import MAX_CHANNELS
from warp_caustics.io.noise import BoolImage, FloatImage
from warp_caustics.io.yaml_file import MAX_YAML_BYTES, read_yaml

EXAMPLE = "{wavelengths_m: [610e-9, 530e-9], matrix: [[0.9, 0.1], [0.2, 0.8]]}"
MAX_CONDITION = 100.0
"""Unmixing multiplies noise by up to the condition number."""
WARN_CONDITION = 10.0


@dataclass(frozen=True, eq=False)
class Mixing:
    """A mixing matrix.

    Attributes:
        matrix: response of each camera channel to each wavelength, shape [C, n_w].
        wavelengths_m: wavelength of each column [m], shape [n_w].
    """

    matrix: npt.NDArray[np.float64]
    wavelengths_m: tuple[float, ...]

    def for_scene(self, scene_m: tuple[float, ...]) -> npt.NDArray[np.float64]:
        """Columns in the order of the scene's wavelengths [m], each scaled to a largest response of 1.

        Raises:
            MismatchError: other wavelengths than the scene's.
        """
        columns = []
        for wanted in scene_m:
            nearest = int(np.argmin(np.abs(np.array(self.wavelengths_m) - wanted)))
            if abs(self.wavelengths_m[nearest] - wanted) > WAVELENGTH_TOLERANCE_M:
                raise MismatchError(
                    f"the mixing matrix is for {in_nm(self.wavelengths_m)}, the scene has {in_nm(scene_m)}; "
                    "measure it with the scene's light"
                )
            columns.append(nearest)
        if len(columns) != len(self.wavelengths_m):
            raise MismatchError(
                f"the mixing matrix has {len(self.wavelengths_m)} wavelengths, the scene {len(scene_m)}; "
                "give one column each"
            )
        return self.matrix[:, columns]

    def condition(self) -> float:
        """Condition number with every column scaled to length 1, so that units do not count."""
        return float(np.linalg.cond(self.matrix / np.linalg.norm(self.matrix, axis=0)))


def check_mixed_count(channels: int, mixing: Mixing) -> None:
    """Refuse an image whose channels are not those of a mixing matrix.

    Raises:
        MismatchError: another number of channels than rows.
    """
    if channels != len(mixing.matrix):
        raise MismatchError(
            f"the mixing matrix has {len(mixing.matrix)} rows, the image {channels} channels; give one row per channel"
        )


def read_mixing(path: str | os.PathLike[str]) -> Mixing:
    """A mixing matrix from YAML (``wavelengths_m``, ``matrix``) or CSV.

    CSV: the first row holds the wavelengths [m], each further row one camera channel.

    Raises:
        InputError: no readable matrix, a negative or missing number, or one that cannot be inverted.
    """
    file = regular_file(path)
    tree = _csv_tree(file) if file.suffix.lower() == ".csv" else read_yaml(file, EXAMPLE)
    if set(tree) != {"wavelengths_m", "matrix"}:
        raise InputError(f"{file} holds {', '.join(map(str, tree))[:60]}; write {EXAMPLE}")
    try:
        matrix = np.array(tree["matrix"], dtype=np.float64)
        wavelengths = tuple(float(value) for value in tree["wavelengths_m"])
    except (TypeError, ValueError) as error:
        raise InputError(f"{file} holds no matrix of numbers; write {EXAMPLE}") from error
    if matrix.ndim != 2 or matrix.shape[1] != len(wavelengths) or not 1 <= len(matrix) <= MAX_CHANNELS:
        raise InputError(f"{file}: matrix of shape {list(matrix.shape)} for {len(wavelengths)} wavelengths; {EXAMPLE}")
    if not all(1e-7 < value < 1e-5 for value in wavelengths) or len(set(wavelengths)) != len(wavelengths):
        raise InputError(f"{file}: wavelengths {wavelengths} repeat or are no light; give metres, for example 610e-9")
    if not np.isfinite(matrix).all() or (matrix < 0).any() or not matrix.any(axis=0).all():
        raise InputError(
            f"{file}: a response is negative, not finite, or a wavelength has none at all; measure it again"
        )
    if len(matrix) < len(wavelengths):
        raise InputError(
            f"{file}: {len(matrix)} camera channels cannot tell {len(wavelengths)} wavelengths apart; "
            "use fewer wavelengths, or one photo for each"
        )
    mixing = Mixing(matrix, wavelengths)
    if not mixing.condition() <= MAX_CONDITION:
        raise InputError(
            f"{file}: condition number {mixing.condition():.3g} (limit {MAX_CONDITION:g}), two wavelengths look alike "
            "to the camera; use other filters or wavelengths"
        )
    return mixing


def _csv_tree(file: Path) -> dict[str, Any]:
    try:
        text = read_text(file, MAX_YAML_BYTES)
        rows = [row for row in csv.reader(io.StringIO(text, newline="")) if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(f"{file} is no CSV text; give a UTF-8 file") from error
    if len(rows) < 2:
        raise InputError(f"{file} has {len(rows)} rows; give the wavelengths [m], then one row per camera channel")
    return {"wavelengths_m": rows[0], "matrix": rows[1:]}


def unmix(work: Work, mixing: Mixing, wavelengths_m: tuple[float, ...]) -> None:
    """Turn camera channels into wavelengths [m], in signal and flat field."""
    matrix, condition = mixing.for_scene(wavelengths_m), mixing.condition()
    before = preview(work.signal)
    if work.light is not None:
        work.light = unmixed(work.light, np.ones(work.light.shape, bool), matrix)[0]
    work.signal, work.mask, rest = unmixed(work.signal, work.mask, matrix)
    text = f"{len(matrix)} channels unmixed to {in_nm(wavelengths_m)}, condition number {condition:.3g}"
    figures = {"condition": condition}
    if np.isfinite(rest):
        figures["unexplained"] = rest
        text += f", {rest:.2%} of the signal unexplained"
        if rest > 0.05:
            work.warnings.append(
                f"the mixing matrix leaves {rest:.1%} of the signal unexplained (tolerance 5 %); measure it again"
            )
    if condition > WARN_CONDITION:
        work.warnings.append(
            f"the mixing matrix has condition number {condition:.3g} and multiplies noise by up to that "
            f"(limit {WARN_CONDITION:g}); use filters or wavelengths further apart"
        )
    work.done("unmixing", text, before, **figures)


def unmixed(
    signal: FloatImage, valid: BoolImage, matrix: npt.NDArray[np.float64]
) -> tuple[FloatImage, BoolImage, float]:
    """Light of each wavelength, by least squares.

    Args:
        signal: camera channels after dark subtraction, shape [C, H, W].
        valid: pixels that hold a measurement, shape [C, H, W].
        matrix: shape [C, n_w].

    Returns:
        Signal and mask, shape [n_w, H, W], in counts of the channel that responds most to the wavelength, and the root
        mean square of what the matrix does not explain over that of the signal (NaN with as many channels as
        wavelengths).
    """
    scaled = matrix / matrix.max(axis=0)
    light = np.tensordot(np.linalg.pinv(scaled), signal, axes=1)
    good = np.broadcast_to(valid.all(axis=0), light.shape).copy()
    if len(matrix) == matrix.shape[1]:
        return light, good, float("nan")
    rest = (np.tensordot(scaled, light, axes=1) - signal)[:, good[0]]
    total = float(np.sqrt(np.mean(signal[:, good[0]] ** 2))) if good.any() else 0.0
    return light, good, float(np.sqrt(np.mean(rest**2)) / total) if total > 0 else float("nan")
