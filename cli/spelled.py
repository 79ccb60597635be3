"""Where a wrong value of a configuration stands, as a person wrote it: a key of a file, or an option."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import click


def spelled_in(
    sources: Sequence[tuple[str, Mapping[str, Any]]], overrides: Mapping[str, Any] | None = None
) -> Callable[[str], str]:
    """What a dotted key is called in messages.

    Args:
        sources: name of a file, and its keys, in the order in which they are read: the last one that has a key wins.
            A name of "" tells the key alone, as --set has it.
        overrides: dotted key to value, from options of the command that runs; None was not given. They win.
    """

    def spelled(path: str) -> str:
        for key, value in (overrides or {}).items():
            if value is not None and f"{path}.".startswith(f"{key}."):
                return _option_of(key) or path
        name = next((name for name, tree in reversed(sources) if _has(tree, path.split("."))), "")
        return f"{name}: {path}" if name else path

    return spelled


def _option_of(key: str) -> str | None:
    """The option of the command that runs that has the key's name."""
    context = click.get_current_context(silent=True)
    if context is None:
        return None
    word = "--" + key.rpartition(".")[2].replace("_", "-")
    return word if any(word in parameter.opts for parameter in context.command.params) else None


def _has(tree: Any, parts: Sequence[str]) -> bool:
    """Whether a tree says something of a place: it has all its keys, or a value above them."""
    for part in parts:
        if not isinstance(tree, Mapping):
            return True
        if part not in tree:
            return False
        tree = tree[part]
    return True
