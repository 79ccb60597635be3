"""The blur of lens and sensor, divided out: Wiener's filter for a Gaussian of known width.

Methods compare the image with one that no lens has seen. A blur of half a pixel
of the scene is then explained by other heights (docs/capture.md says how wrong
these are), and nothing in the image tells it from a plate that is a little
different: its width must be measured.
"""

import math

import numpy as np

from warp_caustics.capture.preview import preview
from warp_caustics.capture.stage import Work
from warp_caustics.io.noise import FloatImage

NOISE_SHARE = 0.01
"""Power of the noise relative to that of the caustic, at which a frequency is halved: best of 0.003, 0.01 and 0.03 on
three own plates with 1 % of noise and blurs of 0.3 to 1 pixels."""

PADDING_PX = 32
"""Pixels mirrored around the image, which else would go on at its other side."""


def wiener(shape: tuple[int, int], blur_px: float) -> FloatImage:
    """Filter by frequency, shape of :func:`numpy.fft.rfft2` of an image of that shape.

    Args:
        shape: of the image [pixels].
        blur_px: standard deviation of the Gaussian [pixels].
    """
    rows, columns = np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1])
    transfer = np.exp(-2 * (math.pi * blur_px) ** 2 * (rows[:, None] ** 2 + columns[None] ** 2))
    filtered: FloatImage = transfer * (1 + NOISE_SHARE) / (transfer**2 + NOISE_SHARE)
    return filtered


def sharpen(work: Work, blur_px: float) -> float:
    """Divide the blur out of the signal; returns what the noise must be multiplied by.

    Pixels next to masked ones are masked too: what they hold comes from there.

    Args:
        work: its signal is the window.
        blur_px: standard deviation of the blur [pixels of the window].
    """
    from scipy import ndimage

    before = preview(work.signal)
    n_rows, n_columns = work.signal.shape[1:]
    pad = min(PADDING_PX, n_rows, n_columns)
    padded = np.pad(work.signal, ((0, 0), (pad, pad), (pad, pad)), mode="symmetric")
    inverse = wiener(padded.shape[1:], blur_px)
    sharp = np.fft.irfft2(np.fft.rfft2(padded) * inverse, s=padded.shape[1:])
    # Where a blur is divided out that is not there, lines ring; light is never negative beyond what noise made so.
    work.signal = np.maximum(sharp[:, pad : pad + n_rows, pad : pad + n_columns], min(0.0, float(work.signal.min())))
    if not work.mask.all():
        reach = 2 * math.ceil(2 * blur_px) + 1
        work.mask = ndimage.minimum_filter(work.mask, size=(1, reach, reach))
    factor = float(np.sqrt((inverse**2).mean()))
    text = f"blur of {blur_px:g} pixels divided out; noise {factor:.2f} times as large"
    work.done("blur", text, before, blur_px=blur_px, noise_factor=factor)
    return factor
