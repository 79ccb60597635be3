"""From files to a calibrated capture."""

import os
from typing import TYPE_CHECKING

import numpy as np

from warp_caustics.capture.bracketing import Merged, merged_exposures
from warp_caustics.capture.corners import located_window, read_window_file
from warp_caustics.capture.distortion import read_distortion
from warp_caustics.capture.frames import check_frame_shape
from warp_caustics.capture.hot_pixels import odd_among_neighbours, replaced
from warp_caustics.capture.mixing import Mixing, check_mixed_count, read_mixing
from warp_caustics.capture.preview import preview
from warp_caustics.capture.radiometric import calibrated, check_size
from warp_caustics.capture.registration import Registration
from warp_caustics.capture.settings import AUTO, CaptureSettings, check_consistent, is_capture_file
from warp_caustics.capture.shot import Capture, Shot
from warp_caustics.capture.stage import CaptureStage
from warp_caustics.errors import InputError
from warp_caustics.io.channels import check_channel_count
from warp_caustics.io.image_file import FitsCheck, ImageFile
from warp_caustics.io.noise import FloatImage

if TYPE_CHECKING:
    from warp_caustics.scene import Scene


def read_capture(
    image: str | os.PathLike[str] | None, scene: "Scene", settings: CaptureSettings | None = None
) -> Capture:
    """Read a photo and everything that calibrates it.

    Args:
        image: photo; or a capture file (.yaml), whose frames ``settings`` then hold; None likewise.
        scene: what the capture must fit.
        settings: how to read and calibrate; defaults if not given.

    Raises:
        CausticsError: a file that cannot be used, or files that do not belong together.
    """
    settings = settings or CaptureSettings()
    check_consistent(settings)
    mixing = None if settings.mixing is None else read_mixing(settings.mixing)
    fits = _fits_scene(scene, settings, mixing)
    merged = _merged(settings, fits) if image is None or is_capture_file(image) else None
    if merged is None:
        assert image is not None
        photo = _photo(image, settings, fits)
    else:
        photo = merged.image
    dark, flat, flat_dark = (
        _frame(getattr(settings, name), settings, photo, kind)
        for name, kind in (("dark", "dark frame"), ("flat", "flat field"), ("flat_dark", "dark frame of the flat"))
    )
    registration = _registration(settings, scene, photo, None if merged else dark, flat, flat_dark or dark)
    by_default = registration is not None or merged is not None
    shot = Shot(
        photo,
        scene,
        dark=dark,
        flat=flat,
        flat_dark=flat_dark,
        wavelength_order=settings.wavelength_order,
        exposure=_exposure(settings, merged, has_flat=flat is not None),
        registration=registration,
        mixing=mixing,
        hot_pixels=by_default if settings.hot_pixels is None else settings.hot_pixels,
        blur_px=settings.blur_px,
        is_dark_subtracted=merged is not None,
        stages=() if merged is None else (_merging(merged, settings),),
    )
    return calibrated(shot)


def _fits_scene(scene: "Scene", settings: CaptureSettings, mixing: Mixing | None) -> FitsCheck:
    """What a photo must satisfy, told from its header: nobody decodes pixels that the scene cannot use."""

    def fits(channels: int, rows: int, columns: int) -> None:
        if mixing is None:
            check_channel_count(channels, scene.wavelengths_m, settings.wavelength_order)
        else:
            check_mixed_count(channels, mixing)
        if settings.corners is None:
            check_size(rows, columns, scene.image_pixels)

    return fits


def _photo(path: str | os.PathLike[str], settings: CaptureSettings, fits: FitsCheck) -> ImageFile:
    from warp_caustics.io.images import read_image

    return read_image(path, page=settings.page, dataset=settings.dataset, transfer=settings.transfer, fits=fits)


def _frame(path: str | None, settings: CaptureSettings, photo: ImageFile, kind: str) -> ImageFile | None:
    from warp_caustics.io.images import read_image

    if path is None:
        return None
    return read_image(
        path, transfer=settings.transfer, fits=lambda *shape: check_frame_shape(shape, photo.values.shape, kind)
    )


def _merged(settings: CaptureSettings, fits: FitsCheck) -> Merged:
    if not settings.frames:
        raise InputError("the capture file lists no frames; write frames: [{file: a.tif, exposure_s: 0.01}, ...]")
    frames = [_photo(frame.file, settings, fits) for frame in settings.frames]
    dark = _frame(settings.dark, settings, frames[0], "dark frame")
    darks = [
        dark if frame.dark is None else _frame(frame.dark, settings, photo, "dark frame")
        for frame, photo in zip(settings.frames, frames, strict=True)
    ]
    return merged_exposures(frames, [frame.exposure_s for frame in settings.frames], darks)


def _merging(merged: Merged, settings: CaptureSettings) -> CaptureStage:
    times = ", ".join(f"{frame.exposure_s:g}" for frame in settings.frames)
    noise = ", ".join(f"{value:.3g}" for value in merged.noise_std)
    text = (
        f"{len(settings.frames)} exposures of {times} s merged, {merged.used:.2f} usable per pixel, "
        f"noise {noise} counts of the shortest"
    )
    figures = {f"brightness_of_frame_{i}": ratio for i, ratio in enumerate(merged.ratios, 1)}
    return CaptureStage("exposures", text, None, preview(merged.image.values), None, figures)


def _exposure(settings: CaptureSettings, merged: Merged | None, has_flat: bool) -> float | tuple[float, ...] | None:
    if merged is None or settings.exposure is not None or not has_flat:
        return settings.exposure
    if settings.flat_exposure_s is None:
        raise InputError(
            "frames have exposure times, the flat field has none; say flat_exposure_s, or exposure: shortest over flat"
        )
    return merged.exposure_s / settings.flat_exposure_s


def _registration(
    settings: CaptureSettings,
    scene: "Scene",
    photo: ImageFile,
    dark: ImageFile | None,
    flat: ImageFile | None,
    flat_dark: ImageFile | None,
) -> Registration | None:
    """Where the window lies; looked for in the flat field where there is one."""
    if settings.corners is None:
        return None
    source = None if settings.corners == AUTO else read_window_file(settings.corners)
    distortion = None if settings.distortion is None else read_distortion(settings.distortion)
    height, width = photo.values.shape[1:]
    if distortion is not None:
        distortion.check_image(height, width)
    seen = _brightness(photo, dark) if flat is None else _brightness(flat, flat_dark)
    return located_window(
        source,
        seen,
        scene,
        distortion=distortion,
        mirrored=settings.mirrored,
        turned_deg=settings.turned_deg,
    )


def _brightness(frame: ImageFile, dark: ImageFile | None) -> FloatImage:
    """Mean of all channels, each scaled to its brightest part, without hot pixels, shape [H, W]."""
    values = frame.values.astype(np.float64)
    if dark is not None and dark.values.shape == values.shape:
        values -= dark.values
    bright = np.percentile(values, 99, axis=(1, 2), keepdims=True)
    mean = np.asarray((values / np.where(bright > 0, bright, 1.0)).mean(axis=0))
    return replaced(mean, odd_among_neighbours(mean))
