"""From a camera's frame to irradiance on the screen.

With the same camera's dark frame (light off) and flat field (a plate without
relief) each pixel follows from

    irradiance_i = L_i (image - dark) / ((flat - dark) exposure_i),

because the flat plate lets exactly L_i of ``scene.radiosity_W_m2`` through.
Missing frames weaken this, and every assumption made instead is listed. All
this happens in the camera's own pixels; where the frame is not exactly the
scene's window, one resampling follows (:mod:`warp_caustics.capture.resample`).

Not handled: stray light.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from warp_caustics.capture.frames import MAX_SATURATED, check_frame, divide_by_flat, saturated, take_dark, take_flat
from warp_caustics.capture.hot_pixels import replace_hot_pixels
from warp_caustics.capture.mixing import check_mixed_count, unmix
from warp_caustics.capture.near_lamp import is_near, restore_falloff
from warp_caustics.capture.preview import preview, preview_marks
from warp_caustics.capture.registration import check_in_photo
from warp_caustics.capture.resample import MARGIN_PX, resample
from warp_caustics.capture.sharpening import sharpen
from warp_caustics.capture.shot import Capture, Shot
from warp_caustics.capture.stage import CaptureStage, Work
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.channels import channel_order
from warp_caustics.io.image_file import ImageFile
from warp_caustics.io.noise import FloatImage, estimate_noise_std

if TYPE_CHECKING:
    from warp_caustics.scene import Scene


def capture_to_irradiance(image: ImageFile, *, scene: "Scene", **known: Any) -> Capture:
    """Calibrate one frame of a caustic; :func:`calibrated` with the fields of a shot as arguments.

    Args:
        image: the frame, shape [C, H, W]; exactly the window, [n_w, m, m], without registration.
        scene: gives wavelengths, their L_i [W/m^2] and the number of pixels.
        known: what else is known: ``dark``, ``flat``, ``exposure`` and all other fields of
            :class:`warp_caustics.capture.shot.Shot`.
    """
    return calibrated(Shot(image, scene, **known))


def calibrated(shot: Shot) -> Capture:
    """Calibrate one frame of a caustic. No channel is made up, and nothing is resized without a registration.

    Without a flat field, floats are W/m^2 already, and integers are scaled so
    that each channel's mean is that of a flat plate (with a warning).

    Returns:
        Irradiance, its noise, the mask of usable pixels, and what was done.

    Raises:
        MismatchError: image, frames and scene do not belong together.
        InputError: a value that cannot be used, or an image without light.
    """
    scene = shot.scene
    order, channels = _channels(shot)
    _check_frames(shot)
    shot = _around_window(shot).part(order, slice(None), slice(None))
    exposures = checked_exposures(shot.exposure, scene.n_wavelengths)
    work = _started(shot, channels)
    _warn_of_saturation(work, shot)
    offset = take_dark(work, shot)
    if shot.flat is not None:
        take_flat(work, shot.flat, offset)
    if shot.hot_pixels:
        replace_hot_pixels(work, None if shot.dark is None else shot.dark.values.astype(np.float64))
    if shot.mixing is not None:
        unmix(work, shot.mixing, scene.wavelengths_m)
    if shot.flat is not None:
        divide_by_flat(work, exposures)
        if shot.dark is None and shot.flat_dark is None:
            work.warnings.append(
                "no dark frame: the camera's offset lowers the contrast; record one with the light off"
            )
    share = work.in_window(saturated(shot.image)).mean(axis=-1)
    factor = 1.0 if shot.registration is None else resample(work, shot.registration, scene.image_pixels)
    if shot.flat is None:
        scale_without_flat(work, shot)
    elif is_near(scene):
        restore_falloff(work, scene)
    warn_of_energy(work)
    noise = [
        factor * estimate_noise_std(signal, level, mask)
        for signal, level, mask in zip(work.signal, work.level, work.mask, strict=True)
    ]
    amplified = 1.0 if shot.blur_px is None else sharpen(work, shot.blur_px)
    return Capture(
        irradiance=work.signal.astype(np.float32),
        noise_std=amplified * np.array(noise),
        saturated_fraction=share if shot.mixing is None else np.full(scene.n_wavelengths, share.max()),
        mask=work.mask,
        warnings=tuple(work.warnings),
        steps=work.steps,
        stages=tuple(work.stages),
    )


def _channels(shot: Shot) -> tuple[list[int], str]:
    """Channels of the file in the order of the scene or of the mixing matrix, and how that is known."""
    if shot.mixing is None:
        return channel_order(shot.image, shot.scene.wavelengths_m, shot.wavelength_order)
    count = len(shot.image.values)
    if shot.wavelength_order is not None:
        raise InputError("wavelength_order and mixing exclude each other; the matrix says what each channel sees")
    check_mixed_count(count, shot.mixing)
    return list(range(count)), f"{count} camera channels, in the order of the mixing matrix"


def _check_frames(shot: Shot) -> None:
    if shot.registration is None:
        check_size(*shot.shape, shot.scene.image_pixels)
    for kind, frame in shot.calibration_frames().items():
        check_frame(frame, shot.image, kind)
    if shot.registration is not None:
        check_in_photo(shot.registration, *shot.shape)


def _around_window(shot: Shot) -> Shot:
    """The part of the frames in which the window lies, with its place on record."""
    registration = shot.registration
    if registration is None:
        return shot
    text = registration.notes[0] if registration.notes else "window known"
    corners = preview_marks(registration.corners_px(), shot.shape)
    stage = CaptureStage("location", text, preview(shot.image.values), None, corners, dict(registration.figures))
    rows, columns = registration.box(*shot.shape, MARGIN_PX)
    part = shot.part(slice(None), rows, columns)
    return replace(part, registration=registration.cropped((rows, columns)), stages=(*shot.stages, stage))


def _started(shot: Shot, channels: str) -> Work:
    """The state before the first step.

    Raises:
        InputError: an image without light.
    """
    scene, frames = shot.scene, shot.calibration_frames()
    work = Work(
        signal=shot.image.values.astype(np.float64),
        mask=~saturated(shot.image),
        level=np.array(scene.radiosity_W_m2),
        labels=[f"{wavelength * 1e9:.4g} nm" for wavelength in scene.wavelengths_m],
        region=None if shot.registration is None else shot.registration.inside(*shot.shape),
        warnings=[
            *shot.image.warnings,
            *(f"{kind}: {line}" for kind, frame in frames.items() for line in frame.warnings),
        ],
        steps=[stage.text for stage in shot.stages] + [channels],
        stages=[*shot.stages, CaptureStage("channels", channels)],
    )
    if not work.in_window(work.signal).any():
        raise InputError("the image is black; record it again")
    return work


def _warn_of_saturation(work: Work, shot: Shot) -> None:
    shares = work.in_window(~work.mask).mean(axis=-1)
    for channel, share in enumerate(shares):
        if share > MAX_SATURATED:
            label = work.labels[channel] if len(shares) == len(work.labels) else f"channel {channel}"
            work.warnings.append(f"{label}: {share:.1%} of the pixels are saturated (limit 1 %); expose shorter")
    if shot.flat is not None and shot.image.full_scale is None:
        work.warnings.append(
            "the image holds floats: saturated pixels cannot be recognised; give the camera's integers"
        )


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


def check_size(height: int, width: int, m: int) -> None:
    """Refuse a frame that is not the window of m x m pixels.

    Raises:
        MismatchError: another size.
    """
    if (height, width) == (m, m):
        return
    fix = f"crop and resample it to the window, or --set scene.image_pixels={height}"
    if height != width:
        fix = "crop it to the square window"
    elif height % m == 0:
        k = height // m
        fix = f"average blocks of {k} x {k} pixels, or --set scene.image_pixels={height}"
    raise MismatchError(f"the image is {width} x {height} pixels, the scene has {m} x {m}; {fix}, or give its corners")


def scale_without_flat(work: Work, shot: Shot) -> None:
    """Turn counts into W/m^2 by what is known besides a flat field.

    Raises:
        InputError: the image holds no light.
    """
    image, before = shot.image, preview(work.signal)
    if shot.exposure is not None:
        counts = checked_exposures(shot.exposure, len(work.signal))
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


def warn_of_energy(work: Work) -> None:
    """A plate conserves light: the mean of the window is near L_i."""
    for label, signal, level in zip(work.labels, work.signal, work.level, strict=True):
        ratio = float(signal.mean() / level) if level > 0 else 1.0
        if not 0.5 <= ratio <= 1.2:
            work.warnings.append(
                f"{label}: the mean irradiance is {ratio:.3g} times that of a flat plate, a plate conserves light; "
                "check exposure, flat field and units"
            )
