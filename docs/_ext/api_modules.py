"""``{api-modules} PACKAGE`` on a line of its own: every module of a package with its public names.

Packages below it have pages of their own. Modules whose name begins with an
underscore are left out, and so are Warp kernels, which Python cannot describe.
"""

import pkgutil
import re
from importlib import import_module
from typing import Any

from pydantic import BaseModel
from sphinx.application import Sphinx
from sphinx.util import logging

logger = logging.getLogger(__name__)
LINE = re.compile(r"^\{api-modules\} ([\w.]+)$", re.M)


def modules_of(package: str) -> list[str]:
    """The package, where it says more than its name, and the modules directly in it."""
    found = import_module(package)
    names = [m.name for m in pkgutil.iter_modules(found.__path__) if not m.ispkg and not m.name.startswith("_")]
    return [f"{package}.{name}" for name in names]


def markdown_of(package: str) -> str:
    """One section per module."""
    section = "## `{0}`\n\n```{{eval-rst}}\n.. automodule:: {0}\n```\n"
    return "\n".join(section.format(name) for name in modules_of(package))


def _replace(app: Sphinx, docname: str, source: list[str]) -> None:
    def sections(match: re.Match[str]) -> str:
        try:
            return markdown_of(match[1])
        except ImportError as error:
            logger.warning("%s cannot be described: %s", match[1], error, location=docname)
            return ""

    source[0] = LINE.sub(sections, source[0])


def _signature(app: Sphinx, what: str, name: str, obj: Any, *_: Any) -> tuple[str, None] | None:
    # Fields follow one by one; pydantic's signature repeats them with all their checks.
    return ("", None) if isinstance(obj, type) and issubclass(obj, BaseModel) else None


def _skip(app: Sphinx, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    return True if name.startswith("model_") else None


def _literal_marks(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    # Docstrings write |r|, [*, n] and np.bool_, which are marks of reStructuredText.
    for i, line in enumerate(lines):
        parts = line.split("``")
        parts[::2] = [re.sub(r"(?<!\\)([|*]|(?<=\w)_(?!\w))", r"\\\1", part) for part in parts[::2]]
        lines[i] = "``".join(parts)


def _literal_types(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    # Types of attributes, such as np.bool_, are put in by napoleon as they are.
    for i, line in enumerate(lines):
        if line.lstrip().startswith(":vartype"):
            lines[i] = re.sub(r"(?<=\w)_(?!\w)", r"\\_", line)


def setup(app: Sphinx) -> dict[str, bool]:
    """Fills in the marked lines."""
    app.connect("source-read", _replace)
    app.connect("autodoc-process-signature", _signature)
    app.connect("autodoc-skip-member", _skip)
    # Before napoleon, which adds marks of its own.
    app.connect("autodoc-process-docstring", _literal_marks, priority=400)
    app.connect("autodoc-process-docstring", _literal_types, priority=600)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
