"""Which methods are compared, as written on the command line.

    sfc                                     a method with its own defaults
    sfc:variant=landweber_wavelet,mask=oracle   with settings
    transport+refine                        the first gives the second its start

Commas separate methods; a piece that is only ``key=value`` belongs to the method before it.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from warp_caustics.errors import InputError

FLAT = "flat"
"""The guess that nothing was printed."""

ITERATED = ("refine", "sfc", "hcccd", "nsfc", "nsfc-unrolled")
"""Methods that are looked at after so many iterations: per level, step or outer iteration, as each counts."""

LIMIT = "max_iterations"
"""Their setting that limits iterations."""

CONVERGED, ONCE = "converged", "once"
"""Columns of a method's own stop, and of a method that does not iterate."""

_SETTING = re.compile(r"^\s*[A-Za-z_]\w*\s*=")


@dataclass(frozen=True)
class Stage:
    """One method with its settings."""

    name: str
    options: tuple[tuple[str, Any], ...] = ()

    @property
    def wants_truth(self) -> bool:
        """Whether a setting asks for what only the true relief can tell."""
        return any(value == "oracle" for _, value in self.options)


@dataclass(frozen=True)
class MethodSpec:
    """What is compared under one name; each stage starts where the one before ended."""

    label: str
    stages: tuple[Stage, ...]

    def budgets(self, wanted: Sequence[str]) -> tuple[str, ...]:
        """Columns of this method among those wanted (``"1"``, ``"converged"``): one if it has nothing to limit.

        The last stage is the one that is limited. A setting that already limits it leaves one column.
        """
        last = self.stages[-1]
        if last.name not in ITERATED or LIMIT in dict(last.options):
            return (ONCE,)
        return tuple(wanted)

    def limited(self, budget: str) -> "MethodSpec":
        """The same with the last stage stopped after a number of iterations."""
        if budget in (CONVERGED, ONCE):
            return self
        last = self.stages[-1]
        stage = Stage(last.name, (*last.options, (LIMIT, int(budget))))
        return MethodSpec(self.label, (*self.stages[:-1], stage))


def parse_methods(texts: Sequence[str]) -> tuple[MethodSpec, ...]:
    """Methods as given to --methods.

    Args:
        texts: values of the option, each a comma-separated list.

    Raises:
        InputError: nothing, a setting without a method, or a method twice.
    """
    labels: list[str] = []
    for text in texts:
        first = len(labels)
        for piece in filter(None, (part.strip() for part in text.split(","))):
            if not _SETTING.match(piece):
                labels.append(piece)
            elif len(labels) == first:
                raise InputError(f"--methods {text!r} begins with the setting {piece!r}; write METHOD:{piece}")
            else:
                labels[-1] += ("," if ":" in _split_stages(labels[-1])[-1] else ":") + piece
    if not labels:
        raise InputError("no method given; use for example --methods flat,transport,refine")
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(f"method {label!r} is given twice; leave one out")
    return tuple(MethodSpec(label, tuple(_stage(part, label) for part in _split_stages(label))) for label in labels)


def parse_budgets(text: str) -> tuple[str, ...]:
    """Columns as given to --iterations, in the order given.

    Raises:
        InputError: neither a whole number above 0 nor ``converged``, or one twice.
    """
    budgets = []
    for piece in filter(None, (part.strip() for part in text.split(","))):
        is_count = piece.isascii() and piece.isdigit() and int(piece) > 0
        if not is_count and piece != CONVERGED:
            raise InputError(f"--iterations {piece!r} is no whole number above 0 and not 'converged'")
        budgets.append(str(int(piece)) if is_count else piece)
    if not budgets or len(set(budgets)) < len(budgets):
        raise InputError(f"--iterations {text!r} names nothing or something twice; write for example 1,10,converged")
    return tuple(budgets)


def _split_stages(label: str) -> list[str]:
    # A plus sign before a digit belongs to a number.
    return re.split(r"\+(?=[A-Za-z])", label)


def _stage(text: str, label: str) -> Stage:
    name, _, rest = text.partition(":")
    if not name:
        raise InputError(f"method {label!r} has a stage without a name; write for example transport+refine")
    options: dict[str, Any] = {}
    for piece in filter(None, rest.split(",")):
        key, equals, value = (part.strip() for part in piece.partition("="))
        if not equals or not key or not value:
            raise InputError(f"method {label!r}: {piece!r} is not KEY=VALUE; write for example sfc:mask=oracle")
        if key in options:
            raise InputError(f"method {label!r} sets {key} twice; leave one out")
        options[key] = _value(value)
    if name == FLAT and options:
        raise InputError(f"method {label!r}: the flat guess has no settings; leave them out")
    return Stage(name, tuple(options.items()))


def _value(text: str) -> Any:
    """A number, true, false, none or text."""
    words = {"true": True, "false": False, "null": None}
    if text.lower() in words:
        return words[text.lower()]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
