"""YAML in, by the YAML 1.2 core rules.

PyYAML's own rules (YAML 1.1) take ``1e6`` for a string, ``010`` for 8, ``no``
for False and ``12:30`` for 750; and they let the last of two equal keys win.
"""

import re
from pathlib import Path
from typing import Any

import yaml

from warp_caustics.errors import InputError
from warp_caustics.io.atomic import read_text

MAX_YAML_BYTES = 1_000_000
MAX_DIGITS = 300
"""A float holds 309 before the point."""
_LONG_NUMBER = re.compile(r"(?<![0-9A-Za-z#.])[0-9]{301,}(?![A-Za-z#])")


class _Loader(yaml.SafeLoader):
    """YAML 1.2 core schema; refuses duplicate keys and aliases."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        tag = getattr(self.peek_event(), "tag", None)  # type: ignore[no-untyped-call]
        if tag is not None:
            mark, shown = self.get_mark(), tag.replace("tag:yaml.org,2002:", "!!")[:40]
            raise yaml.constructor.ConstructorError(None, None, f"tags ({shown}) are not read; leave it out", mark)
        if self.check_event(yaml.AliasEvent):
            mark = self.get_mark()
            raise yaml.constructor.ConstructorError(None, None, "aliases (*name) are not read; write it out", mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(None, None, "a key must be a word", key_node.start_mark)
            if key_node.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key_node.value!r} is given twice; remove one", key_node.start_mark
                )
            seen.add(key_node.value)
        return super().construct_mapping(node, deep=deep)


_Loader.yaml_implicit_resolvers = {}
# YAML 1.2.2, section 10.3.2.
for _tag, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", [*"~nN", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", [*"tTfF"]),
    ("int", r"[-+]?(?:0|[1-9][0-9]*)", [*"-+0123456789"]),
    ("float", r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?", [*"-+.0123456789"]),
    ("float", r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)", [*"-+."]),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), _first)


def parsed_yaml(text: str, name: str) -> Any:
    """What a YAML text holds; InputError says where it is wrong."""
    if len(text) > MAX_YAML_BYTES:
        raise InputError(f"{name} has more than {MAX_YAML_BYTES} characters; give a shorter file")
    # In the message of a Python int the limit is called set_int_max_str_digits.
    long = _LONG_NUMBER.search(text)
    if long is not None:
        raise InputError(f"{name}: {long[0][:12]}... has more than {MAX_DIGITS} digits; give a number of this world")
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f" line {mark.line + 1}" if mark is not None and "\n" in text.strip() else ""
        raise InputError(f"{name}{where}: {error.problem or error.context}") from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise InputError(f"{name} is no YAML ({' '.join(str(error).split())[:120]})") from error


def read_yaml(path: Path, example: str = "scene: {image_pixels: 256}") -> dict[str, Any]:
    """Content of a YAML file, a mapping; InputError says what is wrong with it, and what it might hold instead."""
    tree = parsed_yaml(read_text(path, MAX_YAML_BYTES), str(path))
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise InputError(f"{path} holds no keys with values; write for example '{example}'")
    return tree
