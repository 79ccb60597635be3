"""Options that several commands share."""

import math
import re
from collections.abc import Callable
from typing import Any, TypeVar

import rich_click as click

Command = TypeVar("Command", bound=Callable[..., Any])


def number(text: str) -> float:
    """Option type: finite number. click's own FLOAT and FloatRange let nan and inf through."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise click.BadParameter(f"{text!r} is not a finite number")
    return value


def integer(text: str) -> int:
    """Option type: whole number, also written like 1e6."""
    try:
        return int(text)
    except ValueError:
        value = number(text)
    if not value.is_integer():
        raise click.BadParameter(f"{text!r} is not a whole number")
    return int(value)


UNITS_M = {"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}


def length(text: str) -> float:
    """Option type: length as ``0.1m``, ``100mm``, ``250um``, ``25nm`` or a plain number of metres; in metres."""
    found = re.fullmatch(r"\s*([-+.\deE]+?)\s*(nm|um|mm|cm|m)?\s*", text)
    if found is None:
        raise click.BadParameter(f"{text!r} is not a length; write for example 0.1m, 100mm or 250um")
    return number(found[1]) * UNITS_M[found[2] or "m"]


def config_options(command: Command) -> Command:
    """Adds --config and --set."""
    command = click.option(
        "--set",
        "settings",
        metavar="KEY=VALUE",
        multiple=True,
        help="Override one value of the configuration, e.g. scene.image_pixels=256; repeatable.",
    )(command)
    return click.option(
        "--config",
        "config_source",
        metavar="FILE|NAME",
        help="YAML file, or the name of a shipped configuration (paper, small). [default: Tab. 1 of the paper]",
    )(command)


def device_option(command: Command) -> Command:
    """Adds --device."""
    text = "cpu, cuda or cuda:N; auto takes cuda where there is one."
    return click.option("--device", default="auto", show_default=True, help=text)(command)


def seed_option(command: Command) -> Command:
    """Adds --seed."""
    option = click.option("--seed", type=integer, help="Selects the set of random photons; no effect on a lattice.")
    return option(command)


def json_option(command: Command) -> Command:
    """Adds --json."""
    option = click.option("--json", "as_json", is_flag=True, help="Print one JSON record on stdout, nothing else.")
    return option(command)
