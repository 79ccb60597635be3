"""Connected parts of a plate that are out of tolerance, with place, size and volume."""

from dataclasses import replace

import numpy as np
import scipy.ndimage
import skimage.measure

from warp_caustics.height_field import cell_centres
from warp_caustics.inspection.findings import Region
from warp_caustics.types import BoolArray, FloatArray


def regions(
    out: BoolArray, deviation_m: FloatArray, limit_m: FloatArray, plate_size_m: tuple[float, float]
) -> tuple[Region, ...]:
    """The parts of a plate that are out of tolerance, largest volume first.

    A part grows from its certain cells over all neighbours beyond the limit with the same sign, so that size and
    volume are those of the defect, not those of its certain core.

    Args:
        out: cells certainly out of tolerance, shape [n, n].
        deviation_m: measured minus nominal [m], shape [n, n].
        limit_m: largest deviation allowed [m], shape [n, n].
        plate_size_m: extent along x and y [m].
    """
    n = len(deviation_m)
    x, y = (cell_centres(n, length) for length in plate_size_m)
    pitch_x, pitch_y = (length / n for length in plate_size_m)
    found = []
    for sign in (1, -1):
        beyond = sign * deviation_m > limit_m
        seeds = out & beyond
        grown = scipy.ndimage.binary_propagation(seeds, structure=np.ones((3, 3)), mask=beyond)
        labels = skimage.measure.label(grown, connectivity=2)
        for part in skimage.measure.regionprops(labels):
            rows, columns = part.coords.T
            values = deviation_m[rows, columns]
            weight = np.abs(values)
            low_row, low_column, high_row, high_column = part.bbox
            found.append(
                Region(
                    number=0,
                    centre_m=(
                        float(np.average(x[columns], weights=weight)),
                        float(np.average(y[rows], weights=weight)),
                    ),
                    lower_m=(float(x[low_column] - pitch_x / 2), float(y[low_row] - pitch_y / 2)),
                    upper_m=(float(x[high_column - 1] + pitch_x / 2), float(y[high_row - 1] + pitch_y / 2)),
                    area_m2=float(part.area * pitch_x * pitch_y),
                    volume_m3=float(values.sum() * pitch_x * pitch_y),
                    peak_m=float(values[np.argmax(weight)]),
                )
            )
    found.sort(key=lambda region: -abs(region.volume_m3))
    return tuple(replace(region, number=number) for number, region in enumerate(found, 1))
