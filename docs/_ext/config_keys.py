"""``{config-keys} MODULE:MODEL PREFIX`` on a line of its own: a table of a configuration's keys, from the code."""

import inspect
import re
from importlib import import_module
from typing import Any

from annotated_types import Ge, Gt, Interval, Le, Lt
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined
from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

LINE = re.compile(r"^\{config-keys\} ([\w.]+):(\w+)(?: ([\w.]+))?$", re.M)
HEAD = "| key | default | meaning |\n|---|---|---|\n"


def table(model: type[BaseModel], prefix: str = "") -> str:
    """All keys of a model and of the models in it, one row each, as Markdown."""
    return HEAD + "\n".join(_rows(model, prefix, None)) + "\n"


def _rows(model: type[BaseModel], prefix: str, values: BaseModel | None) -> list[str]:
    rows = []
    for name, field in model.model_fields.items():
        key = f"{prefix}.{name}" if prefix else name
        # What the section above gives this one, such as a network's numbers, goes before the class's own default.
        default = getattr(values, name) if values is not None else field.get_default(call_default_factory=False)
        inner = type(default) if isinstance(default, BaseModel) else field.annotation
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            rows += _rows(inner, key, default if isinstance(default, BaseModel) else None)
        else:
            limits = f"; {_limits(field)}" if _limits(field) else ""
            cells = (f"`{key}`", _default(default, field), f"{meaning(model, name).rstrip('.')}{limits}".lstrip("; "))
            rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return rows


def meaning(model: type[BaseModel], name: str) -> str:
    """What a field's description or docstring says, from the class that declares it."""
    if model.model_fields[name].description:
        return str(model.model_fields[name].description)
    for owner in inspect.getmro(model):
        if name in inspect.get_annotations(owner):
            found = ModuleAnalyzer.for_module(owner.__module__).find_attr_docs().get((owner.__qualname__, name))
            if found:
                return " ".join(found).strip().replace("``", "`")
    return ""


def _default(value: Any, field: FieldInfo) -> str:
    if value is PydanticUndefined or (value is None and field.default_factory):
        return "by kind" if field.default_factory else "required"
    return f"`{_plain(value)}`"


def _plain(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_plain, value)) + "]"
    if isinstance(value, BaseModel):
        return "{" + ", ".join(f"{key}: {_plain(inner)}" for key, inner in value) + "}"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _limits(field: FieldInfo) -> str:
    """Bounds and choices of a field's type, those of optional values included."""
    text = str(field.annotation)
    choices = re.search(r"Literal\[([^\]]*)\]", text)
    if choices:
        return choices[1].replace("'", "`")
    marks = [*field.metadata, *_inner_marks(field.annotation)]
    bounds = {}
    for mark in marks:
        for kind, sign in ((Ge, ">="), (Gt, ">"), (Le, "<="), (Lt, "<")):
            if isinstance(mark, kind):
                bounds[sign] = getattr(mark, {">=": "ge", ">": "gt", "<=": "le", "<": "lt"}[sign])
    return ", ".join(f"{sign} {_plain(value)}" for sign, value in bounds.items())


def _inner_marks(annotation: Any) -> list[Any]:
    """What ``Annotated`` types within a union or tuple say."""
    found: list[Any] = []
    for argument in getattr(annotation, "__args__", ()):
        for mark in getattr(argument, "__metadata__", ()):
            found += mark.metadata if isinstance(mark, FieldInfo) else [mark]
        if not hasattr(argument, "__metadata__"):
            found += _inner_marks(argument)
    return [mark for mark in found if not isinstance(mark, Interval)]


def _replace(app: Sphinx, docname: str, source: list[str]) -> None:
    source[0] = LINE.sub(lambda m: table(getattr(import_module(m[1]), m[2]), m[3] or ""), source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Fills in the marked lines."""
    app.connect("source-read", _replace)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
