"""The lens of a case's camera: it displaces and blurs the light on a screen before pixels take means of it.

A picture that is displaced or blurred once it is in pixels is another one: what is finer than a pixel is folded back
by then. Lines of a sharp picture 0.15 px aside are 3 to 4 % of themselves off, those behind a PSF of 0.7 px 0.8 % of
flat light.
"""

import numpy as np
import numpy.typing as npt
import scipy  # loads its parts when they are first used

from warp_caustics.camera.config import CameraConfig
from warp_caustics.types import FloatArray

ImageArray = npt.NDArray[np.float32]

FINENESS = 4
"""Fine pixels along a pixel."""


def lens_moves(camera: CameraConfig, wavelengths: int) -> FloatArray:
    """Where the screen of each wavelength is moved to, so that its picture lies where the lens shows it.

    Args:
        camera: whose shifts are looked at; a screen that is moved one way shows its picture moved the other.
        wavelengths: n_w.

    Returns:
        Along x and y [px], shape [n_w, 2].
    """
    colours = np.zeros((wavelengths, 2)) if camera.colour_shift_px is None else np.asarray(camera.colour_shift_px)
    return 0.0 - np.asarray(camera.shift_px) - colours


def through_lens(light: ImageArray, camera: CameraConfig) -> ImageArray:
    """Means over pixels of light that the lens blurs, shape [n_w, m, m].

    Args:
        light: on fine pixels, already where the lens shows it, shape [n_w, k m, k m], k as :data:`FINENESS`.
        camera: gives the PSF; light beyond the window is its mirror image.
    """
    widths = np.broadcast_to(np.asarray(camera.psf_px, np.float64), len(light))
    pixels = light.shape[-1] // FINENESS
    found = []
    for channel, width in zip(light.astype(np.float64), widths, strict=True):
        blurred = scipy.ndimage.gaussian_filter(channel, FINENESS * width, mode="reflect", truncate=6.0)
        found.append(blurred.reshape(pixels, FINENESS, pixels, FINENESS).mean(axis=(1, 3)))
    return np.asarray(found, np.float32)


def behind_lens(camera: CameraConfig) -> CameraConfig:
    """What is left of the camera once light has come through its lens.

    A square that it averages over, and a picture's size and turn, are left with it and taken of the pixels.
    """
    return camera.model_copy(update={"psf_px": 0.0, "shift_px": (0.0, 0.0), "colour_shift_px": None})
