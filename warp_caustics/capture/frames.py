"""Dark frame and flat field, in the camera's pixel grid."""

from collections.abc import Sequence

import numpy as np

from warp_caustics.capture.preview import preview
from warp_caustics.capture.shot import Shot
from warp_caustics.capture.stage import Work
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.channels import in_nm
from warp_caustics.io.image_file import ImageFile
from warp_caustics.io.median import median_5x5
from warp_caustics.io.noise import SMOOTHING_WINDOW, BoolImage, FloatImage, smooth_frame

SATURATION = 0.999
"""Part of full scale from which a pixel counts as saturated; sensors clip slightly below the last code."""
MAX_SATURATED = 0.01
MIN_FLAT = 0.1
"""Part of the flat field's median below which a pixel beside the window holds no light to divide by."""
EDGE_PX = 4
"""Width of the band along the window's border in which the flat field is not smoothed: the lens blurs the border in
image and flat alike, and smoothing would undo that in one of them."""
SURFACE_DEGREE = 4


def check_frame_shape(frame: Sequence[int], image: Sequence[int], kind: str) -> None:
    """Refuse a calibration frame of another shape than the image, [C, H, W] both.

    Raises:
        MismatchError: another shape.
    """
    if tuple(frame) != tuple(image):
        raise MismatchError(f"the {kind} has shape {tuple(frame)}, the image {tuple(image)}; record both alike")


def check_frame(frame: ImageFile, image: ImageFile, kind: str) -> None:
    """Refuse a calibration frame that another camera, or other settings, made.

    Raises:
        MismatchError: another shape, depth or other wavelengths.
    """
    check_frame_shape(frame.values.shape, image.values.shape, kind)
    if frame.full_scale and image.full_scale and frame.full_scale != image.full_scale:
        raise MismatchError(
            f"the {kind} has {frame.bit_depth} bits, the image {image.bit_depth}; export both with the same settings"
        )
    if frame.wavelengths_m and image.wavelengths_m and frame.wavelengths_m != image.wavelengths_m:
        raise MismatchError(
            f"the {kind} records {in_nm(frame.wavelengths_m)}, "
            f"the image {in_nm(image.wavelengths_m)}; record both alike"
        )


def saturated(image: ImageFile) -> BoolImage:
    """Pixels at full scale, shape [C, H, W]; none where the file does not tell its full scale."""
    if image.full_scale is None:
        return np.zeros(image.values.shape, bool)
    return np.asarray(image.values >= SATURATION * image.full_scale)


def take_dark(work: Work, shot: Shot) -> FloatImage | float:
    """Subtract the dark frame from the signal; returns what to subtract from the flat field.

    Raises:
        MismatchError: it is brighter than the image.
    """
    offset: FloatImage | float = 0.0
    if shot.dark is not None:
        own = shot.dark.values.astype(np.float64)
        offset = smoothed_dark(own)[0] if shot.is_dark_subtracted else subtract_dark(work, own)
    if shot.flat_dark is not None:
        offset = smoothed_dark(shot.flat_dark.values.astype(np.float64))[0]
    return offset


def take_flat(work: Work, flat: ImageFile, offset: FloatImage | float) -> None:
    """The flat field without the camera's offset becomes ``work.light``; its saturated pixels are masked.

    Raises:
        InputError: too many of them.
    """
    clipped = saturated(flat)
    share = float(work.in_window(clipped).mean())
    if share > MAX_SATURATED:
        raise InputError(f"{share:.1%} of the flat field is saturated; expose it shorter")
    work.mask &= ~clipped
    work.light = np.asarray(flat.values - offset, np.float64)


def smoothed_dark(dark: FloatImage) -> tuple[FloatImage, int]:
    """A dark frame with less noise, shape [C, H, W], and how many odd pixels were kept as they are."""
    kept = 0
    result = np.empty_like(dark)
    for channel, frame in enumerate(dark):
        result[channel], odd = smooth_frame(frame)
        kept += odd
    return result, kept


def subtract_dark(work: Work, dark: FloatImage) -> FloatImage:
    """Take the smoothed dark frame from the signal; returns it, shape [C, H, W].

    Raises:
        MismatchError: it is brighter than the image.
    """
    before = preview(work.signal)
    dark, kept = smoothed_dark(dark)
    work.signal -= dark
    mean = float(dark.mean())
    work.done(
        "dark frame",
        f"dark frame subtracted (mean {mean:.4g}, smoothed over {SMOOTHING_WINDOW} pixels, {kept} odd ones kept)",
        before,
        dark_mean_counts=mean,
        odd_pixels=float(kept),
    )
    for channel, value in enumerate(work.in_window(work.signal).mean(axis=-1)):
        if value <= 0:
            label = work.labels[channel] if len(work.labels) == len(work.signal) else f"channel {channel}"
            raise MismatchError(f"{label}: the dark frame is brighter than the image; were the files swapped?")
    return dark


def divide_by_flat(work: Work, exposure: FloatImage) -> None:
    """Divide by the smoothed flat field, after which a flat plate has L_i.

    Args:
        work: signal and flat field in scene order.
        exposure: exposure of the image over that of the flat, shape [n_w].

    Raises:
        MismatchError: the flat field holds no light.
    """
    assert work.light is not None
    before = preview(work.signal)
    kept = 0
    for channel, frame in enumerate(work.light):
        smooth, odd = smooth_frame(frame) if work.region is None else smooth_in_region(frame, work.region)
        kept += odd
        dead = smooth <= 0
        if work.region is not None:
            dead |= smooth <= MIN_FLAT * max(float(np.median(smooth[work.region])), 0.0)
        if work.in_window(dead).mean() > 0.5:
            raise MismatchError(f"{work.labels[channel]}: the flat field is as dark as the dark frame; record it again")
        if (count := int(work.in_window(dead).sum())) > 0:
            work.warnings.append(f"{work.labels[channel]}: the flat field shows no light in {count} pixels")
        work.mask[channel] &= ~dead
        work.signal[channel] *= work.level[channel] / (np.where(dead, np.nan, smooth) * exposure[channel])
    fill_invalid(work)
    work.done(
        "flat field",
        f"divided by the flat field (smoothed over {SMOOTHING_WINDOW} pixels, {kept} odd ones kept); "
        f"a flat plate is {', '.join(f'{level:g}' for level in work.level)} W/m^2",
        before,
        odd_pixels=float(kept),
    )


def smooth_in_region(frame: FloatImage, region: BoolImage) -> tuple[FloatImage, int]:
    """Smooth a flat field within the window only, whose border is a cliff.

    Beyond the border the frame is continued by a polynomial with the noise of the inside, so that smoothing meets no
    cliff. In the outermost EDGE_PX pixels and beyond, the frame stays as it is.

    Args:
        frame: one channel without offset, shape [H, W].
        region: pixels in the window, shape [H, W].

    Returns:
        The smoothed frame, shape [H, W], and the number of pixels within the window kept as they were.
    """
    from scipy import ndimage

    rows, columns = np.nonzero(region)
    if not rows.size:
        return frame, 0
    box = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    part, core = frame[box], ndimage.binary_erosion(region[box], iterations=EDGE_PX)
    if core.sum() < 1024:
        return frame, 0
    y, x = (np.linspace(-1, 1, size) for size in part.shape)
    at_y, at_x = np.nonzero(core)
    chosen = slice(None, None, max(1, len(at_y) // 20_000))
    basis = np.polynomial.legendre.legvander2d(x[at_x[chosen]], y[at_y[chosen]], [SURFACE_DEGREE] * 2)
    coefficients = np.linalg.solve(basis.T @ basis, basis.T @ part[core][chosen])
    shape = (SURFACE_DEGREE + 1, SURFACE_DEGREE + 1)
    surface = np.polynomial.legendre.leggrid2d(x, y, coefficients.reshape(shape)).T
    rest = (part - surface)[core]
    beyond = surface[~core] + np.random.default_rng(0).choice(rest, int((~core).sum()))
    whole = part.copy()
    whole[~core] = beyond
    smooth, _ = smooth_frame(whole)
    result = frame.copy()
    result[box] = np.where(core, smooth, part)
    return result, int((core & (smooth == part)).sum())


def fill_invalid(work: Work) -> None:
    """Give pixels without measurement their neighbours' median, so that who ignores the mask meets no nonsense."""
    for channel, signal in enumerate(work.signal):
        dead = ~np.isfinite(signal)
        if dead.any():
            work.signal[channel] = np.where(dead, median_5x5(np.where(dead, 0, signal)), signal)
