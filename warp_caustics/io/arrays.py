"""Bare arrays: NPY, NPZ and HDF5, with every shape checked before its numbers are read."""

import json
import math
import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from warp_caustics.errors import CausticsError, DamagedDataError, InputError, ResourceError, is_out_of_memory
from warp_caustics.io.atomic import reason
from warp_caustics.io.decoded import Decoded
from warp_caustics.io.hdf5_file import new_hdf5
from warp_caustics.io.image_file import MAX_CHANNELS, Array
from warp_caustics.io.image_output import Output
from warp_caustics.io.regular import open_regular


def _npy_header(stream: IO[bytes], name: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    try:
        version = np.lib.format.read_magic(stream)
        if version not in ((1, 0), (2, 0)):
            raise InputError(f"{name} is NPY version {version}, meant for records; save a plain float32 array")
        reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        return reader(stream)
    except CausticsError:
        raise
    except Exception as error:
        raise DamagedDataError(f"{name}: NPY header cannot be read ({reason(error)}); save it again") from error


def _npy_array(stream: IO[bytes], name: str, check: Callable[[Sequence[int]], None]) -> Array:
    shape, fortran, dtype = _npy_header(stream, name)
    if dtype.kind not in "uif":
        raise InputError(f"{name} holds {dtype}, not real numbers; save float32")
    check(shape)
    wanted = math.prod(shape) * dtype.itemsize
    try:
        data = stream.read(wanted + 1)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError) as error:
        raise DamagedDataError(f"{name} is damaged ({reason(error)}); save or copy it again") from error
    if len(data) != wanted:
        state = "truncated" if len(data) < wanted else "followed by foreign bytes"
        raise DamagedDataError(f"{name} is {state}: its header promises {wanted} bytes; save or copy it again")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def _npz_arrays(path: Path, key: str, check: Callable[[Sequence[int]], None]) -> Decoded:
    name = repr(str(path))
    try:
        with zipfile.ZipFile(path) as archive:
            keys = [member.removesuffix(".npy") for member in archive.namelist()]
            if key not in keys:
                raise InputError(
                    f"{name} has no array {key!r} but {', '.join(keys[:8]) or 'nothing'}; name one of them"
                )
            with archive.open(f"{key}.npy") as stream:
                array = _npy_array(stream, f"{name} {key}", check)
            description: dict[str, Any] = {}
            if "wavelengths_m" in keys:
                with archive.open("wavelengths_m.npy") as stream:
                    description["wavelengths_m"] = _npy_array(stream, f"{name} wavelengths_m", _check_short).tolist()
            return Decoded(array, description)
    except CausticsError:
        raise
    except Exception as error:
        raise DamagedDataError(f"{name}: NPZ cannot be read ({reason(error)}); save or copy it again") from error


def _check_short(shape: Sequence[int]) -> None:
    if len(shape) != 1 or shape[0] > MAX_CHANNELS:
        raise InputError(f"wavelengths_m has shape {tuple(shape)}; give one wavelength per channel")


def _local_dataset(file: Any, key: str, name: str) -> Any:
    """The dataset `key` if its numbers lie in this very file; other files could be missing or anything."""
    import h5py

    node = file
    for part in filter(None, key.split("/")):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
        if link is None:
            found = ", ".join(list(file)[:8]) or "nothing"
            raise InputError(f"{name} has no dataset {key!r} but {found}; name one of them")
        if not isinstance(link, h5py.HardLink):
            raise InputError(f"{name}: {key!r} is a link to another place; copy the data into the file")
        node = node[part]
    if not isinstance(node, h5py.Dataset):
        raise InputError(f"{name}: {key!r} is a group, not a dataset; name one of {', '.join(list(node)[:8])}")
    if node.is_virtual or node.external:
        raise InputError(f"{name}: {key!r} keeps its numbers in other files; copy the data into the file")
    return node


def _hdf5_array(path: Path, key: str, check: Callable[[Sequence[int]], None]) -> Decoded:
    import h5py

    name = repr(str(path))
    try:
        with h5py.File(path, "r") as file:
            data = _local_dataset(file, key, name)
            if data.dtype.kind not in "uif":
                raise InputError(f"{name} {key} holds {data.dtype}, not real numbers; save float32")
            check(data.shape or ())
            if data.id.get_storage_size() == 0:
                raise DamagedDataError(f"{name} {key} has a shape but no numbers; write it again")
            if data.chunks and math.prod(data.chunks) > 4 * max(math.prod(data.shape), 1 << 20):
                raise InputError(f"{name} {key} has chunks of {data.chunks}, larger than itself; write it again")
            if not data.id.get_create_plist().all_filters_avail():
                raise InputError(f"{name} {key} is compressed by a filter that is not installed; use gzip")
            description = {
                k: data.attrs[k].tolist() if hasattr(data.attrs[k], "tolist") else data.attrs[k]
                for k in ("units", "wavelengths_m")
                if k in data.attrs
            }
            return Decoded(data[()], description)
    except CausticsError:
        raise
    except Exception as error:
        if is_out_of_memory(error) or "memory allocation failed" in str(error) or "can't allocate" in str(error):
            raise ResourceError(f"{name} needs more memory than there is to read; crop it, or free memory") from error
        raise DamagedDataError(f"{name}: HDF5 cannot be read ({reason(error)}); write or copy it again") from error


def read_array(path: Path, format_: str, key: str, check: Callable[[Sequence[int]], None]) -> Decoded:
    """Array of an NPY, NPZ or HDF5 file with its shape checked before it is read.

    Args:
        path: a regular file.
        format_: ``npy``, ``npz`` or ``hdf5``.
        key: name of the array in NPZ or HDF5.
        check: called with the shape; raises to refuse it.

    Raises:
        InputError: no such array, no real numbers, or data kept in other files.
        DamagedDataError: truncated or corrupt.
    """
    if format_ == "npy":
        with open_regular(path) as stream:
            return Decoded(_npy_array(stream, repr(str(path)), check))
    return _npz_arrays(path, key, check) if format_ == "npz" else _hdf5_array(path, key, check)


def write_npy(path: Path, image: Output) -> None:
    """Write the bare array."""
    np.save(path, image.array, allow_pickle=False)


def write_npz(path: Path, image: Output) -> None:
    """Write the arrays ``image`` and, where known, ``wavelengths_m``."""
    extra = {} if image.wavelengths_m is None else {"wavelengths_m": np.array(image.wavelengths_m)}
    np.savez_compressed(path, allow_pickle=False, image=image.array, **extra)


def write_hdf5(path: Path, image: Output) -> None:
    """Write the dataset ``image`` with its description as attributes."""
    # gzip carries a checksum of the values, so damage is found on reading.
    with new_hdf5(path) as file:
        data = file.create_dataset("image", data=image.array, compression="gzip", shuffle=True)
        for key, value in json.loads(image.description()).items():
            data.attrs[key] = value
