"""From a camera's frame to irradiance on the screen.

With the same camera's dark frame (light off) and flat field (a plate without
relief) each pixel follows from

    irradiance_i = L_i (image - dark) / ((flat - dark) exposure_i),

because the flat plate lets exactly L_i of ``scene.radiosity_W_m2`` through.
Missing frames weaken this, and every assumption made instead is listed.

Not handled: lens distortion and alignment (the frame must show the window and
nothing else), stray light, and cross-talk between the colour filters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.channels import channel_order, in_nm
from warp_caustics.io.image_file import ImageFile
from warp_caustics.io.noise import SMOOTHING_WINDOW, BoolImage, FloatImage, estimate_noise_std, smooth_frame

if TYPE_CHECKING:
    from warp_caustics.scene import Scene

SATURATION = 0.999
"""Part of full scale from which a pixel counts as saturated; sensors clip slightly below the last code."""
MAX_SATURATED = 0.01


@dataclass(frozen=True, eq=False)
class Capture:
    """A calibrated capture, channels in the order of the scene's wavelengths.

    Attributes:
        irradiance: light on the screen [W/m^2], float32, shape [n_w, m, m]; noise around 0 may be negative.
        noise_std: standard deviation of the pixel noise where the irradiance is near L_i [W/m^2], shape [n_w];
            NaN where the image is too small to tell.
        saturated_fraction: share of the pixels at full scale, shape [n_w].
        mask: pixels that hold a measurement, shape [n_w, m, m].
        warnings: one line for each thing a person should know.
        steps: what was done, one line each.
    """

    irradiance: npt.NDArray[np.float32]
    noise_std: npt.NDArray[np.float64]
    saturated_fraction: npt.NDArray[np.float64]
    mask: BoolImage
    warnings: tuple[str, ...]
    steps: list[str]


def _check_size(image: ImageFile, m: int) -> None:
    _, height, width = image.values.shape
    if (height, width) == (m, m):
        return
    fix = f"crop and resample it to the window, or set image_pixels of the scene to {height}"
    if height != width:
        fix = "crop it to the square window"
    elif height % m == 0:
        k = height // m
        fix = f"average blocks of {k} x {k} pixels, or set image_pixels of the scene to {height}"
    raise MismatchError(f"the image is {width} x {height} pixels, the scene has {m} x {m}; {fix}")


def _check_frame(frame: ImageFile, image: ImageFile, kind: str) -> None:
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


def _saturated(image: ImageFile, order: list[int]) -> BoolImage:
    if image.full_scale is None:
        return np.zeros(image.values.shape, bool)
    return image.values[order] >= SATURATION * image.full_scale


def _exposures(exposure: float | Sequence[float] | None, count: int) -> FloatImage:
    values = np.ones(count) if exposure is None else np.asarray(exposure, dtype=np.float64)
    values = np.full(count, values) if values.ndim == 0 else values
    if values.shape != (count,) or not (np.isfinite(values) & (values > 0)).all():
        raise InputError(f"exposure {exposure!r} is not usable; give one number above 0, or one per wavelength")
    return values


@dataclass
class _Work:
    """State of one calibration: channels in scene order, counts turning into W/m^2."""

    signal: FloatImage
    mask: BoolImage
    level: FloatImage
    labels: list[str]
    warnings: list[str]
    steps: list[str]


def _subtract_dark(work: _Work, dark: FloatImage) -> FloatImage:
    kept = 0
    for channel, frame in enumerate(dark):
        dark[channel], odd = smooth_frame(frame)
        kept += odd
    work.signal -= dark
    work.steps.append(
        f"dark frame subtracted (mean {dark.mean():.4g}, smoothed over {SMOOTHING_WINDOW} pixels, {kept} odd ones kept)"
    )
    for channel, mean in enumerate(work.signal.mean(axis=(1, 2))):
        if mean <= 0:
            raise MismatchError(
                f"{work.labels[channel]}: the dark frame is brighter than the image; were the files swapped?"
            )
    return dark


def _divide_by_flat(work: _Work, flat: FloatImage, exposure: FloatImage) -> None:
    kept = 0
    for channel, frame in enumerate(flat):
        smooth, odd = smooth_frame(frame)
        kept += odd
        dead = smooth <= 0
        if dead.mean() > 0.5:
            raise MismatchError(f"{work.labels[channel]}: the flat field is as dark as the dark frame; record it again")
        if dead.any():
            work.warnings.append(f"{work.labels[channel]}: the flat field shows no light in {int(dead.sum())} pixels")
        work.mask[channel] &= ~dead
        work.signal[channel] *= work.level[channel] / (np.where(dead, np.nan, smooth) * exposure[channel])
    _fill_invalid(work)
    work.steps.append(
        f"divided by the flat field (smoothed over {SMOOTHING_WINDOW} pixels, {kept} odd ones kept); "
        f"a flat plate is {', '.join(f'{level:g}' for level in work.level)} W/m^2"
    )


def _scale_without_flat(work: _Work, image: ImageFile, exposure: float | Sequence[float] | None) -> None:
    if exposure is not None:
        counts = _exposures(exposure, len(work.signal))
        work.signal /= counts[:, None, None]
        work.steps.append(f"divided by the exposure, {', '.join(f'{c:g}' for c in counts)} per W/m^2")
    elif image.count_W_m2 is not None:
        work.signal *= image.count_W_m2
        work.steps.append(f"multiplied by the {image.count_W_m2:g} W/m^2 of a count that the file records")
    elif image.full_scale is not None:
        for channel, signal in enumerate(work.signal):
            mean = signal[work.mask[channel]].mean() if work.mask[channel].any() else 0.0
            if mean <= 0:
                raise InputError(f"{work.labels[channel]}: the image holds no light; record it again")
            signal *= work.level[channel] / mean
        work.steps.append("scaled each channel to the mean irradiance of a flat plate, since a plate conserves light")
        work.warnings.append(
            "no flat field: vignetting stays in the image and the scale assumes that no light leaves the window; "
            "record the same view with a flat plate"
        )
    else:
        work.steps.append("values taken as W/m^2, since the file holds floats and there is no flat field")


def _fill_invalid(work: _Work) -> None:
    """Give pixels without measurement their neighbours' median, so that who ignores the mask meets no nonsense."""
    from scipy import ndimage

    for channel, signal in enumerate(work.signal):
        dead = ~np.isfinite(signal)
        if dead.any():
            work.signal[channel] = np.where(dead, ndimage.median_filter(np.where(dead, 0, signal), 5), signal)


def _energy_warnings(work: _Work) -> None:
    for label, signal, level in zip(work.labels, work.signal, work.level, strict=True):
        ratio = float(signal.mean() / level) if level > 0 else 1.0
        if not 0.5 <= ratio <= 1.2:
            work.warnings.append(
                f"{label}: the mean irradiance is {ratio:.3g} times that of a flat plate, a plate conserves light; "
                "check exposure, flat field and units"
            )


def capture_to_irradiance(
    image: ImageFile,
    *,
    scene: "Scene",
    dark: ImageFile | None = None,
    flat: ImageFile | None = None,
    wavelength_order: str | Sequence[float] | None = None,
    exposure: float | Sequence[float] | None = None,
) -> Capture:
    """Calibrate one frame of a caustic. Nothing is resized and no channel is made up.

    Without a flat field, floats are W/m^2 already, and integers are scaled so
    that each channel's mean is that of a flat plate (with a warning).

    Args:
        image: the frame, exactly the window, shape [n_w, m, m].
        scene: gives wavelengths, their L_i [W/m^2] and the number of pixels.
        dark: the same camera and exposure with the light off, shape [n_w, m, m].
        flat: the same camera with a flat plate, shape [n_w, m, m].
        wavelength_order: wavelength of each file channel, as text in nanometres ("610,530,430") or as numbers in
            metres. Not given: as the file records, else longest first.
        exposure: with a flat field, exposure of the image divided by that of the flat; without one, value in the
            file per W/m^2. One number, or one per wavelength of the scene.

    Returns:
        Irradiance, its noise, the mask of usable pixels, and what was done.

    Raises:
        MismatchError: image, frames and scene do not belong together.
        InputError: an argument that cannot be used, or an image without light.
    """
    order, channel_step = channel_order(image, scene.wavelengths_m, wavelength_order)
    _check_size(image, scene.image_pixels)
    frames = {kind: frame for kind, frame in (("dark frame", dark), ("flat field", flat)) if frame is not None}
    for kind, frame in frames.items():
        _check_frame(frame, image, kind)
    exposures = _exposures(exposure, len(order))
    labels = [f"{wavelength * 1e9:.4g} nm" for wavelength in scene.wavelengths_m]
    saturated = _saturated(image, order)
    work = _Work(
        signal=image.values[order].astype(np.float64),
        mask=~saturated,
        level=np.array(scene.radiosity_W_m2),
        labels=labels,
        warnings=[*image.warnings, *(f"{kind}: {line}" for kind, frame in frames.items() for line in frame.warnings)],
        steps=[channel_step],
    )
    if not work.signal.any():
        raise InputError("the image is black; record it again")
    _warn_saturation(work, saturated, image, calibrated=flat is not None)
    offset: Any = 0.0
    if dark is not None:
        offset = _subtract_dark(work, dark.values[order].astype(np.float64))
    if flat is not None:
        clipped = _saturated(flat, order)
        if clipped.mean() > MAX_SATURATED:
            raise InputError(f"{clipped.mean():.1%} of the flat field is saturated; expose it shorter")
        work.mask &= ~clipped
        _divide_by_flat(work, flat.values[order] - offset, exposures)
        if dark is None:
            work.warnings.append(
                "no dark frame: the camera's offset lowers the contrast; record one with the light off"
            )
    else:
        _scale_without_flat(work, image, exposure)
    _energy_warnings(work)
    noise = [
        estimate_noise_std(signal, level, mask)
        for signal, level, mask in zip(work.signal, work.level, work.mask, strict=True)
    ]
    return Capture(
        irradiance=work.signal.astype(np.float32),
        noise_std=np.array(noise),
        saturated_fraction=saturated.mean(axis=(1, 2)),
        mask=work.mask,
        warnings=tuple(work.warnings),
        steps=work.steps,
    )


def _warn_saturation(work: _Work, saturated: BoolImage, image: ImageFile, calibrated: bool) -> None:
    for label, share in zip(work.labels, saturated.mean(axis=(1, 2)), strict=True):
        if share > MAX_SATURATED:
            work.warnings.append(f"{label}: {share:.1%} of the pixels are saturated (limit 1 %); expose shorter")
    if calibrated and image.full_scale is None:
        work.warnings.append(
            "the image holds floats: saturated pixels cannot be recognised; give the camera's integers"
        )
