"""How far a recovered relief is from the true one."""

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.types import FloatArray


def height_errors(
    heights_m: FloatArray, reference_m: FloatArray, plate_size_m: tuple[float, float]
) -> dict[str, float]:
    """Errors of a relief against the true one, both above the base.

    Args:
        heights_m: recovered relief [m], shape [n, n].
        reference_m: true relief [m], shape [n, n].
        plate_size_m: extent along x and y [m].

    Returns:
        ``rmse_um``; ``rmse_mean_removed_um``, after subtracting the mean difference (one image
        hardly tells the absolute height); ``mean_error_um`` (recovered minus true);
        ``quantile95_um`` of the absolute error; ``max_error_um``; ``rmse_slope``, RMS of the
        slope difference [1]; ``reference_rms_um``, the error of a flat guess; ``volume_mm3`` and
        ``reference_volume_mm3`` of the print.

    Raises:
        InputError: shapes differ.
    """
    if heights_m.shape != reference_m.shape:
        raise InputError(
            f"heights have shape {list(heights_m.shape)}, the reference {list(reference_m.shape)}; resample one of them"
        )
    found, true = heights_m.astype(np.float64), reference_m.astype(np.float64)
    error = found - true
    rows, columns = error.shape
    pitch_x, pitch_y = plate_size_m[0] / columns, plate_size_m[1] / rows
    slope_y, slope_x = np.gradient(error, pitch_y, pitch_x)
    cell_mm3 = pitch_x * pitch_y * 1e9
    return {
        "rmse_um": _rms(error) * 1e6,
        "rmse_mean_removed_um": _rms(error - error.mean()) * 1e6,
        "mean_error_um": float(error.mean()) * 1e6,
        "quantile95_um": float(np.quantile(np.abs(error), 0.95)) * 1e6,
        "max_error_um": float(np.abs(error).max()) * 1e6,
        "rmse_slope": float(np.sqrt(np.mean(slope_x**2 + slope_y**2))),
        "reference_rms_um": _rms(true) * 1e6,
        "volume_mm3": float(found.sum()) * cell_mm3,
        "reference_volume_mm3": float(true.sum()) * cell_mm3,
    }


def relative_residual(image: FloatArray, measured: FloatArray) -> float:
    """||image - measured|| / ||measured|| over all pixels and wavelengths."""
    difference = image.astype(np.float64) - measured.astype(np.float64)
    return float(np.linalg.norm(difference) / np.linalg.norm(measured.astype(np.float64)))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
