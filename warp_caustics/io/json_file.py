"""Records as JSON files."""

import json
import math
from collections.abc import Mapping
from typing import Any

from warp_caustics.io.atomic import PathLike, write_text


def write_json(path: PathLike, record: Mapping[str, Any]) -> None:
    """Write a record, complete or not at all; errors as of :func:`warp_caustics.io.atomic.atomic_path`."""
    write_text(path, json_text(record) + "\n")


def json_text(record: Mapping[str, Any]) -> str:
    """A record as JSON; arrays become lists and NaN null, because JSON has neither."""
    return json.dumps(plain(record), indent=2, allow_nan=False)


def plain(value: Any) -> Any:
    """The same value in types that JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy arrays and scalars
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)
