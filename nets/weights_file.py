"""Bytes of a weights file: safetensors with one metadata entry, checked before any of it is believed.

The entry ``nsfc`` holds a JSON record of everything but the tensors and a
sha256 over record and tensors. One entry, because safetensors writes several
in random order; so equal content makes equal files. Nothing is ever unpickled.
"""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import safetensors.torch
import torch

from warp_caustics.errors import DamagedDataError, MismatchError
from warp_caustics.io.atomic import reason

ENTRY = "nsfc"
MAX_HEADER_BYTES = 4_000_000
"""Most that is parsed; a network of this project needs a few thousand."""

_LENGTH_BYTES = 8
_PICKLES = {b"PK\x03\x04": "a zip archive, as PyTorch's own checkpoints are", b"\x80": "a pickle"}


def encode(record: Mapping[str, Any], tensors: Mapping[str, torch.Tensor]) -> tuple[bytes, str]:
    """Content of a weights file, and its sha256.

    Args:
        record: JSON values, finite numbers only.
        tensors: name to tensor on the CPU.
    """
    dense = {name: tensor.contiguous() for name, tensor in tensors.items()}
    digest = content_hash(record, dense)
    entry = {ENTRY: _canonical({"record": record, "sha256": digest})}
    return safetensors.torch.save(dense, entry), digest


def decode(data: bytes, name: str) -> tuple[dict[str, Any], dict[str, torch.Tensor], str]:
    """Record, tensors and sha256 of a weights file.

    Args:
        data: content of the file.
        name: of the file, for messages.

    Raises:
        DamagedDataError: truncated, changed, or with an absurd header.
        MismatchError: a file of another kind.
    """
    header = _header(data, name)
    metadata = header.get("__metadata__")
    if not isinstance(metadata, dict) or ENTRY not in metadata:
        raise MismatchError(f"{name} is a safetensors file, but not weights of nsfc; give one that nsfc wrote")
    try:
        entry = json.loads(metadata[ENTRY])
        record, digest = dict(entry["record"]), str(entry["sha256"])
        tensors = safetensors.torch.load(data)
        found = content_hash(record, tensors)
    except Exception as error:
        # Whatever is wrong in foreign bytes, the answer is the same.
        raise _damaged(name, reason(error)) from error
    if found != digest:
        raise _damaged(name, f"its content hashes to {found[:12]}..., it says {digest[:12]!r}...")
    return record, tensors, digest


def content_hash(record: Mapping[str, Any], tensors: Mapping[str, torch.Tensor]) -> str:
    """sha256 over the record, and names, types, shapes and bytes of the tensors."""
    digest = hashlib.sha256(_canonical(record).encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(_canonical([name, str(tensor.dtype), list(tensor.shape)]).encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def _canonical(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _damaged(name: str, why: str) -> DamagedDataError:
    return DamagedDataError(f"{name} is damaged ({why}); copy or download it again")


def _header(data: bytes, name: str) -> dict[str, Any]:
    """The JSON header, with every byte of the file accounted for."""
    length = int.from_bytes(data[:_LENGTH_BYTES], "little")
    available = len(data) - _LENGTH_BYTES
    if not 2 <= length <= MAX_HEADER_BYTES:
        for start, kind in _PICKLES.items():
            if data.startswith(start):
                raise MismatchError(
                    f"{name} is {kind}; loading it could run code, so it is never opened; give a .safetensors file"
                )
        raise _damaged(name, f"its header would have {length} bytes, the limit is {MAX_HEADER_BYTES}")
    if length > available:
        raise _damaged(name, f"its header promises {length} bytes, {max(0, available)} are left")
    try:
        header = json.loads(data[_LENGTH_BYTES : _LENGTH_BYTES + length])
        ends = [int(item["data_offsets"][1]) for key, item in header.items() if key != "__metadata__"]
    except Exception as error:
        raise _damaged(name, f"its header cannot be read, {reason(error)}") from error
    if max(ends, default=0) != available - length:
        raise _damaged(
            name, f"its header promises {max(ends, default=0)} bytes of weights, it has {available - length}"
        )
    return dict(header)
