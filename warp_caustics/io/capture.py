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
from warp_caustics.io.images import ImageFile

if TYPE_CHECKING:
    from warp_caustics.scene import Scene

FloatImage = npt.NDArray[np.float64]
BoolImage = npt.NDArray[np.bool_]

SATURATION = 0.999
"""Part of full scale from which a pixel counts as saturated; sensors clip slightly below the last code."""
MAX_SATURATED = 0.01
WAVELENGTH_TOLERANCE_M = 1e-9
"""Lamps and filters are named in whole nanometres."""
SMOOTHING_WINDOW = 31
"""Pixels over which a flat field or dark frame is smoothed. Pixel noise falls about ninefold, while a quadratic follows
vignetting (corners at 70 %) to 3e-4 in the corner of a frame of 160 pixels and to 1e-5 at 512. The price: shadows of
dust smaller than this, and differences in sensitivity between pixels, stay in the image."""
_OUTLIER = 6.0
_MAD_TO_STD = 1.4826


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


def estimate_noise_std(image: FloatImage, level: float, valid: BoolImage | None = None) -> float:
    """Standard deviation of the white noise in an image, where its values are near a level.

    Immerkaer's mask [[1, -2, 1], [-2, 4, -2], [1, -2, 1]] (Computer Vision and Image Understanding 64, 300 (1996))
    cancels everything locally bilinear. Its median magnitude is taken over the flatter half of the pixels within
    0.7 to 1.4 of the level, because shot noise depends on brightness and caustic lines are no noise. Noise that is
    correlated between pixels (demosaicing, lossy compression) is underestimated.

    Args:
        image: one channel [W/m^2], shape [H, W].
        level: irradiance of interest [W/m^2].
        valid: pixels to use, shape [H, W]; all if not given.

    Returns:
        Noise [W/m^2]; NaN for fewer than 64 usable pixels.
    """
    from scipy import ndimage

    if min(image.shape) < 8:
        return float("nan")
    rows = image[2:] - 2 * image[1:-1] + image[:-2]
    second = np.abs(rows[:, 2:] - 2 * rows[:, 1:-1] + rows[:, :-2]) / 6
    # Blurred far beyond the mask's 3 x 3, so that choosing pixels by it does not choose the noise.
    smooth = ndimage.gaussian_filter(image, 2.0)
    slope = np.hypot(*np.gradient(smooth))[1:-1, 1:-1]
    usable = np.ones(second.shape, bool)
    if valid is not None:
        usable &= ndimage.binary_erosion(valid, np.ones((3, 3), bool))[1:-1, 1:-1]
    inner = smooth[1:-1, 1:-1]
    near = usable & (inner > 0.7 * level) & (inner < 1.4 * level)
    chosen = near if near.sum() >= 256 else usable
    if chosen.sum() < 64:
        return float("nan")
    flat = chosen & (slope <= np.median(slope[chosen]))
    return float(_MAD_TO_STD * np.median(second[flat]))


def smooth_frame(frame: FloatImage) -> tuple[FloatImage, int]:
    """Suppress the noise of a flat field or dark frame, keeping single odd pixels (hot, dead, dusty) as they are.

    A quadratic is fitted along rows and columns (Savitzky-Golay). Unlike a
    Gaussian it has no bias where a slope meets the border.

    Args:
        frame: one channel in counts, shape [H, W].

    Returns:
        The smoothed frame, shape [H, W], and the number of pixels kept as they were.
    """
    from scipy import ndimage, signal

    window = min(SMOOTHING_WINDOW, *(size - (size + 1) % 2 for size in frame.shape))
    if window < 5:
        return frame, frame.size

    def fitted(values: FloatImage) -> FloatImage:
        rows = signal.savgol_filter(values, window, 2, axis=0)
        return np.asarray(signal.savgol_filter(rows, window, 2, axis=1))

    # Compared with a local median of the remainder, not of the frame: where vignetting is steep, that one is biased.
    smooth = fitted(frame)
    expected = smooth + ndimage.median_filter(frame - smooth, 5)
    distance = np.abs(frame - expected)
    odd = distance > _OUTLIER * _MAD_TO_STD * np.median(distance)
    smooth = fitted(np.where(odd, expected, frame))
    return np.where(odd, frame, smooth), int(odd.sum())


def _nm(wavelengths_m: Sequence[float]) -> str:
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
                f"{source}: {_nm(file_m)}, but the scene has {_nm(scene_m)}; use the scene's wavelengths, "
                "give wavelength_order or change the scene"
            )
        order.append(nearest)
    if len(set(order)) != len(order):
        raise MismatchError(f"{source}: {_nm(file_m)} repeat or lie too close together; give each channel once")
    return order


def _channel_order(
    image: ImageFile, scene_m: Sequence[float], requested: str | Sequence[float] | None
) -> tuple[list[int], str]:
    count = len(image.values)
    if requested is not None:
        file_m = _requested_wavelengths_m(requested)
        if len(file_m) != count:
            raise InputError(f"wavelength order names {len(file_m)} channels, the image has {count}; name each once")
    if count != len(scene_m):
        one = "record all wavelengths, or choose a scene with one wavelength"
        fix = one if count == 1 else "give an image with one channel per wavelength, or change the scene"
        raise MismatchError(f"the image has {count} channels, the scene {len(scene_m)} wavelengths; {fix}")
    if requested is not None:
        return _match(file_m, scene_m, "wavelength order"), f"channels are {_nm(file_m)}, as requested"
    if image.wavelengths_m is not None:
        recorded = image.wavelengths_m
        return _match(recorded, scene_m, "the file records"), f"channels are {_nm(recorded)}, as the file records"
    falling = sorted(scene_m, reverse=True)
    if list(scene_m) == falling or (count == 3 and image.format in ("png", "tiff", "exr")):
        return _match(falling, scene_m, "channels"), f"channels taken as {_nm(falling)}, longest wavelength first"
    raise InputError(
        f"which channel is which of {_nm(scene_m)} is not recorded in the file; "
        f"give wavelength_order, for example '{','.join(f'{value * 1e9:g}' for value in scene_m)}'"
    )


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
            f"the {kind} records {_nm(frame.wavelengths_m)}, the image {_nm(image.wavelengths_m)}; record both alike"
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
    order, channel_step = _channel_order(image, scene.wavelengths_m, wavelength_order)
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
