"""Configurations as trees of sections: one put over another, and a value of --set as a tree.

A key that is not known is refused with a guess at the one that was meant.
"""

import difflib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from data_gen.bench_ranges import BenchRanges
from data_gen.config import PATTERN_CONFIGS
from data_gen.making import Making
from data_gen.variety import PrintVariety
from warp_caustics.errors import InputError, known_names, shortened
from warp_caustics.io.yaml_file import parsed_yaml
from warp_caustics.strict import Strict


def parsed_setting(setting: str) -> dict[str, Any]:
    """A --set value as nested sections: ``a.b=1`` is ``{"a": {"b": 1}}``."""
    key, equals, value = setting.partition("=")
    parts = key.strip().split(".")
    if not equals or not all(parts):
        raise InputError(
            f"--set {shortened(setting)!r} is not KEY=VALUE; write for example --set scene.image_pixels=256"
        )
    return nested(parts, parsed_yaml(value, f"--set {shortened(setting)}"))


def nested(parts: Sequence[str], value: Any) -> dict[str, Any]:
    """A value below sections of these names."""
    for part in reversed(parts):
        value = {part: value}
    nested: dict[str, Any] = value
    return nested


def _training_camera() -> Strict:
    from nets.training.config import CameraConfig  # brings torch

    return CameraConfig()


_MAY_BE_OFF: dict[str, Callable[[], Strict]] = {
    "reliefs.variety": PrintVariety,
    "reliefs.making": Making,
    "data.bench": BenchRanges,
    "training.bench": BenchRanges,
    "training.camera": _training_camera,
}
"""Sections that null switches off; no other can be off, so null there is refused."""


def merged(base: dict[str, Any], over: dict[str, Any], source: str, at: str = "") -> dict[str, Any]:
    """Values of ``over`` in place of those of ``base``, section by section; other keys than base's are refused."""
    if at == "reliefs." and over.get("pattern", base["pattern"]) != base["pattern"]:
        base = _pattern_defaults(over["pattern"], source)
    result = dict(base)
    # Options belong to a method, which alone knows their names.
    is_open = at.startswith("reconstruction.options.")
    for key, value in over.items():
        optional = _MAY_BE_OFF.get(f"{at}{key}") if key in base else None
        if optional is not None and value is None:
            result[key] = None
            continue
        if optional is not None and base[key] is None and isinstance(value, dict):
            # A section that is off is switched on by any of its keys.
            base = {**base, key: optional().model_dump(mode="json")}
        if key not in base and not is_open:
            meant = guess(str(key), base) or f"known are {', '.join(base)}"
            raise InputError(f"{source}{at}{shortened(str(key))}: unknown key; {meant}")
        if not isinstance(base.get(key), dict):
            if isinstance(value, dict) and not is_open:
                raise InputError(f"{source}{at}{key} has no keys of its own; give its value")
            result[key] = value
        elif isinstance(value, dict):
            result[key] = merged(base[key], value, source, f"{at}{key}.")
        elif is_open:
            result[key] = value
        elif value is None:
            raise InputError(_null_section(f"{at}{key}", base[key], source))
        else:
            raise InputError(f"{source}{at}{key} is a section; give keys below it, got {shortened(repr(value))}")
    return result


def refuse_null_sections(tree: Mapping[str, Any], base: Mapping[str, Any], source: str, at: str = "") -> None:
    """Refuse null where ``base`` has a section that cannot be off; for trees that are changed before they are merged.

    Raises:
        InputError: such a section; what else may be wrong is left to :func:`merged`.
    """
    for key, value in tree.items():
        section = base.get(key)
        if not isinstance(section, dict) or f"{at}{key}" in _MAY_BE_OFF:
            continue
        if value is None:
            raise InputError(_null_section(f"{at}{key}", section, source))
        if isinstance(value, dict):
            refuse_null_sections(value, section, source, f"{at}{key}.")


def _null_section(name: str, section: Mapping[str, Any], source: str) -> str:
    example = next(iter(section), None)
    keys = "give {} for none" if example is None else f"give keys below it, as {name}.{example}"
    return (
        f"{source}{name} is null; of sections only {', '.join(_MAY_BE_OFF)} can be off: leave it out for its defaults, "
        f"or {keys}"
    )


def _pattern_defaults(name: Any, source: str) -> dict[str, Any]:
    """Another print pattern has other keys."""
    if not isinstance(name, str) or name not in PATTERN_CONFIGS:
        raise InputError(
            f"{source}reliefs.pattern {shortened(repr(name))} is not known; {known_names(str(name), PATTERN_CONFIGS)}"
        )
    return PATTERN_CONFIGS[name]().model_dump(mode="json")


def guess(word: str, known: Mapping[str, Any]) -> str:
    """A question after the known word that is nearest; nothing where none is near."""
    close = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {close[0]!r}?" if close else ""
