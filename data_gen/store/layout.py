"""Names in a data set's folder, and the one way JSON is written there."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FORMAT_VERSION = 1
"""Raised whenever an older reader would misread the files."""

TEMPORARY_PREFIX = ".tmp-"


@dataclass(frozen=True)
class Layout:
    """Paths of a data set.

    Attributes:
        root: the data set's folder.
    """

    root: Path

    @property
    def config(self) -> Path:
        """Canonical JSON whose sha256 is the data set's fingerprint; written first, never changed."""
        return self.root / "config.json"

    @property
    def complete(self) -> Path:
        """Written last; its presence means finished."""
        return self.root / "COMPLETE.json"

    @property
    def index(self) -> Path:
        """Virtual view of all shards, for people."""
        return self.root / "index.h5"

    @property
    def lock(self) -> Path:
        return self.root / ".lock"

    @property
    def shards(self) -> Path:
        return self.root / "shards"

    def shard(self, shard: int) -> Path:
        return self.shards / f"{shard:05d}.h5"

    def manifest(self, shard: int) -> Path:
        return self.shards / f"{shard:05d}.json"


def canonical_json(tree: Any) -> bytes:
    """One spelling per content, so that hashes of it mean something."""
    return json.dumps(tree, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def sha256(data: bytes | memoryview) -> str:
    """Hash in hexadecimal."""
    return hashlib.sha256(data).hexdigest()
