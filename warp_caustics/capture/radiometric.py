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
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from warp_caustics.capture.calibration import (
    Work,
    check_frame,
    check_size,
    checked_exposures,
    divide_by_flat,
    scale_without_flat,
    smoothed_dark,
    subtract_dark,
    warn_of_energy,
)
from warp_caustics.capture.hot_pixels import MAX_SHARE, dead_in_flat, hot_in_dark, odd_among_neighbours, replaced
from warp_caustics.capture.mixing import WARN_CONDITION, Mixing, unmixed
from warp_caustics.capture.preview import preview, preview_marks
from warp_caustics.capture.registration import Registration, check_in_photo
from warp_caustics.capture.resample import MARGIN_PX, noise_factor, planned, to_window
from warp_caustics.capture.sharpening import sharpen
from warp_caustics.capture.stage import CaptureStage
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.channels import channel_order, in_nm
from warp_caustics.io.image_file import ImageFile
from warp_caustics.io.noise import BoolImage, FloatImage, estimate_noise_std

if TYPE_CHECKING:
    from warp_caustics.scene import Scene

SATURATION = 0.999
"""Part of full scale from which a pixel counts as saturated; sensors clip slightly below the last code."""
MAX_SATURATED = 0.01
MIN_SCALE = 0.9
"""Camera pixels per window pixel below which the photo cannot show what the scene resolves."""


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
        stages: the same with pictures and numbers.
    """

    irradiance: npt.NDArray[np.float32]
    noise_std: npt.NDArray[np.float64]
    saturated_fraction: npt.NDArray[np.float64]
    mask: BoolImage
    warnings: tuple[str, ...]
    steps: list[str]
    stages: tuple[CaptureStage, ...] = ()


def _saturated(image: ImageFile) -> BoolImage:
    if image.full_scale is None:
        return np.zeros(image.values.shape, bool)
    return np.asarray(image.values >= SATURATION * image.full_scale)


def capture_to_irradiance(
    image: ImageFile,
    *,
    scene: "Scene",
    dark: ImageFile | None = None,
    flat: ImageFile | None = None,
    flat_dark: ImageFile | None = None,
    wavelength_order: str | Sequence[float] | None = None,
    exposure: float | Sequence[float] | None = None,
    registration: Registration | None = None,
    mixing: Mixing | None = None,
    hot_pixels: bool = False,
    blur_px: float | None = None,
    is_dark_subtracted: bool = False,
    stages: Sequence[CaptureStage] = (),
) -> Capture:
    """Calibrate one frame of a caustic. No channel is made up, and nothing is resized without a registration.

    Without a flat field, floats are W/m^2 already, and integers are scaled so
    that each channel's mean is that of a flat plate (with a warning).

    Args:
        image: the frame, shape [C, H, W]; exactly the window, [n_w, m, m], without registration.
        scene: gives wavelengths, their L_i [W/m^2] and the number of pixels.
        dark: the same camera and exposure with the light off, shape [C, H, W].
        flat: the same camera with a flat plate, shape [C, H, W].
        flat_dark: dark frame of the flat field's exposure; ``dark`` if not given.
        wavelength_order: wavelength of each file channel, as text in nanometres ("610,530,430") or as numbers in
            metres. Not given: as the file records, else longest first.
        exposure: with a flat field, exposure of the image divided by that of the flat; without one, value in the
            file per W/m^2. One number, or one per wavelength of the scene.
        registration: where the window lies in the frame; the frame is then taken to the window's pixels.
        mixing: how camera channels see the wavelengths; channels are then unmixed, and their order is the matrix's.
        hot_pixels: look for pixels that stand out of the dark frame or of all their neighbours; they are replaced and
            masked.
        blur_px: standard deviation of the blur of lens and sensor [pixels of the window], to be divided out.
        is_dark_subtracted: the image holds no offset any more; ``dark`` is for the flat field only.
        stages: what was done before, to go first on record.

    Returns:
        Irradiance, its noise, the mask of usable pixels, and what was done.

    Raises:
        MismatchError: image, frames and scene do not belong together.
        InputError: an argument that cannot be used, or an image without light.
    """
    order, channel_step = _channels(image, scene, wavelength_order, mixing)
    height, width = image.values.shape[1:]
    named = (("dark frame", dark), ("flat field", flat), ("dark frame of the flat field", flat_dark))
    frames = {kind: frame for kind, frame in named if frame is not None}
    if registration is None:
        check_size(image, scene.image_pixels)
    for kind, frame in frames.items():
        check_frame(frame, image, kind)
    if registration is not None:
        check_in_photo(registration, height, width)
        stages = (*stages, _location(image, registration))
        box = registration.box(height, width, MARGIN_PX)
        registration = registration.cropped(box)
        image = _cropped(image, box)
        dark, flat, flat_dark = (frame and _cropped(frame, box) for frame in (dark, flat, flat_dark))
        height, width = image.values.shape[1:]
    exposures = checked_exposures(exposure, scene.n_wavelengths)
    saturated = _saturated(image)[order]
    work = Work(
        signal=image.values[order].astype(np.float64),
        mask=~saturated,
        level=np.array(scene.radiosity_W_m2),
        labels=[f"{wavelength * 1e9:.4g} nm" for wavelength in scene.wavelengths_m],
        region=None if registration is None else registration.inside(height, width),
        warnings=[*image.warnings, *(f"{kind}: {line}" for kind, frame in frames.items() for line in frame.warnings)],
        steps=[stage.text for stage in stages] + [channel_step],
        stages=[*stages, CaptureStage("channels", channel_step)],
    )
    if not work.in_window(work.signal).any():
        raise InputError("the image is black; record it again")
    _warn_saturation(work, saturated, image, calibrated=flat is not None)
    offset = _flat_offset(work, dark, flat_dark, order, is_dark_subtracted)
    light = None if flat is None else _flat_light(work, flat, order, offset)
    if hot_pixels:
        light = _hot_pixels(work, None if dark is None else dark.values[order].astype(np.float64), light)
    if mixing is not None:
        light = _unmix(work, mixing, scene, light)
    if light is not None:
        divide_by_flat(work, light, exposures)
        if dark is None and flat_dark is None:
            work.warnings.append(
                "no dark frame: the camera's offset lowers the contrast; record one with the light off"
            )
    share = work.in_window(saturated).mean(axis=-1)
    factor = 1.0 if registration is None else _resample(work, registration, scene.image_pixels, light is not None)
    if light is None:
        scale_without_flat(work, image, exposure)
    warn_of_energy(work)
    noise = [
        factor * estimate_noise_std(signal, level, mask)
        for signal, level, mask in zip(work.signal, work.level, work.mask, strict=True)
    ]
    amplified = 1.0 if blur_px is None else sharpen(work, blur_px)
    return Capture(
        irradiance=work.signal.astype(np.float32),
        noise_std=amplified * np.array(noise),
        saturated_fraction=share if mixing is None else np.full(scene.n_wavelengths, share.max()),
        mask=work.mask,
        warnings=tuple(work.warnings),
        steps=work.steps,
        stages=tuple(work.stages),
    )


def _cropped(frame: ImageFile, box: tuple[slice, slice]) -> ImageFile:
    return replace(frame, values=frame.values[:, box[0], box[1]])


def _location(image: ImageFile, registration: Registration) -> CaptureStage:
    corners = preview_marks(registration.corners_px(), image.values.shape[1:])
    text = registration.notes[0] if registration.notes else "window known"
    return CaptureStage("location", text, preview(image.values), None, corners, dict(registration.figures))


def _channels(
    image: ImageFile, scene: "Scene", requested: str | Sequence[float] | None, mixing: Mixing | None
) -> tuple[list[int], str]:
    if mixing is None:
        return channel_order(image, scene.wavelengths_m, requested)
    count = len(image.values)
    if requested is not None:
        raise InputError("wavelength_order and mixing exclude each other; the matrix says what each channel sees")
    if count != len(mixing.matrix):
        raise MismatchError(
            f"the mixing matrix has {len(mixing.matrix)} rows, the image {count} channels; give one row per channel"
        )
    return list(range(count)), f"{count} camera channels, in the order of the mixing matrix"


def _warn_saturation(work: Work, saturated: BoolImage, image: ImageFile, calibrated: bool) -> None:
    shares = work.in_window(saturated).mean(axis=-1)
    for channel, share in enumerate(shares):
        if share > MAX_SATURATED:
            label = work.labels[channel] if len(shares) == len(work.labels) else f"channel {channel}"
            work.warnings.append(f"{label}: {share:.1%} of the pixels are saturated (limit 1 %); expose shorter")
    if calibrated and image.full_scale is None:
        work.warnings.append(
            "the image holds floats: saturated pixels cannot be recognised; give the camera's integers"
        )


def _flat_offset(
    work: Work, dark: ImageFile | None, flat_dark: ImageFile | None, order: list[int], is_dark_subtracted: bool
) -> Any:
    """Subtract the dark frame from the signal; returns what to subtract from the flat field."""
    offset: Any = 0.0
    if dark is not None:
        own = dark.values[order].astype(np.float64)
        offset = smoothed_dark(own)[0] if is_dark_subtracted else subtract_dark(work, own)
    if flat_dark is not None:
        offset = smoothed_dark(flat_dark.values[order].astype(np.float64))[0]
    return offset


def _hot_pixels(work: Work, dark: FloatImage | None, flat: FloatImage | None) -> FloatImage | None:
    """Replace and mask pixels that lie; returns the flat field without them."""
    before = preview(work.signal)
    bad = np.stack([odd_among_neighbours(signal) for signal in work.signal])
    bad &= work.mask  # a saturated pixel is none
    by_neighbours = int(bad.sum())
    if dark is not None:
        bad |= np.stack([hot_in_dark(frame) for frame in dark])
    if flat is not None:
        bad |= np.stack([dead_in_flat(frame, work.region) for frame in flat])
    share = float(bad.mean())
    if share > MAX_SHARE:
        work.warnings.append(
            f"{share:.1%} of the pixels look hot (limit {MAX_SHARE:.0%}), which no sensor has; they were kept. "
            "Check the dark frame, or say hot_pixels: false"
        )
        return flat
    work.signal = np.stack([replaced(signal, odd) for signal, odd in zip(work.signal, bad, strict=True)])
    work.mask &= ~bad
    count = int(bad.sum())
    text = f"{count} hot or dead pixels replaced and masked ({by_neighbours} of them stand out of their neighbours)"
    work.done("hot pixels", text, before, hot_pixels=float(count), by_neighbours=float(by_neighbours))
    marks = np.unique(np.argwhere(bad)[:, :0:-1], axis=0).astype(np.float64)
    last = work.stages.pop()
    shown = preview_marks(marks, work.signal.shape[1:])
    work.stages.append(CaptureStage(last.name, last.text, last.before, last.after, shown, last.figures))
    return None if flat is None else np.stack([replaced(frame, odd) for frame, odd in zip(flat, bad, strict=True)])


def _flat_light(work: Work, flat: ImageFile, order: list[int], offset: Any) -> FloatImage:
    """The flat field without offset, shape [C, H, W]; its saturated pixels are masked."""
    clipped = _saturated(flat)[order]
    share = float(work.in_window(clipped).mean())
    if share > MAX_SATURATED:
        raise InputError(f"{share:.1%} of the flat field is saturated; expose it shorter")
    work.mask &= ~clipped
    return np.asarray(flat.values[order] - offset, np.float64)


def _unmix(work: Work, mixing: Mixing, scene: "Scene", flat: FloatImage | None) -> FloatImage | None:
    """Turn camera channels into wavelengths; returns the flat field likewise."""
    matrix, condition = mixing.for_scene(scene.wavelengths_m), mixing.condition()
    before = preview(work.signal)
    light = None if flat is None else unmixed(flat, np.ones(flat.shape, bool), matrix)[0]
    work.signal, work.mask, rest = unmixed(work.signal, work.mask, matrix)
    text = f"{len(matrix)} channels unmixed to {in_nm(scene.wavelengths_m)}, condition number {condition:.3g}"
    figures = {"condition": condition}
    if np.isfinite(rest):
        figures["unexplained"] = rest
        text += f", {rest:.2%} of the signal unexplained"
        if rest > 0.05:
            work.warnings.append(
                f"the mixing matrix leaves {rest:.1%} of the signal unexplained (tolerance 5 %); measure it again"
            )
    if condition > WARN_CONDITION:
        work.warnings.append(
            f"the mixing matrix has condition number {condition:.3g} and multiplies noise by up to that "
            f"(limit {WARN_CONDITION:g}); use filters or wavelengths further apart"
        )
    work.done("unmixing", text, before, **figures)
    return light


def _resample(work: Work, registration: Registration, pixels: int, has_flat: bool) -> float:
    """Take the signal to the window; returns what the noise estimate must be multiplied by."""
    from scipy import ndimage

    assert work.region is not None
    shape = work.region.shape
    before, corners = preview(work.signal), preview_marks(registration.corners_px(), shape)
    if not has_flat:
        # A pixel across the border is partly dark; with a flat field that cancels.
        work.mask &= ndimage.binary_erosion(work.region)
    plan = planned(registration, pixels, (shape[0], shape[1]))
    if plan.scale[0] < MIN_SCALE:
        limit = int(pixels * plan.scale[0])
        work.warnings.append(
            f"the photo has {plan.scale[0]:.2f} camera pixels per pixel of the scene and is blurred beside it; "
            f"come closer, or set image_pixels of the scene to {limit}"
        )
    work.signal, work.mask = to_window(np.nan_to_num(work.signal), work.mask, plan)
    work.warnings.extend(registration.warnings)
    factor = noise_factor(plan)
    missing = float(1 - work.mask.mean())
    text = f"resampled to {pixels} x {pixels} pixels, {plan.scale[0]:.2f} to {plan.scale[1]:.2f} camera pixels each" + (
        "" if registration.distortion is None else ", lens distortion undone"
    )
    figures = {
        "scale_min": plan.scale[0],
        "scale_max": plan.scale[1],
        "noise_factor": factor,
        "missing_share": missing,
    }
    work.steps.append(text)
    work.stages.append(CaptureStage("window", text, before, preview(work.signal), corners, figures))
    work.region = None
    return factor
