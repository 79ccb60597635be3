"""``{api-modules} PACKAGE`` on a line of its own: every module of a package with its public names.

Packages below it have pages of their own. Modules whose name begins with an
underscore are left out, and so are Warp kernels, which Python cannot describe.

``{front-door} PACKAGE`` becomes a table of the names in the package's
``__all__``, each with the first sentence of its docstring and a link to the
module that defines it.
"""

import inspect
import pkgutil
import re
from importlib import import_module
from typing import Any

from pydantic import BaseModel
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer
from sphinx.util import logging

logger = logging.getLogger(__name__)
LINE = re.compile(r"^\{api-modules\} ([\w.]+)$", re.M)
DOOR = re.compile(r"^\{front-door\} ([\w.]+)$", re.M)


def modules_of(package: str) -> list[str]:
    """The package, where it says more than its name, and the modules directly in it."""
    found = import_module(package)
    names = [m.name for m in pkgutil.iter_modules(found.__path__) if not m.ispkg and not m.name.startswith("_")]
    return [f"{package}.{name}" for name in names]


def markdown_of(package: str) -> str:
    """One section per module."""
    section = "## `{0}`\n\n```{{eval-rst}}\n.. automodule:: {0}\n```\n"
    return "\n".join(section.format(name) for name in modules_of(package))


def home_of(package: str, name: str) -> str:
    """The module that defines a public name of a package."""
    homes: dict[str, str] = import_module(package)._HOMES
    return homes[name]


def first_sentence(package: str, name: str) -> str:
    """What a public name is, by its docstring; empty where it has none."""
    public = getattr(import_module(package), name)
    if inspect.isclass(public) or inspect.isroutine(public):
        # Not that of a parent class.
        text = inspect.cleandoc(public.__doc__ or "")
    else:
        text = "\n".join(ModuleAnalyzer.for_module(home_of(package, name)).find_attr_docs().get(("", name), []))
    paragraph = " ".join(text.split("\n\n")[0].split())
    sentence = re.split(r"(?<=[.]) (?=[A-Z])", paragraph)[0].rstrip(".")
    return re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", sentence.replace("``", "`")).replace("|", "\\|")


def table_of(package: str) -> str:
    """The public names of a package as Markdown: classes, functions and constants as they are sorted there."""
    rows = []
    for name in import_module(package).__all__:
        home = home_of(package, name)
        rows.append(f"| {{py:obj}}`{name} <{home}.{name}>` | {first_sentence(package, name)} | `{home}` |")
    return "\n".join(["| name | what it is | defined in |", "|---|---|---|", *rows, ""])


def _replace(app: Sphinx, docname: str, source: list[str]) -> None:
    def sections(match: re.Match[str]) -> str:
        try:
            return markdown_of(match[1])
        except ImportError as error:
            logger.warning("%s cannot be described: %s", match[1], error, location=docname)
            return ""

    source[0] = DOOR.sub(lambda match: table_of(match[1]), LINE.sub(sections, source[0]))


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
