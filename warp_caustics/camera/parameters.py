"""Numbers of a camera as tensors: all that an image can be differentiated by besides its light."""

from typing import Any, NamedTuple

import numpy as np
import torch

from warp_caustics.camera.config import CameraConfig
from warp_caustics.errors import InputError


class CameraParameters(NamedTuple):
    """Continuous parameters, or a batch of them: every field may have the same leading dimensions [...]."""

    psf_px: torch.Tensor
    """Standard deviation of the Gaussian PSF [px], shape [..., n_w]."""
    box_px: torch.Tensor
    """Width of the square that light is averaged over besides [px], shape [..., n_w]."""
    shift_px: torch.Tensor
    """Of the window's picture towards larger x and y [px], shape [..., 2]."""
    turn_rad: torch.Tensor
    """From x towards y [rad], shape [...]."""
    magnification: torch.Tensor
    """Camera pixels per pixel of the window, shape [...]."""
    homography: torch.Tensor
    """Before turn, magnification and shift, on positions from -1 to 1 over the window, shape [..., 3, 3]; of its nine
    numbers one is its scale, and four do what those three do as well."""
    colour_shift_px: torch.Tensor
    """Of each wavelength's picture [px], shape [..., n_w, 2]."""
    colour_scale: torch.Tensor
    """Magnification of each wavelength's picture about the middle of the photo, less 1, shape [..., n_w]."""
    light: torch.Tensor
    """Unevenness, see :func:`warp_caustics.camera.radiometry.uneven_light`, shape [..., n_w, 5]."""
    ambient: torch.Tensor
    """Light that goes other ways, relative to that of a flat plate, shape [..., n_w]."""
    mixing: torch.Tensor
    """Part of each wavelength's light in each camera channel, shape [..., C, n_w]."""
    gain: torch.Tensor
    """Of each camera channel, shape [..., C]."""


def camera_parameters(
    config: CameraConfig,
    wavelengths: int,
    pixels: int,
    *,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str = "cpu",
) -> CameraParameters:
    """The parameters that a configuration describes.

    Args:
        config: the camera.
        wavelengths: n_w.
        pixels: m.
        dtype: of the tensors.
        device: where to put them.

    Raises:
        InputError: values for another number of wavelengths or camera channels, or corners that no plane has.
    """
    mixing = np.eye(wavelengths) if config.mixing is None else np.array(config.mixing, dtype=np.float64)
    if mixing.shape[1] != wavelengths:
        raise InputError(
            f"mixing has {mixing.shape[1]} columns, the scene {wavelengths} wavelengths; give one column each"
        )
    homography: Any = np.eye(3) if config.homography is None else config.homography
    if config.corners_px is not None and config.frame_px is not None:
        homography = homography_to(np.array(config.corners_px), config.frame_px, pixels)
    values = (
        _each("psf_px", config.psf_px, wavelengths, 0),
        _each("box_px", config.box_px, wavelengths, 0),
        config.shift_px,
        config.turn_rad,
        config.magnification,
        homography,
        _each("colour_shift_px", config.colour_shift_px or (0.0, 0.0), wavelengths, 1),
        _each("colour_scale", config.colour_scale, wavelengths, 0),
        _each("light", config.light, wavelengths, 1),
        _each("ambient", config.ambient, wavelengths, 0),
        mixing,
        _each("gain", config.gain, len(mixing), 0, "camera channels"),
    )
    return CameraParameters(*(torch.tensor(np.asarray(v), dtype=dtype, device=device) for v in values))


def _each(name: str, value: Any, count: int, rank: int, what: str = "wavelengths") -> np.ndarray[Any, Any]:
    """One entry of ``rank`` dimensions per channel, of one for all or of one each."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim == rank:
        return np.broadcast_to(array, (count, *array.shape)).copy()
    if len(array) != count:
        raise InputError(f"{name} has {len(array)} entries for {count} {what}; give one for all, or one each")
    return array


def homography_to(corners_px: np.ndarray[Any, Any], frame_px: tuple[int, int], pixels: int) -> np.ndarray[Any, Any]:
    """Homography that takes the window's corners to places in the photo, shape [3, 3].

    Eight linear equations (Hartley, Zisserman, Multiple View Geometry, eq. 4.1).

    Args:
        corners_px: (x, y) of -x-y, +x-y, +x+y, -x+y from the centre of the photo's first pixel, shape [4, 2].
        frame_px: width and height of the photo [px].
        pixels: m.

    Raises:
        InputError: corners that are no convex quadrilateral in this order.
    """
    middle = (np.array(frame_px) - 1) / 2
    wanted = (corners_px - middle) / (pixels / 2)
    sides = np.roll(wanted, -1, axis=0) - wanted
    turns = sides[:, 0] * np.roll(sides[:, 1], -1) - sides[:, 1] * np.roll(sides[:, 0], -1)
    if not ((turns > 1e-9).all() or (turns < -1e-9).all()):
        listed = ", ".join(f"({x:g}, {y:g})" for x, y in corners_px)
        raise InputError(
            f"corners_px {listed} are no convex quadrilateral; two are swapped or coincide, "
            "the order is -x-y, +x-y, +x+y, -x+y"
        )
    rows, right = [], []
    for (u, v), (x, y) in zip(((-1, -1), (1, -1), (1, 1), (-1, 1)), wanted, strict=True):
        rows += [[u, v, 1, 0, 0, 0, -u * x, -v * x], [0, 0, 0, u, v, 1, -u * y, -v * y]]
        right += [x, y]
    return np.append(np.linalg.solve(np.array(rows, dtype=np.float64), np.array(right)), 1.0).reshape(3, 3)
