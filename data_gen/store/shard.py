"""A shard: samples checked, hashed, compressed and laid out as HDF5, all in memory.

HDF5 never touches the disk here: on a full disk it reports the error a hundred
samples late and then crashes the process, and it never calls fsync.
"""

import hashlib
import io
import re
import zlib
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, Literal, NoReturn, get_args

import h5py
import numpy as np
import numpy.typing as npt

from data_gen.sampler import Field, SampleBatch
from data_gen.store.layout import FIELD_DTYPES, FORMAT_VERSION
from warp_caustics.errors import InputError

Compression = Literal["gzip", "none"]

FLOAT16_LIMIT = 65504.0
"""A float16 of this size may be a clipped larger number."""
_FLOAT16_LIMIT_BITS = 0x7BFF
"""The same number's bits; those of infinities and NaN are larger."""
GZIP_LEVEL = 1
"""Higher levels save nothing: photon noise does not compress."""
RESERVED_NAMES = ("ids", "counters")

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")
_IDENTITY = re.compile(rb"shard (\d{1,9}) of ([0-9a-f]{64})")


@dataclass(frozen=True)
class EncodedShard:
    """A shard ready to be written.

    Attributes:
        data: the HDF5 file.
        samples: field name to one hash per sample.
    """

    data: memoryview
    samples: dict[str, tuple[str, ...]]


def check_fields(fields: Sequence[Field], compression: str) -> None:
    """Refuse arrays that the format cannot hold.

    Raises:
        InputError: says which and why.
    """
    if compression not in get_args(Compression):
        raise InputError(f"compression {compression!r} is not known; use one of {', '.join(get_args(Compression))}")
    names = [field.name for field in fields]
    if not fields or len(set(names)) != len(names):
        raise InputError(f"fields {names} must be at least one and have different names")
    for field in fields:
        if not _NAME.fullmatch(field.name) or field.name in RESERVED_NAMES:
            raise InputError(f"field name {field.name[:40]!r} cannot be used; take letters, digits and _")
        if field.dtype not in FIELD_DTYPES:
            raise InputError(f"field {field.name} has dtype {field.dtype!r}; use one of {', '.join(FIELD_DTYPES)}")
        if field.columns and field.shape != (len(field.columns),):
            raise InputError(f"field {field.name} has {len(field.columns)} columns and shape {list(field.shape)}")
        if any(length < 1 for length in field.shape):
            raise InputError(f"field {field.name} has shape {list(field.shape)}; every length must be at least 1")


def sample_digest(sample: int, field: str, array: npt.NDArray[Any]) -> str:
    """Hash of one array of one sample, of its place too: moved to another sample or field it no longer matches."""
    digest = hashlib.sha256(f"{sample}/{field}/{array.dtype.name}/{list(array.shape)}\n".encode())
    digest.update(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).data)
    return digest.hexdigest()


def encode_shard(
    batch: SampleBatch,
    fields: Sequence[Field],
    *,
    shard: int,
    ids: Sequence[int],
    fingerprint: str,
    config: bytes,
    compression: Compression,
    pool: Executor,
) -> EncodedShard:
    """Check, hash, compress and lay out samples. The same samples give the same bytes.

    Args:
        batch: the samples.
        fields: what they consist of.
        shard: the shard's number.
        ids: samples it must hold.
        fingerprint: hash of the configuration.
        config: the configuration in canonical JSON, stored so that a lone file explains itself.
        compression: ``"gzip"`` (level 1 with shuffle) or ``"none"``.
        pool: threads that hash and compress.

    Raises:
        InputError: the sampler returned something else than it announced, or numbers that are not finite.
    """
    arrays = _checked(batch, fields, tuple(ids), shard)
    work = [(sample, row, field) for row, sample in enumerate(ids) for field in fields]
    packed = list(pool.map(lambda item: _pack(item[0], item[2], arrays[item[2].name][item[1]], compression), work))
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver="earliest") as file:
        # Of fixed length: other text lies in a heap of its own, away from the file's first bytes.
        file.attrs["identity"] = np.bytes_(f"shard {shard} of {fingerprint}")
        _describe(file, {"format_version": FORMAT_VERSION, "shard": shard, "fingerprint": fingerprint})
        _describe(file, {"config": config.decode()})
        datasets = {field.name: _dataset(file, field, len(ids), compression) for field in fields}
        numbers = file.create_dataset("ids", data=np.asarray(ids, np.int64))
        _describe(numbers, {"description": "sample numbers, in the order of the first axis of all arrays"})
        counters = file.create_group("counters")
        for name in sorted(batch.counters):
            counters.create_dataset(name, data=np.asarray(batch.counters[name], np.float64))
        # Sample by sample, so that reading one is reading one stretch of the file.
        for (_, row, field), (_, payload) in zip(work, packed, strict=True):
            datasets[field.name].id.write_direct_chunk((row, *(0 for _ in field.shape)), payload)
    digests = {
        field.name: tuple(digest for (_, _, of), (digest, _) in zip(work, packed, strict=True) if of is field)
        for field in fields
    }
    return EncodedShard(buffer.getbuffer(), digests)


def identity(head: bytes) -> tuple[int, str] | None:
    """Shard number and fingerprint, found in a file's first bytes without letting HDF5 see them."""
    found = _IDENTITY.search(head)
    return (int(found[1]), found[2].decode()) if found else None


def _checked(
    batch: SampleBatch, fields: Sequence[Field], ids: tuple[int, ...], shard: int
) -> Mapping[str, npt.NDArray[Any]]:
    where = f"shard {shard}"
    if tuple(batch.ids) != ids:
        raise InputError(f"{where}: the sampler returned samples {list(batch.ids)[:4]}..., not {list(ids)[:4]}...")
    if set(batch.arrays) != {field.name for field in fields}:
        raise InputError(
            f"{where}: the sampler returned {sorted(batch.arrays)}, not {[field.name for field in fields]}"
        )
    for field in fields:
        array, shape = batch.arrays[field.name], (len(ids), *field.shape)
        if array.shape != shape or array.dtype != np.dtype(field.dtype):
            found = f"{array.dtype} {list(array.shape)}"
            raise InputError(f"{where}: {field.name} is {found}, not {field.dtype} {list(shape)}")
    for name, values in batch.counters.items():
        if not _NAME.fullmatch(name) or np.shape(values) != (len(ids),):
            raise InputError(f"{where}: counter {name[:40]!r} has shape {list(np.shape(values))}, not [{len(ids)}]")
        if not np.isfinite(values).all():
            sample = ids[int(np.argmin(np.isfinite(values)))]
            raise InputError(f"{where}, sample {sample}: counter {name} is not finite; the sampler is at fault")
    return batch.arrays


def _pack(sample: int, field: Field, array: npt.NDArray[Any], compression: Compression) -> tuple[str, bytes]:
    array = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    if field.dtype == "float16":
        # As integers, sign removed: one fast pass, where arithmetic in float16 takes three slow ones.
        right = int((array.view(np.uint16) & 0x7FFF).max()) < _FLOAT16_LIMIT_BITS
    else:
        right = bool(np.isfinite(array).all())
    if not right:
        _refuse(sample, field, array)
    digest = sample_digest(sample, field.name, array)
    if compression == "none":
        return digest, array.tobytes()
    # HDF5's shuffle filter: first all first bytes, then all second bytes ...
    shuffled = np.ascontiguousarray(array.reshape(-1).view(np.uint8).reshape(-1, array.itemsize).T)
    return digest, zlib.compress(shuffled.data, GZIP_LEVEL)


def _refuse(sample: int, field: Field, array: npt.NDArray[Any]) -> NoReturn:
    if not np.isfinite(array).all():
        count = array.size - int(np.isfinite(array).sum())
        raise InputError(
            f"sample {sample}: {field.name} has {count} of {array.size} values that are not finite; "
            "the sampler is at fault, or float16 too small for them"
        )
    raise InputError(f"sample {sample}: {field.name} reaches the limit {FLOAT16_LIMIT:g} of float16; use float32")


def _dataset(file: Any, field: Field, samples: int, compression: Compression) -> Any:
    dtype = np.dtype(field.dtype).newbyteorder("<")
    # A chunk that is missing must not look like data: NaN, and the sample's hash does not match.
    options: dict[str, Any] = {"chunks": (1, *field.shape), "fillvalue": dtype.type(np.nan), "track_times": False}
    if compression == "gzip":
        options |= {"compression": "gzip", "compression_opts": GZIP_LEVEL, "shuffle": True}
    dataset = file.create_dataset(field.name, (samples, *field.shape), dtype, **options)
    _describe(dataset, {"unit": field.unit, "description": field.description})
    describe_columns(dataset, field)
    return dataset


def describe_columns(dataset: Any, field: Field) -> None:
    """Names, units and meanings of a field's columns as attributes of a data set, three lists of text."""
    for name, words in (
        ("columns", [column.name for column in field.columns]),
        ("units", [column.unit for column in field.columns]),
        ("descriptions", [column.description for column in field.columns]),
    ):
        if words:
            # Of fixed length, as the shard's identity: it lies beside the data set, not in a heap of the file.
            dataset.attrs[name] = np.array([word.encode() for word in words], dtype=f"S{max(map(len, words)) or 1}")


def _describe(node: Any, attributes: Mapping[str, str | int]) -> None:
    for name, value in attributes.items():
        node.attrs[name] = value if isinstance(value, str) else np.int64(value)
