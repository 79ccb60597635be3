"""Checkpoints of a run, for continuing it: whole or absent, checked when read, never unpickled beyond tensors.

A file is what ``torch.save`` writes, followed by its SHA-256: the zip that torch
writes is read without checking its content. ``last.ckpt`` is the newest state,
``previous.ckpt`` the one before, ``best.ckpt`` the weights of the best validation.
"""

import hashlib
import io
import os
from pathlib import Path
from typing import Any

import torch

from warp_caustics.errors import DamagedDataError, InputError
from warp_caustics.io.atomic import atomic_path, regular_file
from warp_caustics.io.durable import sweep
from warp_caustics.io.regular import read_regular

LAST, PREVIOUS, BEST = "last.ckpt", "previous.ckpt", "best.ckpt"
LINK = f".{PREVIOUS}.new"
"""For a moment another name of the checkpoint before."""
DIGEST_BYTES = 32
MAX_BYTES = 20_000_000_000
"""The largest network with optimiser and average takes four times its weights."""


def save_checkpoint(folder: Path, state: dict[str, Any]) -> None:
    """Write ``last.ckpt``; the one before becomes ``previous.ckpt``.

    Args:
        folder: of the checkpoints; exists.
        state: tensors and plain types.
    """
    with atomic_path(folder / LAST) as temporary:
        _write(temporary, state)
        # A crash after this leaves the state before under both names.
        if (folder / LAST).exists():
            link = folder / LINK
            link.unlink(missing_ok=True)
            os.link(folder / LAST, link)
            os.replace(link, folder / PREVIOUS)


def save_best(folder: Path, state: dict[str, Any]) -> None:
    """Write ``best.ckpt``."""
    with atomic_path(folder / BEST) as temporary:
        _write(temporary, state)


def remove_unfinished(folder: Path) -> None:
    """Remove what a killed process had not finished writing; a checkpoint may take hundreds of megabytes."""
    sweep(folder)
    (folder / LINK).unlink(missing_ok=True)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """The state in a checkpoint, on the CPU.

    Raises:
        InputError: no such file.
        DamagedDataError: its content is not what was written.
    """
    content = read_regular(regular_file(path), MAX_BYTES)
    payload, digest = content[:-DIGEST_BYTES], content[-DIGEST_BYTES:]
    if hashlib.sha256(payload).digest() != digest:
        raise DamagedDataError(f"checkpoint {str(path)!r} is damaged (checksum); use another one")
    try:
        # Always spelled out: an environment variable can turn torch's default to unsafe.
        state: dict[str, Any] = torch.load(io.BytesIO(payload), map_location="cpu", weights_only=True)
    except Exception as error:
        name = type(error).__name__
        raise DamagedDataError(f"checkpoint {str(path)!r} cannot be read ({name}); use another one") from error
    if not isinstance(state, dict):
        raise DamagedDataError(f"checkpoint {str(path)!r} holds {type(state).__name__}, no state; use another one")
    return state


def has_checkpoint(folder: Path) -> bool:
    """Whether there is anything to continue from."""
    return any((folder / name).exists() for name in (LAST, PREVIOUS))


def newest_checkpoint(folder: Path) -> tuple[dict[str, Any], str | None]:
    """The newest state that can be read, and a warning where that is not the last one.

    Raises:
        InputError: there is none.
        DamagedDataError: none can be read.
    """
    problem: str | None = None
    for name in (LAST, PREVIOUS):
        if not (folder / name).exists():
            continue
        try:
            return load_checkpoint(folder / name), problem
        except DamagedDataError as error:
            problem = f"{error}; continuing from {PREVIOUS}"
    if problem is not None:
        raise DamagedDataError(f"no checkpoint in {str(folder)!r} can be read; train again with --force")
    raise InputError(f"{str(folder)!r} holds no checkpoint to resume from; leave out --resume and give --force")


def _write(path: Path, state: dict[str, Any]) -> None:
    buffer = io.BytesIO()
    torch.save(state, buffer)
    content = buffer.getbuffer()
    with open(path, "wb") as file:
        file.write(content)
        file.write(hashlib.sha256(content).digest())
