"""The state of one calibration, and the steps that dark frame and flat field make in the camera's pixel grid."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from warp_caustics.capture.preview import preview
from warp_caustics.capture.stage import CaptureStage
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.channels import in_nm
from warp_caustics.io.image_file import ImageFile
from warp_caustics.io.noise import SMOOTHING_WINDOW, BoolImage, FloatImage, smooth_frame

MIN_FLAT = 0.1
"""Part of the flat field's median below which a pixel beside the window holds no light to divide by."""
EDGE_PX = 4
"""Width of the band along the window's border in which the flat field is not smoothed: the lens blurs the border in
image and flat alike, and smoothing would undo that in one of them."""
SURFACE_DEGREE = 4


@dataclass
class Work:
    """State of one calibration: channels in scene order, counts turning into W/m^2.

    Attributes:
        signal: what became of the image so far, shape [n_w, H, W]; camera channels until they are unmixed.
        mask: pixels that hold a measurement, same shape.
        level: L_i [W/m^2], shape [n_w].
        labels: name of each wavelength.
        region: pixels whose centre lies in the window, shape [H, W]; None if the frame is the window.
        warnings: one line for each thing a person should know.
        steps: what was done, one line each.
        stages: the same with pictures.
    """

    signal: FloatImage
    mask: BoolImage
    level: FloatImage
    labels: list[str]
    region: BoolImage | None = None
    warnings: list[str] = field(default_factory=list)
    steps: list[str] = field(default_factory=list)
    stages: list[CaptureStage] = field(default_factory=list)

    def done(self, name: str, text: str, before: npt.NDArray[np.floating[Any]] | None = None, **figures: float) -> None:
        """Put a step on record; ``before`` is a preview taken before it."""
        self.steps.append(text)
        self.stages.append(CaptureStage(name, text, before, preview(self.signal), None, figures))

    def in_window(self, image: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Values [..., N] of those pixels of images [..., H, W] that lie in the window."""
        if self.region is None:
            return image.reshape(*image.shape[:-2], -1)
        return image[..., self.region]


def checked_exposures(exposure: float | Sequence[float] | None, count: int) -> FloatImage:
    """One exposure per wavelength, shape [count]; 1 if not given.

    Raises:
        InputError: not positive numbers, or another count.
    """
    values = np.ones(count) if exposure is None else np.asarray(exposure, dtype=np.float64)
    values = np.full(count, values) if values.ndim == 0 else values
    if values.shape != (count,) or not (np.isfinite(values) & (values > 0)).all():
        raise InputError(f"exposure {exposure!r} is not usable; give one number above 0, or one per wavelength")
    return values


def check_size(image: ImageFile, m: int) -> None:
    """Refuse a frame that is not the window of m x m pixels.

    Raises:
        MismatchError: another size.
    """
    _, height, width = image.values.shape
    if (height, width) == (m, m):
        return
    fix = f"crop and resample it to the window, or set image_pixels of the scene to {height}"
    if height != width:
        fix = "crop it to the square window"
    elif height % m == 0:
        k = height // m
        fix = f"average blocks of {k} x {k} pixels, or set image_pixels of the scene to {height}"
    raise MismatchError(f"the image is {width} x {height} pixels, the scene has {m} x {m}; {fix}, or give its corners")


def check_frame(frame: ImageFile, image: ImageFile, kind: str) -> None:
    """Refuse a calibration frame that another camera, or other settings, made.

    Raises:
        MismatchError: another shape, depth or other wavelengths.
    """
    if frame.values.shape != image.values.shape:
        raise MismatchError(
            f"the {kind} has shape {frame.values.shape}, the image {image.values.shape}; record both alike"
        )
    if frame.full_scale and image.full_scale and frame.full_scale != image.full_scale:
        raise MismatchError(
            f"the {kind} has {frame.bit_depth} bits, the image {image.bit_depth}; export both with the same settings"
        )
    if frame.wavelengths_m and image.wavelengths_m and frame.wavelengths_m != image.wavelengths_m:
        raise MismatchError(
            f"the {kind} records {in_nm(frame.wavelengths_m)}, "
            f"the image {in_nm(image.wavelengths_m)}; record both alike"
        )


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


def divide_by_flat(work: Work, flat: FloatImage, exposure: FloatImage) -> None:
    """Divide by the smoothed flat field, after which a flat plate has L_i.

    Args:
        work: signal in scene order.
        flat: flat field without offset, shape [n_w, H, W].
        exposure: exposure of the image over that of the flat, shape [n_w].

    Raises:
        MismatchError: the flat field holds no light.
    """
    before = preview(work.signal)
    kept = 0
    for channel, frame in enumerate(flat):
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


def scale_without_flat(work: Work, image: ImageFile, exposure: float | Sequence[float] | None) -> None:
    """Turn counts into W/m^2 by what is known besides a flat field.

    Raises:
        InputError: the image holds no light.
    """
    before = preview(work.signal)
    if exposure is not None:
        counts = checked_exposures(exposure, len(work.signal))
        work.signal /= counts[:, None, None]
        text = f"divided by the exposure, {', '.join(f'{c:g}' for c in counts)} per W/m^2"
    elif image.count_W_m2 is not None:
        work.signal *= image.count_W_m2
        text = f"multiplied by the {image.count_W_m2:g} W/m^2 of a count that the file records"
    elif image.full_scale is not None:
        for channel, signal in enumerate(work.signal):
            mean = signal[work.mask[channel]].mean() if work.mask[channel].any() else 0.0
            if mean <= 0:
                raise InputError(f"{work.labels[channel]}: the image holds no light; record it again")
            signal *= work.level[channel] / mean
        text = "scaled each channel to the mean irradiance of a flat plate, since a plate conserves light"
        work.warnings.append(
            "no flat field: vignetting stays in the image and the scale assumes that no light leaves the window; "
            "record the same view with a flat plate"
        )
    else:
        text = "values taken as W/m^2, since the file holds floats and there is no flat field"
    work.done("scale", text, before)


def fill_invalid(work: Work) -> None:
    """Give pixels without measurement their neighbours' median, so that who ignores the mask meets no nonsense."""
    from scipy import ndimage

    for channel, signal in enumerate(work.signal):
        dead = ~np.isfinite(signal)
        if dead.any():
            work.signal[channel] = np.where(dead, ndimage.median_filter(np.where(dead, 0, signal), 5), signal)


def warn_of_energy(work: Work) -> None:
    """A plate conserves light: the mean of the window is near L_i."""
    for label, signal, level in zip(work.labels, work.signal, work.level, strict=True):
        ratio = float(signal.mean() / level) if level > 0 else 1.0
        if not 0.5 <= ratio <= 1.2:
            work.warnings.append(
                f"{label}: the mean irradiance is {ratio:.3g} times that of a flat plate, a plate conserves light; "
                "check exposure, flat field and units"
            )
