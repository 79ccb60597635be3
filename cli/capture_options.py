"""Options that say how a photo becomes irradiance, the same for every command that takes one.

A command takes them in two lines::

    @capture_options                 # the command receives ``capture``, what was given
    def command(image: str, capture: Mapping[str, Any], ...) -> int:
        settings = capture_settings(capture, image)
        result = read_capture(image, config.scene, settings)

with functions of :mod:`warp_caustics.capture.settings` and
:mod:`warp_caustics.capture.read`. IMAGE may be a capture file (.yaml), which
lists the frames of one view.
"""

import functools
from collections.abc import Callable
from typing import Any

import rich_click as click

from cli.options import Command, integer, number

_OPTIONS: tuple[Callable[[Any], Any], ...] = (
    click.option("--capture", type=click.Path(), help="YAML file with all that follows; options given here win."),
    click.option("--dark", type=click.Path(), help="Frame of the same camera with the light off."),
    click.option("--flat", type=click.Path(), help="Frame of the same camera with a plate without relief."),
    click.option(
        "--corners",
        metavar="FILE|auto",
        help="Where the plate's window lies in the photo: YAML or CSV with its corners or marks; auto finds the lit "
        "window. [default: the photo is the window]",
    ),
    click.option("--distortion", type=click.Path(), help="YAML file with the lens distortion (OpenCV's convention)."),
    click.option("--mixing", type=click.Path(), help="YAML or CSV matrix: camera channels from wavelengths."),
    click.option(
        "--mirrored",
        is_flag=True,
        default=None,
        help="The photo shows the screen from behind, left and right exchanged.",
    ),
    click.option(
        "--hot-pixels/--no-hot-pixels",
        default=None,
        help="Replace and mask pixels that lie. [default: with --corners or several exposures]",
    ),
    click.option(
        "--blur-px",
        type=number,
        metavar="NUMBER",
        help="Blur of lens and sensor, standard deviation in pixels of the scene's image, to be divided out.",
    ),
    click.option("--wavelength-order", metavar="NM,NM,...", help="Wavelength of each channel, e.g. 610,530,430."),
    click.option("--transfer", type=click.Choice(["linear", "srgb"]), help="Tone curve of an integer image."),
    click.option("--page", type=integer, help="Page of a TIFF with several, from 0."),
    click.option("--dataset", help="Array in an HDF5 or NPZ file. [default: image]"),
)
_NAMES = (
    "capture", "dark", "flat", "corners", "distortion", "mixing", "mirrored", "hot_pixels", "blur_px",
    "wavelength_order", "transfer", "page", "dataset",
)  # fmt: skip


def capture_options(command: Command) -> Command:
    """Adds --capture, --dark, --flat and all others; the command gets what was given as one mapping, ``capture``."""

    @functools.wraps(command)
    def collected(*args: Any, **values: Any) -> Any:
        options = {name: values.pop(name) for name in _NAMES}
        given = {name: value for name, value in options.items() if value is not None}
        return command(*args, capture=given, **values)

    wrapped: Any = collected
    for option in reversed(_OPTIONS):
        wrapped = option(wrapped)
    result: Command = wrapped
    return result
