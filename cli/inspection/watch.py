"""A folder that is watched for new images."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field

from cli.inputs import SUFFIXES
from cli.inspection.plates import Stamp, stamp


@dataclass
class Watcher:
    """Finds files that are complete: of the same size and time at two looks in a row, and not empty.

    Attributes:
        folder: whose images are looked for, not those of folders within.
        is_done: tells whether an image was dealt with before.
    """

    folder: str
    is_done: Callable[[str], bool]
    _seen: dict[str, Stamp] = field(default_factory=dict)
    _handed: dict[str, Stamp] = field(default_factory=dict)

    def look(self) -> list[str]:
        """Paths of images that are new and complete, oldest first; each version of a file once."""
        now: dict[str, Stamp] = {}
        for name in os.listdir(self.folder):
            # Writers fill hidden files first and rename them.
            if name.startswith(".") or not name.lower().endswith(SUFFIXES):
                continue
            path = os.path.join(self.folder, name)
            try:
                if os.path.isfile(path):
                    now[path] = stamp(path)
            except OSError:
                continue  # gone again
        ready = [
            path
            for path, found in now.items()
            if found.size > 0 and self._seen.get(path) == found and self._handed.get(path) != found
        ]
        self._seen = now
        fresh = []
        for path in sorted(ready, key=lambda path: (now[path].mtime_ns, path)):
            self._handed[path] = now[path]
            try:
                if not self.is_done(path):
                    fresh.append(path)
            except OSError:
                continue
        return fresh
