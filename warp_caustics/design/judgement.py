"""How near a caustic comes to the wanted picture, and how hard its relief is to make."""

import math
from typing import Any

import numpy as np
import scipy.fft
import skimage.metrics

from warp_caustics.reconstruct.transport.ray_inversion import LightPath
from warp_caustics.reconstruct.transport.transport import relief_on_grid
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

DARK_PERCENT, BRIGHT_PERCENT = 1.0, 99.0
"""Percentiles of the irradiance that stand for dark and bright in the Michelson contrast."""

DETAIL_SHARE = 0.99
"""Share of the squared curvature, which makes the picture, in waves longer than the finest that matters."""

EDGE_SAMPLES = 4
"""Ring of samples where the surface bends to become level at the edge, as no made plate need do."""


def picture_figures(image: FloatArray, target: FloatArray, scene: Scene) -> dict[str, Any]:
    """Figures of a caustic against the picture.

    Args:
        image: caustic [W/m^2], shape [n_w, m, m].
        target: wanted irradiance in units of the radiosity, shape [m, m].
        scene: gives the radiosity.

    Returns:
        ``psnr_dB``, peak the target's highest irradiance; ``psnr_colours_dB`` over each wavelength instead of their
        mean; ``ssim``; ``residual``, ||image - target|| / ||target||; ``contrast_ratio``, standard deviation of the
        caustic over that of the target; ``michelson`` and ``target_michelson``, of the 1 % and 99 % quantiles;
        ``light_in_bright``, share of the plate's light that falls where the target is above its mean,
        ``target_light_in_bright`` what it should be, ``bright_area`` what an even light would have;
        ``light_in_window``, share of the plate's light that the window receives.
    """
    radiosity = np.asarray(scene.radiosity_W_m2)
    colours = image[radiosity > 0].astype(np.float64) / radiosity[radiosity > 0][:, None, None]
    mean = colours.mean(axis=0)
    error = mean - target
    bright = target > 1.0
    size = min(7, len(target) - (len(target) + 1) % 2)
    deviation = float(target.std())
    return {
        "psnr_dB": _psnr(error, target),
        "psnr_colours_dB": _psnr(colours - target, target),
        "ssim": float(skimage.metrics.structural_similarity(mean, target, data_range=target.max(), win_size=size))
        if size >= 3
        else None,
        "residual": float(np.linalg.norm(error) / np.linalg.norm(target)),
        "contrast_ratio": float(mean.std()) / deviation if deviation > 0 else None,
        "michelson": _michelson(mean),
        "target_michelson": _michelson(target),
        "light_in_bright": float((mean * bright).mean()),
        "target_light_in_bright": float((target * bright).mean()),
        "bright_area": float(bright.mean()),
        "light_in_window": float(mean.mean()),
    }


def _psnr(error: FloatArray, target: FloatArray) -> float:
    rms = float(np.sqrt(np.mean(error**2)))
    return 20 * math.log10(float(target.max()) / rms) if rms > 0 else math.inf


def _michelson(image: FloatArray) -> float:
    dark, bright = np.percentile(image, [DARK_PERCENT, BRIGHT_PERCENT])
    return float((bright - dark) / (bright + dark))


def relief_figures(heights_m: FloatArray, scene: Scene) -> dict[str, Any]:
    """What a maker must know of a relief.

    Args:
        heights_m: relief [m], shape [n, n].
        scene: plate, glass and screen.

    Returns:
        ``height_range_m``, highest minus lowest; ``max_slope`` and ``rms_slope`` [1]; ``total_reflection_share``,
        sine of the steepest path below the plate, 1 being total reflection; ``smallest_radius_m`` of curvature away
        from the edge, which a tool must fit into; ``finest_period_m``, see there: a process must resolve half of it;
        ``volume_mm3`` above the lowest point; ``diffraction_blur_m``, sqrt(wavelength distance), which no model here
        contains.
    """
    n = scene.height_samples
    pitch_x, pitch_y = scene.sample_pitch_m
    _, slopes = relief_on_grid(heights_m, n, scene.plate_size_m)
    steepness = np.sqrt((slopes**2).sum(0))
    path = LightPath.of_scene(scene)
    xx, xy = np.gradient(slopes[0], pitch_x, axis=1), np.gradient(slopes[0], pitch_y, axis=0)
    yy = np.gradient(slopes[1], pitch_y, axis=0)
    # Principal curvatures are the mean plus or minus this.
    spread = np.sqrt(((xx - yy) / 2) ** 2 + xy**2)
    ring = min(EDGE_SAMPLES, n // 8)
    curvature = float((np.abs(xx + yy) / 2 + spread)[ring : n - ring, ring : n - ring].max())
    wavelength_m = float(np.mean(scene.wavelengths_m))
    return {
        "height_range_m": float(np.ptp(heights_m)),
        "max_slope": float(steepness.max()),
        "rms_slope": float(np.sqrt(np.mean(steepness**2))),
        "total_reflection_share": _sideways(float(steepness.max()), path) / path.outside,
        "smallest_radius_m": 1 / curvature if curvature > 0 else None,
        "finest_period_m": finest_period_m(heights_m, scene.plate_size_m),
        "volume_mm3": float((heights_m - heights_m.min()).sum()) * pitch_x * pitch_y * 1e9,
        "diffraction_blur_m": math.sqrt(wavelength_m * path.gap_m / path.outside),
    }


def _sideways(slope: float, path: LightPath) -> float:
    """n sin(angle) of collimated light below a relief of this slope."""
    cosine = 1 / math.sqrt(1 + slope**2)
    return (math.sqrt(path.glass**2 - 1 + cosine**2) - cosine) * slope * cosine


def finest_period_m(heights_m: FloatArray, plate_size_m: tuple[float, float]) -> float | None:
    """Wavelength of the cosine modes below which 1 % of the squared curvature lies [m]; None for a flat plate."""
    n = len(heights_m)
    mode = np.arange(n) * math.pi
    waves = np.hypot(mode[None, :] / plate_size_m[0], mode[:, None] / plate_size_m[1])
    power = (scipy.fft.dctn(heights_m, norm="ortho") * waves**2) ** 2
    total = float(power.sum())
    if total <= 0 or np.ptp(heights_m) < 1e-12:
        return None
    order = np.argsort(waves, axis=None)
    reached = np.searchsorted(np.cumsum(power.ravel()[order]), DETAIL_SHARE * total)
    return 2 * math.pi / float(waves.ravel()[order][min(int(reached), n * n - 1)])
