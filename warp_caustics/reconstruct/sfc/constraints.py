"""What SfC is told besides the image: where glass was printed, and how much.

The published evaluation derives both from the true relief. Here they are
inputs, and every result says where they came from.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, Literal

import numpy as np
import scipy  # loads its parts when they are first used

from warp_caustics.errors import InputError
from warp_caustics.io.heights import read_heights
from warp_caustics.io.images import read_image
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.volume import relief_volume
from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray, FloatArray

Source = Literal["none", "given", "estimated", "oracle"]


PRINTED_M = 2.5e-5
"""Relief from which a sample counts as printed [m]: SfC's 1e-3 of its 2.5 cm."""

MASK_GROWTH = 0.05
"""A mask is grown by this fraction of the samples per side: SfC's default, 6 of 128."""

LIT_DIFFERENTLY = 0.05
"""Deviation from the flat plate, relative to the radiosity, that counts as a trace of print, at least."""

LIT_ABOVE_NOISE = 3.0
"""The same in units of the noise."""


@dataclass(frozen=True)
class Constraints:
    """Mask and printed volume, with their sources.

    Attributes:
        mask: True where glass may be, shape [n, n]; all True if nothing is known.
        mask_source: where the mask came from.
        volume_m3: printed volume [m^3]; None if unknown.
        volume_source: where the volume came from.
    """

    mask: BoolArray
    mask_source: Source
    volume_m3: float | None
    volume_source: Source

    @property
    def is_oracle(self) -> bool:
        """Whether anything was derived from the true relief."""
        return "oracle" in (self.mask_source, self.volume_source)

    def record(self) -> dict[str, Any]:
        """For a result's settings."""
        return {
            "mask": self.mask_source,
            "mask_fraction": float(self.mask.mean()),
            "volume": self.volume_source,
            "volume_m3": self.volume_m3,
        }


def grown(mask: BoolArray) -> BoolArray:
    """A mask [n, n] dilated by floor(0.05 n) samples, one 4-neighbourhood after another, at least one."""
    steps = max(1, int(MASK_GROWTH * len(mask)))
    result: BoolArray = scipy.ndimage.binary_dilation(mask, iterations=steps)
    return result


def oracle_mask(true_heights_m: FloatArray) -> BoolArray:
    """Where the true relief [m], shape [n, n], is printed, grown as published."""
    return grown(true_heights_m >= PRINTED_M)


def estimated_mask(image: CausticImage, scene: Scene) -> BoolArray:
    """Where the image tells of print: cells lit differently from a flat plate, grown, holes filled.

    A cell counts if the RMS deviation of its pixels from the radiosity exceeds 5 % of it, and three times the noise,
    in any wavelength. Light of a line lands up to some millimetres beside it; growing by 5 % of the plate covers that.
    Pixels that must be ignored count as lit differently: what they hide is unknown.
    """
    n, m = scene.height_samples, scene.image_pixels
    radiosity = np.asarray(scene.radiosity_W_m2)
    lit = radiosity > 0
    relative = image.irradiance[lit] / radiosity[lit, None, None]
    noise = np.zeros(lit.sum()) if image.noise_std is None else np.asarray(image.noise_std)[lit] / radiosity[lit]
    limit = np.maximum(LIT_DIFFERENTLY, LIT_ABOVE_NOISE * noise)
    squared = (relative - 1) ** 2
    if image.mask is not None:
        squared = np.where(image.mask[lit], squared, np.inf)
    if m >= n:
        # Pixels fall into the cell of their centre; n need not divide m.
        starts = np.searchsorted((np.arange(m) + 0.5) * n / m, np.arange(n))
        counts = np.diff(np.append(starts, m))
        sums = np.add.reduceat(np.add.reduceat(squared, starts, axis=1), starts, axis=2)
        cells = sums / (counts[:, None] * counts)
    else:
        nearest = ((np.arange(n) + 0.5) * m / n).astype(int)
        cells = squared[:, nearest][:, :, nearest]
    touched = (cells > limit[:, None, None] ** 2).any(axis=0)
    filled: BoolArray = scipy.ndimage.binary_fill_holes(grown(touched))
    return filled


def given_mask(mask: Any, scene: Scene) -> BoolArray:
    """A mask from an array or a file; nonzero is printed, shape [n, n].

    Raises:
        InputError: no real numbers, another shape, or unreadable.
    """
    n = scene.height_samples
    if isinstance(mask, str | PathLike):
        array = read_image(mask, fits=lambda _, *size: _check_mask(size, n)).values.any(axis=0)
    else:
        array = np.asarray(mask)
    if array.dtype.kind not in "buif":
        raise InputError(f"mask is {array.dtype}; give True where glass may be, or the path of an image")
    _check_mask(array.shape, n)
    if not np.isfinite(array).all():
        raise InputError("mask has values that are not finite; use True or 1 where glass may be, else False or 0")
    printed: BoolArray = array != 0
    return printed


def _check_mask(shape: Sequence[int], n: int) -> None:
    if tuple(shape) != (n, n):
        raise InputError(f"mask has shape {list(shape)}, the scene needs [{n}, {n}]; resample it")


def true_heights(field: Any, scene: Scene) -> FloatArray:
    """The true relief for an oracle [m], shape [n, n], from an array or a file.

    Raises:
        InputError: another shape, values that are not finite, or unreadable.
    """
    n = scene.height_samples
    heights: FloatArray
    if isinstance(field, str | PathLike):
        heights = read_heights(field)
    else:
        array = np.asarray(field)
        if array.dtype.kind != "f":
            raise InputError(f"oracle_heights_m is {array.dtype}; give float heights in metres or the path of a file")
        heights = array.astype(np.float64)
    if heights.shape != (n, n):
        raise InputError(f"oracle_heights_m has shape {list(heights.shape)}, the scene needs [{n}, {n}]; resample it")
    if not np.isfinite(heights).all():
        raise InputError("oracle_heights_m is not finite everywhere; repair it")
    return heights


def gather(mask: Any, volume: float | str, oracle_heights_m: Any, image: CausticImage, scene: Scene) -> Constraints:
    """Mask and volume as asked for.

    Args:
        mask: ``"none"``, ``"estimated"``, ``"oracle"``, an array [n, n] or the path of an image.
        volume: ``"none"``, ``"oracle"`` or the printed volume [m^3].
        oracle_heights_m: the true relief [m], shape [n, n], or its path; None without an oracle.
        image: the measured caustic.
        scene: its set-up.

    Raises:
        InputError: something is missing, does not fit, or the mask leaves no room for glass.
    """
    n = scene.height_samples
    truth = None if oracle_heights_m is None else true_heights(oracle_heights_m, scene)
    mask_source: Source = "given"
    if isinstance(mask, str) and mask in ("none", "estimated", "oracle"):
        mask_source = mask  # type: ignore[assignment]
    if truth is None and (mask_source == "oracle" or volume == "oracle"):
        raise InputError("an oracle needs the true relief; give oracle_heights_m, or mask='none' and volume_m3='none'")
    if mask_source == "none":
        found = np.ones((n, n), bool)
    elif mask_source == "estimated":
        found = estimated_mask(image, scene)
    elif mask_source == "oracle":
        assert truth is not None
        found = oracle_mask(truth)
    else:
        found = given_mask(mask, scene)
    if not found.any():
        hint = f"; no cell deviates from flat by {LIT_DIFFERENTLY:.0%}" if mask_source == "estimated" else ""
        raise InputError(f"mask ({mask_source}) is False everywhere, so no glass could be{hint}; give mask='none'")
    if volume == "none":
        return Constraints(found, mask_source, None, "none")
    if volume == "oracle":
        assert truth is not None
        printed = relief_volume(truth, scene.sample_pitch_m)
        if printed <= 0:
            raise InputError(f"oracle_heights_m has a volume of {printed:g} m^3, nothing was printed; check its sign")
        return Constraints(found, mask_source, printed, "oracle")
    return Constraints(found, mask_source, float(volume), "given")
