"""A relief from a file of either kind: a height map, or the lines that it is printed from."""

import os

from warp_caustics.errors import MismatchError
from warp_caustics.io.atomic import PathLike
from warp_caustics.io.heights import read_heights
from warp_caustics.prints.design_file import design_relief, is_design, read_design
from warp_caustics.prints.line import line_relief
from warp_caustics.prints.line_list import is_line_list, read_lines
from warp_caustics.types import FloatArray


def read_relief(path: PathLike, samples: int, plate_size_m: tuple[float, float], role: str) -> FloatArray:
    """Read a height map of a scene, or draw one from a design or a list of printed lines of raised-cosine section.

    Args:
        path: height map in metres (.npy, .npz, .tif, .h5), or list of lines or design (.csv, .yaml).
        samples: n, height samples of the scene per side.
        plate_size_m: extent of the plate along x and y [m].
        role: what the relief is, for messages.

    Returns:
        Relief above the base [m], float64, shape [n, n].

    Raises:
        MismatchError: a map of another shape.
        InputError: a file that cannot be used.
    """
    if is_line_list(path):
        if is_design(path):
            return design_relief(read_design(path), samples, plate_size_m)
        return line_relief(read_lines(path), samples, plate_size_m)

    def fits(n: int) -> None:
        if n != samples:
            raise MismatchError(
                f"{role} {os.fspath(path)!r} has shape {[n, n]}, the scene [{samples}, {samples}]; "
                f"resample it, or --set scene.height_samples={n}"
            )

    return read_heights(path, fits=fits)
