"""Which channel of an image is which wavelength of the scene."""

from collections.abc import Sequence

from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.image_file import ImageFile

WAVELENGTH_TOLERANCE_M = 1e-9
"""Lamps and filters are named in whole nanometres."""


def in_nm(wavelengths_m: Sequence[float]) -> str:
    """Wavelengths [m] as text in nanometres."""
    return ", ".join(f"{wavelength * 1e9:.6g}" for wavelength in wavelengths_m) + " nm"


def _requested_wavelengths_m(order: str | Sequence[float]) -> tuple[float, ...]:
    """Wavelengths [m] of "610,530,430" in nm, or of a sequence in metres."""
    try:
        if isinstance(order, str):
            values = tuple(float(part.strip().removesuffix("nm")) * 1e-9 for part in order.split(","))
        else:
            values = tuple(float(value) for value in order)
    except (TypeError, ValueError) as error:
        raise InputError(f"wavelength order {order!r} is not readable; write for example 610,530,430 (nm)") from error
    if not all(1e-7 < value < 1e-5 for value in values):
        unit = "nanometres as text" if isinstance(order, str) else "metres (610e-9), or nanometres as text"
        raise InputError(f"wavelength order {order!r} is no light; give {unit}, for example '610,530,430'")
    return values


def _match(file_m: Sequence[float], scene_m: Sequence[float], source: str) -> list[int]:
    """For each wavelength of the scene its channel in the file."""
    order = []
    for wanted in scene_m:
        nearest = min(range(len(file_m)), key=lambda channel: abs(file_m[channel] - wanted))
        if abs(file_m[nearest] - wanted) > WAVELENGTH_TOLERANCE_M:
            raise MismatchError(
                f"{source}: {in_nm(file_m)}, but the scene has {in_nm(scene_m)}; use the scene's wavelengths, "
                "give --wavelength-order or set scene.wavelengths_m"
            )
        order.append(nearest)
    if len(set(order)) != len(order):
        raise MismatchError(f"{source}: {in_nm(file_m)} repeat or lie too close together; give each channel once")
    return order


def check_channel_count(count: int, scene_m: Sequence[float], requested: str | Sequence[float] | None) -> None:
    """Refuse an image whose channels cannot be those of a scene, known from its header alone.

    Args:
        count: channels of the image.
        scene_m: wavelengths of the scene [m].
        requested: wavelength order as of :func:`channel_order`.

    Raises:
        MismatchError: another number of channels than the scene has wavelengths.
        InputError: a request that cannot be used.
    """
    if requested is not None:
        named = len(_requested_wavelengths_m(requested))
        if named != count:
            raise InputError(f"--wavelength-order names {named} channels, the image has {count}; name each once")
    if count == len(scene_m):
        return
    if count == 1:
        middle = sorted(scene_m)[len(scene_m) // 2]
        fix = (
            "for a monochrome camera set the wavelength of its light: "
            f"--set scene.wavelengths_m=[{in_nm([middle]).replace(' ', '')}] --set scene.radiosity_W_m2=[1]"
        )
    else:
        fix = "give an image with one channel per wavelength, or set scene.wavelengths_m and scene.radiosity_W_m2"
        if count > len(scene_m):
            fix += "; of a colour camera whose channels all saw this light: --mixing FILE, a row of it for each channel"
    has, sees = _counted(count, "channel"), _counted(len(scene_m), "wavelength")
    raise MismatchError(f"the image has {has}, the scene {sees}; {fix}")


def _counted(count: int, word: str) -> str:
    return f"{count} {word}" if count == 1 else f"{count} {word}s"


def channel_order(
    image: ImageFile, scene_m: Sequence[float], requested: str | Sequence[float] | None
) -> tuple[list[int], str]:
    """For each wavelength of the scene [m] its channel in the image, and one line on how that was decided.

    Raises:
        MismatchError: the channels are not those of the scene.
        InputError: a request that cannot be used, or nothing tells which channel is which.
    """
    count = len(image.values)
    check_channel_count(count, scene_m, requested)
    if requested is not None:
        file_m = _requested_wavelengths_m(requested)
        return _match(file_m, scene_m, "wavelength order"), f"channels are {in_nm(file_m)}, as requested"
    if image.wavelengths_m is not None:
        recorded = image.wavelengths_m
        return _match(recorded, scene_m, "the file records"), f"channels are {in_nm(recorded)}, as the file records"
    falling = sorted(scene_m, reverse=True)
    if list(scene_m) == falling or (count == 3 and image.format in ("png", "tiff", "exr", "jpeg")):
        return _match(falling, scene_m, "channels"), f"channels taken as {in_nm(falling)}, longest wavelength first"
    raise InputError(
        f"which channel is which of {in_nm(scene_m)} is not recorded in the file; "
        f"give for example --wavelength-order {','.join(f'{value * 1e9:g}' for value in scene_m)}"
    )
