"""EXR in and out, RGB, gray or spectral; needs the optional OpenEXR package."""

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from warp_caustics.errors import CausticsError, DamagedDataError, InputError
from warp_caustics.io.atomic import reason
from warp_caustics.io.decoded import Decoded, own_description, without_alpha
from warp_caustics.io.image_file import MAX_CHANNELS, FitsCheck, check_image
from warp_caustics.io.image_output import Output
from warp_caustics.native_words import native_words


def _openexr() -> Any:
    try:
        import OpenEXR
    except ImportError as error:
        raise InputError("EXR needs the OpenEXR package; install it with: pip install 'nsfc[exr]'") from error
    return OpenEXR


def _exr_wavelength_m(channel: str) -> float | None:
    """Wavelength [m] of a channel of the spectral EXR layout, such as S0.610,000000nm."""
    if not (channel.startswith("S0.") and channel.endswith("nm")):
        return None
    try:
        return float(channel[3:-2].replace(",", ".")) * 1e-9
    except ValueError:
        return None


def _exr_channel(wavelength_m: float) -> str:
    return f"S0.{wavelength_m * 1e9:.6f}nm".replace(".", ",").replace(",", ".", 1)


def _exr_order(channels: list[str], description: dict[str, Any], name: str) -> list[str]:
    """Channels in image order: as we recorded it, else R,G,B, else falling wavelength."""
    recorded = description.get("channels")
    if isinstance(recorded, list) and set(map(str, recorded)) == set(channels):
        return [str(channel) for channel in recorded]
    if set(channels) == {"R", "G", "B"}:
        return ["R", "G", "B"]
    if channels == ["Y"]:
        return channels
    wavelengths = {channel: _exr_wavelength_m(channel) for channel in channels}
    if channels and None not in wavelengths.values():
        order = sorted(channels, key=lambda channel: -(wavelengths[channel] or 0.0))
        description["wavelengths_m"] = [wavelengths[channel] for channel in order]
        return order
    raise InputError(f"{name} has channels {', '.join(channels)[:80]}; give R,G,B or Y or S0.<wavelength>nm")


def _check_exr_header(header: dict[str, Any], name: str, max_pixels: int, fits: FitsCheck | None) -> None:
    (x0, y0), (x1, y1) = (corner.tolist() for corner in header["dataWindow"])
    count = len(header["channels"]) - ("A" in {channel.name for channel in header["channels"]})
    if count > MAX_CHANNELS:
        raise InputError(f"{name} has {count} channels; at most {MAX_CHANNELS} are read")
    check_image(name, (max(1, count), y1 - y0 + 1, x1 - x0 + 1), max_pixels, fits)
    if any(np.any(a != b) for a, b in zip(header["dataWindow"], header["displayWindow"], strict=True)):
        raise InputError(f"{name}: EXR data window differs from its display window; crop it to the image")
    if any(channel.xSampling != 1 or channel.ySampling != 1 for channel in header["channels"]):
        raise InputError(f"{name} has subsampled channels; export all channels at full size")


def read_exr(path: Path, max_pixels: int, fits: FitsCheck | None = None) -> Decoded:
    """A flat EXR, [C, H, W] in its own type.

    Raises:
        InputError: a kind of EXR that loses or hides something, or no OpenEXR package.
        DamagedDataError: truncated or corrupt.
    """
    openexr = _openexr()
    name = repr(str(path))
    said: list[str] = []
    try:
        # The library reports damage on stdout and on standard error before it raises.
        with native_words() as said, contextlib.redirect_stdout(io.StringIO()):
            with openexr.File(str(path), separate_channels=True, header_only=True) as file:
                if len(file.parts) != 1 or file.parts[0].type() not in (openexr.scanlineimage, openexr.tiledimage):
                    raise InputError(f"{name} is a multi-part or deep EXR; export one flat image")
                header = dict(file.header())
                description = own_description(str(header.get("nsfcDescription", "")))
            _check_exr_header(header, name, max_pixels, fits)
            with openexr.File(str(path), separate_channels=True) as file:
                planes = {channel: data.pixels for channel, data in file.channels().items()}
    except CausticsError:
        raise
    except Exception as error:
        why = reason(RuntimeError(said[0].rpartition(") ")[2])) if said else reason(error)
        raise DamagedDataError(f"{name}: EXR cannot be decoded ({why}); export it again") from error
    notes = []
    lossy = (openexr.B44_COMPRESSION, openexr.B44A_COMPRESSION, openexr.DWAA_COMPRESSION, openexr.DWAB_COMPRESSION)
    if header.get("compression") in (*lossy, openexr.PXR24_COMPRESSION):
        notes.append(f"{name} was compressed with loss; export EXR with ZIP compression")
    alpha = planes.pop("A", None)
    array = np.stack([planes[channel] for channel in _exr_order(sorted(planes), description, name)])
    if array.dtype.kind != "f":
        raise InputError(f"{name} holds {array.dtype}; export half or float channels")
    if alpha is not None:
        array = without_alpha(np.concatenate([array, alpha[None]]), name, notes)
    return Decoded(array, description, notes)


def write_exr(path: Path, image: Output) -> None:
    """Write float32 channels named by colour or wavelength.

    Raises:
        InputError: channels without a name, or no OpenEXR package.
    """
    openexr = _openexr()
    if image.wavelengths_m is not None:
        channels = [_exr_channel(wavelength) for wavelength in image.wavelengths_m]
    elif len(image.array) in (1, 3):
        channels = ["R", "G", "B"] if len(image.array) == 3 else ["Y"]
    else:
        raise InputError(f"EXR needs a name for each of {len(image.array)} channels; give wavelengths_m")
    header = {
        "compression": openexr.ZIP_COMPRESSION,
        "type": openexr.scanlineimage,
        "nsfcDescription": image.description(channels=channels),
    }
    planes = np.ascontiguousarray(image.array, dtype=np.float32)
    with openexr.File(header, dict(zip(channels, planes, strict=True))) as file:
        file.write(str(path))
