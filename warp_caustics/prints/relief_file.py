"""A relief from a file of either kind: a height map, or the lines that it is printed from."""

import os

from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.atomic import PathLike
from warp_caustics.io.heights import MAX_HEIGHT_M, read_heights
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
            design = read_design(path)
            has_glass = any(max(drawn.heights_m) > 0 for drawn in design.paths)
            return _printed(design_relief(design, samples, plate_size_m), path, plate_size_m, has_glass=has_glass)
        lines = read_lines(path)
        has_glass = any(line.height_m > 0 for line in lines)
        return _printed(line_relief(lines, samples, plate_size_m), path, plate_size_m, has_glass=has_glass)

    def fits(n: int) -> None:
        if n != samples:
            raise MismatchError(
                f"{role} {os.fspath(path)!r} has shape {[n, n]}, the scene [{samples}, {samples}]; "
                f"resample it, or --set scene.height_samples={n}"
            )

    return read_heights(path, fits=fits)


def _printed(relief_m: FloatArray, path: PathLike, plate_size_m: tuple[float, float], *, has_glass: bool) -> FloatArray:
    """The relief of lines, if it is one: as for maps, what no print can be is a slip of the unit."""
    highest = float(relief_m.max())
    name = repr(os.fspath(path))
    if highest > MAX_HEIGHT_M:
        raise InputError(
            f"{name} piles lines up to {highest:.4g} m, above {MAX_HEIGHT_M:g} m; check the unit of heights"
        )
    if has_glass and highest <= 0:
        width, height = (f"{1e3 * length:g}" for length in plate_size_m)
        raise InputError(
            f"no line of {name} lies on the plate of {width} x {height} mm, whose middle is (0, 0); check the unit of "
            "its places, or set scene.plate_size_m"
        )
    return relief_m
