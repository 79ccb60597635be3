"""Front doors of packages: public names that are imported on first use, so that importing the package stays cheap."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def front_door(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """A package's ``__getattr__``, which also knows ``__version__``.

    Args:
        package: its ``__name__``.
        homes: module in which each public name is defined.
    """

    def found(name: str) -> Any:
        if name in homes:
            return getattr(import_module(homes[name]), name)
        if name == "__version__":
            return _version()
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return found


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("nsfc")
    except PackageNotFoundError:
        return "unknown: not installed, pip install ."
