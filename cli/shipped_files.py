"""Configurations, ranges of benches and cameras that come with the software, by name."""

from collections.abc import Mapping
from pathlib import Path

from cli.config_sections import guess
from warp_caustics.errors import InputError, known_names
from warp_caustics.io.atomic import regular_file


def config_folder() -> Path:
    """Folder of the configurations that come with the software."""
    here = Path(__file__).parent
    # Inside the package when installed from a wheel, beside it in a checkout.
    return next((f for f in (here / "configs", here.parent / "configs") if f.is_dir()), here)


def shipped_configs() -> dict[str, Path]:
    """Configurations that come with the software, by name."""
    return {path.stem: path for path in sorted(config_folder().glob("*.yaml"))}


def config_path(source: str) -> Path:
    """File of a --config value: a bare name means a shipped configuration, anything else a path."""
    if "/" in source or "." in source:
        return regular_file(source)
    shipped = shipped_configs()
    if source not in shipped:
        meant = guess(source, shipped) or f"use one of {', '.join(shipped)}, or a file such as ./{source}.yaml"
        raise InputError(f"configuration {source!r} is not shipped; {meant}")
    return shipped[source]


def shipped_benches() -> dict[str, Path]:
    """Ranges of benches that come with the software, by name."""
    return {path.stem: path for path in sorted((config_folder() / "benches").glob("*.yaml"))}


def bench_path(source: str) -> Path:
    """File of a --bench value: a bare name means shipped ranges, anything else a path."""
    return shipped_file(source, shipped_benches(), "bench") or regular_file(source)


def shipped_cameras() -> dict[str, Path]:
    """Cameras that come with the software, by name."""
    return {path.stem: path for path in sorted((config_folder() / "cameras").glob("*.yaml"))}


def shipped_file(source: str, shipped: Mapping[str, Path], kind: str) -> Path | None:
    """The shipped file of a bare name; None of what is a path.

    Raises:
        InputError: a name that is not shipped.
    """
    if "/" in source or "." in source:
        return None
    if source not in shipped:
        raise InputError(
            f"{kind} {source!r} is not shipped; {known_names(source, shipped)}, or give a file such as ./{source}.yaml"
        )
    return shipped[source]


def config_files(source: str | None) -> list[Path]:
    """The file of a --config value, where it is one of the user's."""
    return [] if source is None or source in shipped_configs() else [config_path(source)]
