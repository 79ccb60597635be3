"""What decides a result besides its inputs: the code."""

import hashlib
from functools import cache
from pathlib import Path

import nets
import warp_caustics

_OTHERS = ("evaluation", "search")
"""Folders that no reconstruction uses."""


@cache
def code_version() -> str:
    """Hash of all code and shipped weights that a reconstruction may use, the same on every machine."""
    digest = hashlib.sha256()
    for package in (warp_caustics, nets):
        (root,) = map(Path, package.__path__)
        for path in sorted((*root.rglob("*.py"), *root.rglob("*.safetensors"))):
            relative = path.relative_to(root)
            if relative.parts[0] not in _OTHERS:
                digest.update(f"{root.name}/{relative.as_posix()}\0".encode())
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()
