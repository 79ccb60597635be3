"""Height maps in and out: metres, one sample per cell centre, [row, column].

A height map is the relief above the plate's base. Files carry no geometry:
the plate's size comes from the scene. Half floats and integers are refused,
because 16-bit floats step by 2 um at 2 mm of relief.
"""

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from warp_caustics.errors import InputError
from warp_caustics.io.arrays import read_array
from warp_caustics.io.atomic import PathLike, atomic_path, regular_file
from warp_caustics.io.decoded import Decoded
from warp_caustics.io.hdf5_file import new_hdf5
from warp_caustics.io.image_file import MAX_PIXELS, MAX_VALUES, Array, FitsCheck
from warp_caustics.io.image_format import sniff_format
from warp_caustics.io.solid import is_solid
from warp_caustics.io.tiff import read_tiff

MAX_HEIGHT_M = 0.1
"""Relief above 10 cm is no print but a unit mistake."""

_KEY = "heights_m"
_INSTEAD = "give heights in metres as NPY, NPZ, float TIFF or HDF5, or where lines are read a list (.csv, .yaml)"
_INSTEAD_OF_SOLID = f"of solids nsfc inspect --nominal reads the top; {_INSTEAD}"
_SUFFIXES = (".npy", ".npz", ".tif", ".tiff", ".h5", ".hdf5")


def _likely_unit(highest: float) -> str:
    for unit, metres in (("mm", 1e-3), ("um", 1e-6), ("nm", 1e-9)):
        if highest * metres <= MAX_HEIGHT_M:
            return f"; did you mean {highest:.4g} {unit}? multiply by {metres:g}"
    return "; give metres"


def _check_shape(name: str, shape: Sequence[int], batch: bool) -> None:
    axes = "[B, n, n]" if batch else "[n, n]"
    if len(shape) != (3 if batch else 2) or shape[-1] != shape[-2]:
        hint = "; read it with batch=True" if not batch and len(shape) == 3 and shape[-1] == shape[-2] else ""
        raise InputError(f"{name} has shape {tuple(shape)}; give a square height map {axes}{hint}")
    if shape[-1] < 2 or shape[0] < 1:
        raise InputError(f"{name} has shape {tuple(shape)}; give at least 2 x 2 samples")
    if shape[-1] ** 2 > MAX_PIXELS or (batch and shape[0] * shape[-1] ** 2 > MAX_VALUES):
        raise InputError(f"{name} claims shape {tuple(shape)}; at most {MAX_PIXELS:.3g} samples are read, crop it")


def _checked_heights(array: Array, name: str, batch: bool) -> npt.NDArray[np.float64]:
    if array.dtype == np.float16:
        raise InputError(f"{name} holds 16-bit floats, which step by 2 um at 2 mm; save float32 or float64")
    if array.dtype.kind != "f":
        raise InputError(f"{name} holds {array.dtype}, not heights in metres; save float32 or float64")
    _check_shape(name, array.shape, batch)
    heights = np.ascontiguousarray(array, dtype=np.float64)
    bad = ~np.isfinite(heights)
    if bad.any():
        index = tuple(int(i) for i in np.unravel_index(int(bad.argmax()), bad.shape))
        raise InputError(
            f"{name}: {int(bad.sum())} heights are NaN or infinite, first {heights[index]} at {list(index)}; mend them"
        )
    highest = float(np.abs(heights).max())
    if highest > MAX_HEIGHT_M:
        raise InputError(f"{name}: height {highest:.4g} m is above {MAX_HEIGHT_M:g} m{_likely_unit(highest)}")
    return heights


def read_heights(
    path: PathLike, *, dataset: str | None = None, batch: bool = False, fits: Callable[[int], None] | None = None
) -> npt.NDArray[np.float64]:
    """Read a height map.

    Args:
        path: NPY, NPZ, float TIFF or HDF5 file; its content tells which.
        dataset: array in NPZ or HDF5, ``heights_m`` if not given.
        batch: expect several maps, shape [B, n, n]; not in TIFF.
        fits: called with n before the numbers are read; raises to refuse it.

    Returns:
        Relief above the base [m], float64, shape [n, n] or [B, n, n].

    Raises:
        InputError: not a finite, square, real map of plausible metres, or an unusable path or format.
        DamagedDataError: a truncated or corrupt file.
    """
    path = regular_file(path)
    name = repr(str(path))
    format_, _ = sniff_format(path, _INSTEAD_OF_SOLID if is_solid(path) else _INSTEAD)
    if format_ not in ("npy", "npz", "tiff", "hdf5"):
        raise InputError(f"{name} is {format_}, which holds pictures; give heights as NPY, NPZ, float TIFF or HDF5")
    if dataset is not None and format_ not in ("npz", "hdf5"):
        raise InputError(f"{name} is {format_}, which has no datasets; leave --dataset {dataset} out")

    def check(shape: Sequence[int]) -> None:
        _check_shape(name, shape, batch)
        if fits is not None:
            fits(shape[-1])

    if format_ == "tiff":
        decoded = _one_layer(read_tiff(path, None, MAX_PIXELS, _one_layer_of(name, check)), name)
    else:
        decoded = read_array(path, format_, dataset or _KEY, check)
    unit = decoded.description.get("units", "m")
    if unit != "m":
        raise InputError(f"{name} records the unit {unit!r}; give heights in metres")
    return _checked_heights(decoded.array, name, batch)


def _one_layer_of(name: str, check: Callable[[Sequence[int]], None]) -> FitsCheck:
    """The check of a picture's shape, which must have one channel."""

    def fits(channels: int, rows: int, columns: int) -> None:
        if channels != 1:
            raise InputError(f"{name} has {channels} channels; give one channel of heights in metres")
        check((rows, columns))

    return fits


def _one_layer(decoded: Decoded, name: str) -> Decoded:
    if len(decoded.array) != 1:
        raise InputError(f"{name} has {len(decoded.array)} channels; give one channel of heights in metres")
    decoded.array = decoded.array[0]
    return decoded


def _write_tiff(path: Path, heights: npt.NDArray[np.float64]) -> None:
    import tifffile

    tifffile.imwrite(
        path,
        heights.astype(np.float32),
        photometric="minisblack",
        compression="zlib",
        metadata=None,
        description=json.dumps({"software": "nsfc", "quantity": _KEY, "units": "m", "axes": "row, column"}),
        software="nsfc",
    )


def _write_hdf5(path: Path, heights: npt.NDArray[np.float64]) -> None:
    # gzip carries a checksum of the values, so damage is found on reading.
    with new_hdf5(path) as file:
        data = file.create_dataset(_KEY, data=heights, compression="gzip", shuffle=True)
        data.attrs["units"] = "m"


def write_heights(path: PathLike, heights_m: npt.ArrayLike) -> None:
    """Write a height map; it appears complete or not at all.

    NPY, NPZ and HDF5 keep float64; TIFF is float32 (0.2 nm at 2 mm).

    Args:
        path: .npy, .npz, .tif, .tiff, .h5 or .hdf5.
        heights_m: relief above the base [m], shape [n, n] or, not for TIFF, [B, n, n].

    Raises:
        InputError: unknown suffix, or no finite, square, real map of plausible metres.
        ResourceError: the disk is full.
    """
    suffix = Path(os.fspath(path)).suffix.lower()
    if suffix not in _SUFFIXES:
        raise InputError(f"suffix {suffix!r} of {os.fspath(path)!r} is not known; use one of {', '.join(_SUFFIXES)}")
    array = np.asarray(heights_m)
    heights = _checked_heights(array, "the height map", batch=array.ndim == 3)
    if heights.ndim == 3 and suffix in (".tif", ".tiff"):
        raise InputError(f"TIFF takes one height map, not {len(heights)}; write .npy, .npz or .h5")
    with atomic_path(path) as temporary:
        if suffix == ".npy":
            np.save(temporary, heights, allow_pickle=False)
        elif suffix == ".npz":
            np.savez_compressed(temporary, allow_pickle=False, **{_KEY: heights})
        elif suffix in (".tif", ".tiff"):
            _write_tiff(temporary, heights)
        else:
            _write_hdf5(temporary, heights)
