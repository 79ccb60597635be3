"""From the photo's pixels to those of the scene's window, in one step.

A camera that looks at a diffusing screen measures radiance, which does not
change with distance or with the size of a pixel on the screen. A window pixel
is therefore the mean of what the photo shows over its square; no Jacobian
enters. The same holds for a photo divided by its flat field.

The photo's pixels are means over squares themselves. The spline here is the
one whose means over those squares are the photo's values (coefficients of a
B-spline of one degree more), so that a photo of exactly the window comes back
unchanged, and the integral over any part is that of the photo.

Not handled: a screen that is no Lambertian diffuser (its brightness then
depends on the angle; a flat field of the same view removes that).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from warp_caustics.capture.preview import preview, preview_marks
from warp_caustics.capture.registration import Registration, window_positions_m
from warp_caustics.capture.stage import CaptureStage, Work
from warp_caustics.io.noise import BoolImage, FloatImage, estimate_noise_std

MIN_SHARE = 0.75
"""Part of a window pixel that must come from pixels with a measurement; with less it is masked."""
SMOOTH_SCALE = 2.0
"""From so many camera pixels per window pixel on, a linear spline does what a cubic one does."""
MIN_SCALE = 0.9
"""Camera pixels per window pixel below which the photo cannot show what the scene resolves."""
MIN_SAMPLES, MAX_SAMPLES = 4, 24
"""Points per side of a window pixel at which the photo is read."""
BLOCK_POINTS = 1 << 22
MARGIN_PX = 24
"""Pixels kept around the window: a spline's coefficients forget what is further away."""


def resample(work: Work, registration: Registration, pixels: int) -> float:
    """Take the signal to the window of ``pixels`` per side; returns what the noise estimate must be multiplied by."""
    from scipy import ndimage

    assert work.region is not None
    shape = work.region.shape
    before, corners = preview(work.signal), preview_marks(registration.corners_px(), shape)
    if work.light is None:
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


@dataclass(frozen=True, eq=False)
class Resampling:
    """A plan to take photos of one view to the window.

    Attributes:
        registration: where the window lies.
        pixels: m.
        photo_shape: height and width of the photos [px].
        crop: rows and columns of the photo that matter.
        scale: camera pixels per window pixel, smallest and largest over the window.
    """

    registration: Registration
    pixels: int
    photo_shape: tuple[int, int]
    crop: tuple[slice, slice]
    scale: tuple[float, float]

    @property
    def samples(self) -> int:
        """Points per side of a window pixel."""
        return min(MAX_SAMPLES, max(MIN_SAMPLES, math.ceil(1.5 * self.scale[1])))

    def apply(self, photos: Sequence[FloatImage], degrees: Sequence[int | None] | None = None) -> list[FloatImage]:
        """Means of photos of one view over each window pixel.

        Args:
            photos: single channels, each of shape [H, W]; no NaN.
            degrees: of the spline for each; None is chosen by the scale, 0 takes each camera pixel as constant.

        Returns:
            Values, each of shape [m, m].
        """
        from scipy import ndimage

        chosen = 1 if self.scale[0] >= SMOOTH_SCALE else 3
        orders = [chosen if degree is None else degree for degree in degrees or [None] * len(photos)]
        coefficients = [
            ndimage.spline_filter(photo[self.crop], order=order + 1, mode="reflect") if order else photo[self.crop]
            for photo, order in zip(photos, orders, strict=True)
        ]
        results = [np.empty((self.pixels, self.pixels)) for _ in photos]
        k = self.samples
        for rows, points in self._blocks():
            for result, part, order in zip(results, coefficients, orders, strict=True):
                mode = "reflect" if order else "nearest"
                values = ndimage.map_coordinates(part, points, order=order, mode=mode, prefilter=False)
                result[rows] = values.reshape(rows.stop - rows.start, k, self.pixels, k).mean(axis=(1, 3))
        return results

    def _blocks(self) -> Iterator[tuple[slice, FloatImage]]:
        """Rows of the window, and the points (row, column) of the crop at which they are read, shape [2, ...]."""
        k = self.samples
        offsets = (np.arange(k) + 0.5) / k - 0.5
        columns = (np.arange(self.pixels)[:, None] + offsets).ravel()
        step = max(1, BLOCK_POINTS // (self.pixels * k * k))
        start = np.array([self.crop[0].start, self.crop[1].start], dtype=np.float64)[:, None, None]
        for first in range(0, self.pixels, step):
            rows = slice(first, min(first + step, self.pixels))
            fine = (np.arange(rows.start, rows.stop)[:, None] + offsets).ravel()
            position = window_positions_m(fine, columns, self.pixels, self.registration.plate_size_m)
            yield rows, np.moveaxis(self.registration.to_photo(position), -1, 0)[::-1] - start


def planned(registration: Registration, pixels: int, photo_shape: tuple[int, int]) -> Resampling:
    """Plan the way of photos [H, W] to a window of ``pixels`` per side."""
    box = registration.box(*photo_shape, MARGIN_PX)
    coarse = np.linspace(0, pixels - 1, 17)
    step = 1e-3
    here = registration.to_photo(window_positions_m(coarse, coarse, pixels, registration.plate_size_m))
    along = [
        (registration.to_photo(window_positions_m(coarse + dr, coarse + dc, pixels, registration.plate_size_m)) - here)
        / step
        for dr, dc in ((0.0, step), (step, 0.0))
    ]
    sizes = np.stack([np.linalg.norm(direction, axis=-1) for direction in along])
    return Resampling(registration, pixels, photo_shape, box, (float(sizes.min()), float(sizes.max())))


def to_window(signal: FloatImage, valid: BoolImage, plan: Resampling) -> tuple[FloatImage, BoolImage]:
    """Take a photo to the window; pixels without a measurement carry no weight.

    Args:
        signal: photo, shape [C, H, W]; finite everywhere.
        valid: pixels that hold a measurement, shape [C, H, W].
        plan: the way.

    Returns:
        Values and mask, shape [C, m, m].
    """
    count = len(signal)
    photos = [_filled(photo, good, plan) for photo, good in zip(signal, valid, strict=True)]
    shares = [good.astype(np.float64) for good in valid]
    results = plan.apply(photos + shares, [None] * count + [0] * count)
    return np.stack(results[:count]), np.stack(results[count:]) >= MIN_SHARE


def _filled(photo: FloatImage, good: BoolImage, plan: Resampling) -> FloatImage:
    """The photo with the nearest measurement where there is none, so that a dark surround does not ring inwards."""
    from scipy import ndimage

    part, usable = photo[plan.crop], good[plan.crop]
    if usable.all() or not usable.any():
        return photo
    nearest = ndimage.distance_transform_edt(~usable, return_distances=False, return_indices=True)
    filled = photo.copy()
    filled[plan.crop] = part[tuple(nearest)]
    return filled


def noise_factor(plan: Resampling, seed: int = 0) -> float:
    """True over estimated standard deviation of white camera noise after resampling.

    Resampled noise is correlated between pixels, which the estimator takes for structure. The factor is measured by
    sending white noise the same way. Below about 0.7 camera pixels per window pixel the structure of a caustic adds to
    the estimate: 20 % at 0.6.
    """
    noise = np.zeros(plan.photo_shape)
    part = noise[plan.crop]
    part[...] = np.random.default_rng(seed).normal(0.0, 0.01, part.shape)
    (probe,) = plan.apply([noise])
    estimated = estimate_noise_std(1.0 + probe, 1.0)
    return float(probe.std() / estimated) if estimated > 0 else 1.0
