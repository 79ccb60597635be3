"""Ways in which bench, camera or print are not what a reconstruction expects, by name.

What a camera does is written here a second time, on purpose: a network that was trained with ``nets.training.camera``
must not be judged by the same resampling and the same noise. ``benchmarks.robustness`` and the suite ``one-thing``
share these conditions.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from warp_caustics.types import FloatArray

ImageArray = npt.NDArray[np.float32]

WHITE_NOISE = 0.01
"""Of the test fields, relative to the light of a flat plate."""


@dataclass(frozen=True)
class Condition:
    """What is wrong, in the order in which light meets it; the default is the test fields' bench.

    Attributes:
        relief: how the strokes are printed, ``plain``, or a name that ``odd_prints.printed`` takes.
        uneven: light at the rim, in a random direction, relative to the middle and less 1.
        ambient: light that is not from the lamp, relative to a flat plate's.
        apart_px: how far channels are moved, each in its own random direction [px].
        moved: which channels are.
        is_opposite: whether blue moves just against red, in place of its own direction: as a slope disperses light.
        scaled: magnification of each channel about the middle, less 1, shape [n_w].
        blur_px: standard deviation of each channel's Gaussian PSF [px], shape [n_w].
        mixing: share of a channel's signal that each of its neighbours gives it, and takes.
        gains: of each channel, shape [n_w].
        noise: standard deviation where it is as bright as behind a flat plate, relative.
        is_photon_like: noise as the square root of the signal, not white.
        is_displaced: all channels are moved, which displaces the plate: errors are told aligned as well.
        is_bowed: absolute heights are hard to tell: errors are told without their mean as well.
    """

    relief: str = "plain"
    uneven: float = 0.0
    ambient: float = 0.0
    apart_px: float = 0.0
    moved: tuple[int, ...] = (0, 2)
    is_opposite: bool = False
    scaled: tuple[float, ...] = ()
    blur_px: tuple[float, ...] = ()
    mixing: float = 0.0
    gains: tuple[float, ...] = ()
    noise: float = WHITE_NOISE
    is_photon_like: bool = False
    is_displaced: bool = False
    is_bowed: bool = False


CONDITIONS: dict[str, Condition] = {
    "ideal": Condition(),
    "apart-0.05": Condition(apart_px=0.05),
    "apart-0.1": Condition(apart_px=0.1),
    "apart-0.2": Condition(apart_px=0.2),
    "apart-0.3": Condition(apart_px=0.3),
    "apart-0.5": Condition(apart_px=0.5),
    "all-apart-0.3": Condition(apart_px=0.3, moved=(0, 1, 2), is_displaced=True),
    "scaled-0.1": Condition(scaled=(1e-3, 0.0, -1e-3)),
    "blur-0.5": Condition(blur_px=(0.5, 0.5, 0.5)),
    "blur-1": Condition(blur_px=(1.0, 1.0, 1.0)),
    "blur-2": Condition(blur_px=(2.0, 2.0, 2.0)),
    "blur-own": Condition(blur_px=(0.6, 0.2, 1.2)),
    "noise-3": Condition(noise=0.03, is_photon_like=True),
    "noise-10": Condition(noise=0.10, is_photon_like=True),
    "uneven-5": Condition(uneven=0.05),
    "ambient-3": Condition(ambient=0.03),
    "mixing-5": Condition(mixing=0.05),
    "gain-3": Condition(gains=(0.97, 1.0, 1.03)),
    "ellipse": Condition(relief="ellipse"),
    "parabola": Condition(relief="parabola"),
    "gaussian": Condition(relief="gaussian"),
    "quarter": Condition(relief="quarter"),
    "squashed": Condition(relief="squashed"),
    "merge": Condition(relief="merge"),
    "bow-20": Condition(relief="bow-20", is_bowed=True),
    "camera": Condition(
        apart_px=0.3,
        blur_px=(0.7, 0.7, 0.7),
        uneven=0.03,
        ambient=0.01,
        mixing=0.03,
        noise=0.02,
        is_photon_like=True,
    ),
    "opposite-0.1": Condition(apart_px=0.1, is_opposite=True),
    "opposite-0.3": Condition(apart_px=0.3, is_opposite=True),
}
"""By name; one thing wrong at a time, a plausible camera, and the worst directions in which channels lie apart."""


def seen(image: ImageArray, condition: Condition, light_angle: float, white: FloatArray) -> ImageArray:
    """The image as it is measured; what moves channels or changes their size or the print was simulated before.

    Args:
        image: simulated irradiance, relative to a flat plate's, shape [n_w, m, m].
        condition: what is wrong.
        light_angle: direction in which the light grows [rad].
        white: standard normal numbers, shape of the image.

    Returns:
        Relative irradiance, not below zero, shape [n_w, m, m].
    """
    values = image.astype(np.float32)
    if condition.uneven:
        values *= gradient(image.shape[-1], condition.uneven, light_angle)
    values += np.float32(condition.ambient)
    if condition.blur_px:
        values = np.stack(
            [
                scipy.ndimage.gaussian_filter(channel, sigma, mode="nearest")
                for channel, sigma in zip(values, condition.blur_px, strict=True)
            ]
        )
    if condition.mixing:
        values = np.tensordot(mixing_matrix(len(values), condition.mixing), values, axes=1)
    if condition.gains:
        values = values * np.array(condition.gains, np.float32)[:, None, None]
    deviation = condition.noise * (np.sqrt(np.maximum(values, 0.0)) if condition.is_photon_like else 1.0)
    # A camera does not count below zero.
    return np.maximum(values + deviation * white, 0.0).astype(np.float32)


def gradient(pixels: int, rim: float, angle: float) -> ImageArray:
    """Light that grows linearly, 1 in the middle and 1 + rim in the middle of a side it grows to, shape [m, m]."""
    along = (np.arange(pixels) + 0.5) * (2 / pixels) - 1
    return np.asarray(1 + rim * (np.cos(angle) * along[None, :] + np.sin(angle) * along[:, None]), np.float32)


def mixing_matrix(channels: int, share: float) -> ImageArray:
    """Signals of light: each channel takes a share of each neighbour's light instead of its own, shape [n_w, n_w]."""
    others = share * (np.eye(channels, k=1) + np.eye(channels, k=-1))
    return np.asarray(others + np.diag(1 - others.sum(axis=1)), np.float32)
