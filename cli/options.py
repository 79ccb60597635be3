"""Options that several commands share."""

import math
import re
from collections.abc import Callable
from typing import Any, TypeVar

import rich_click as click

from warp_caustics.determinism import make_deterministic
from warp_caustics.units import length_m

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


def count(text: str) -> int:
    """Option type: whole number from 1 on."""
    value = integer(text)
    if value < 1:
        raise click.BadParameter(f"{text!r} is not at least 1")
    return value


def seconds(text: str) -> float:
    """Option type: time [s] above 0."""
    value = number(text)
    if value <= 0:
        raise click.BadParameter(f"{text!r} s is no time; write for example 60")
    return value


MAX_PLATE_LENGTH_M = 1.0


def length(text: str) -> float:
    """Option type: length [m] as ``0.1m``, ``100mm``, ``250um``, ``25nm`` or a plain number of metres."""
    value = length_m(text)
    if value is None:
        try:
            value = number(text)
        except click.BadParameter:
            raise click.BadParameter(f"{text!r} is no length; write 50um, 0.1m or 5e-5 (metres)") from None
    if not math.isfinite(value):
        raise click.BadParameter(f"{text!r} is not a finite number")
    return value


def plate_length(text: str) -> float:
    """Option type: length [m] on a plate, from 0 to below a metre."""
    value = length(text)
    if not 0 <= value < MAX_PLATE_LENGTH_M:
        raise click.BadParameter(
            f"{text!r} is {value:g} m, not between 0 and {MAX_PLATE_LENGTH_M:g} m; give a unit such as um"
        )
    return value


def named_number(text: str, option: str) -> tuple[str, float]:
    """A number of a set-up from NAME=NUMBER, in SI units; lengths (``..._m``) with a unit, too: ``gap_m=5um``.

    Args:
        text: as it was given.
        option: in which, for the message.
    """
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals:
        raise click.BadParameter(f"{text!r} is not NAME=NUMBER; write for example gap_m=5um", param_hint=option)
    is_length = name.endswith("_m") and not name.endswith("_per_m")
    try:
        return name, length(value) if is_length else number(value)
    except click.BadParameter as error:
        raise click.BadParameter(f"{name}: {error.message}", param_hint=option) from None


UNITS_S = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}


def duration(text: str) -> float:
    """Option type: time such as 90s, 8m, 1.5h or 2d; without a unit, seconds."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smhd]?)", text.strip())
    if match is None or float(match[1]) == 0:
        raise click.BadParameter(f"{text!r} is no time; write for example 90s, 8m or 1.5h")
    return float(match[1]) * UNITS_S[match[2]]


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


def bench_option(command: Command) -> Command:
    """Adds --bench: scene and camera as they were calibrated; the command gets the file's path, ``bench``."""
    option = click.option(
        "--bench",
        type=click.Path(),
        help="bench.yaml of nsfc calibrate: the scene is that of the bench; --set wins over it.",
    )
    return option(command)


def device_option(command: Command) -> Command:
    """Adds --device, and --deterministic, of which a command learns nothing: it holds for the whole process."""
    text = "Results on a GPU are the same to the last bit every time, at a price; on a CPU they always are."
    command = click.option("--deterministic", is_flag=True, expose_value=False, callback=_repeat, help=text)(command)
    text = "cpu, cuda or cuda:N; auto takes cuda where there is one."
    return click.option("--device", default="auto", show_default=True, help=text)(command)


def _repeat(_context: click.Context, _option: click.Parameter, is_wanted: bool) -> None:
    make_deterministic(is_wanted)


def seed_option(command: Command) -> Command:
    """Adds --seed."""
    option = click.option("--seed", type=integer, help="Selects the set of random photons; no effect on a lattice.")
    return option(command)


def jobs_option(command: Command) -> Command:
    """Adds --jobs."""
    text = "Processes; all GPUs take part unless --device names one. Times are longer with several."
    return click.option("--jobs", type=integer, default=1, show_default=True, help=text)(command)


def json_option(command: Command) -> Command:
    """Adds --json."""
    option = click.option("--json", "as_json", is_flag=True, help="Print one JSON record on stdout, nothing else.")
    return option(command)
