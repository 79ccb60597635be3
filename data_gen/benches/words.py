"""A bench in words, for pictures."""

from collections.abc import Mapping

import numpy as np


def bench_lines(record: Mapping[str, float]) -> list[str]:
    """A bench in a few lines, from its named numbers."""
    light = "collimated" if not record["is_point_source"] else f"lamp at {record['lamp_distance_m']:.2g} m"
    taken = "frames taken" if record["is_calibrated"] else "no frames"
    apart = max(
        np.hypot(record[f"colour_shift_x_px_{k}"], record[f"colour_shift_y_px_{k}"])
        for k in range(sum(name.startswith("psf_px_") for name in record))
    )
    return [
        f"gap {record['gap_m'] * 1e6:.0f} um, base {record['base_thickness_m'] * 1e3:.3f} mm",
        f"index {record['index_offset']:+.4f}, {light}",
        f"lamp {np.degrees(record['lamp_half_angle_rad']):.2f}, "
        f"aside {np.degrees(np.hypot(record['tilt_x_rad'], record['tilt_y_rad'])):.2f} degrees",
        f"PSF {record['psf_px_0']:.2f} px, colours {apart:.2f} px apart",
        f"ambient {record['ambient']:.1%}, mixing {record['mixing']:.1%}",
        f"noise {record['noise']:.1%}, speckle {record['speckle_contrast']:.1%}",
        f"{'mosaic, ' if record['has_mosaic'] else ''}{record['bits']:.0f} bits, {taken}",
    ]
