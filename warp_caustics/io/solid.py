"""A plate's height map from a solid for printing (.stl, .ply, .obj), the reverse of ``mesh.py``.

Such files hold no unit; they are taken as millimetres, as printers do. The top
surface is sampled by vertical lines through the cells' centres: the height of a
triangle there is exact, of several triangles the highest counts. The solid may
lie anywhere; the middle of its outline is the plate's centre, its lowest point
the bottom face.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from warp_caustics.errors import DamagedDataError, InputError, MismatchError
from warp_caustics.height_field import cell_centres
from warp_caustics.io.atomic import PathLike, reason, regular_file
from warp_caustics.io.regular import open_regular
from warp_caustics.types import FloatArray

if TYPE_CHECKING:
    from warp_caustics.scene import Scene

SUFFIXES = (".stl", ".ply", ".obj")
MAX_BYTES = 500_000_000
MAX_CORNERS = 64
"""Of a face; plates are exported in triangles or quadrangles."""
_MAX_LINE_BYTES = 10_000
SIZE_TOLERANCE = 0.002
"""By this the outline may differ from the plate's size, relative to it."""
_M_PER_MM = 1e-3
_PAIRS = 4_000_000
"""Pairs of triangle and cell looked at in one go."""


def read_solid(path: PathLike, scene: "Scene") -> FloatArray:
    """Relief of a solid above the plate's base.

    Args:
        path: .stl, .ply or .obj, in millimetres.
        scene: gives plate size, base thickness and height samples n.

    Returns:
        Heights [m], shape [n, n]; row grows with +y, column with +x.

    Raises:
        InputError: no such file, or no plate.
        MismatchError: not as large as the scene's plate.
        DamagedDataError: a file that cannot be read.
    """
    import trimesh

    file = regular_file(path)
    name = repr(str(path))
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"{name} is no solid; give {', '.join(SUFFIXES)}")
    if file.stat().st_size > MAX_BYTES:
        raise InputError(f"{name} is larger than {MAX_BYTES // 1_000_000} MB; simplify the mesh")
    if file.suffix.lower() == ".obj":
        _check_faces(file, name)
    if file.suffix.lower() == ".stl":
        _check_length(file, name)
    try:
        # Without a resolver OBJ files load nothing beside themselves.
        mesh = trimesh.load_mesh(str(file), process=False, skip_materials=True)
        triangles = np.asarray(mesh.triangles, dtype=np.float64)
    except Exception as error:
        raise DamagedDataError(f"{name} cannot be read as a mesh ({reason(error)}); export it again") from error
    if len(triangles) == 0 or not np.isfinite(triangles).all():
        raise DamagedDataError(f"{name} holds no triangles, or some that are not finite; export it again")
    if triangles.shape[1:] != (3, 3):  # vertices of an OBJ file have as many numbers as its first one
        raise DamagedDataError(f"{name} has vertices of {triangles.shape[-1]} numbers, not 3; export it again")
    corners = triangles.reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    for axis, wanted in enumerate(scene.plate_size_m):
        size = (high[axis] - low[axis]) * _M_PER_MM
        if abs(size - wanted) > SIZE_TOLERANCE * wanted:
            raise MismatchError(
                f"{name} is {size * 1e3:.6g} mm along {'xy'[axis]}, the plate {wanted * 1e3:g} mm (files of this kind "
                "are read as millimetres); scale the solid, or set scene.plate_size_m"
            )
    moved = triangles - np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    n = scene.height_samples
    x, y = (cell_centres(n, length) for length in scene.plate_size_m)
    top = top_heights(moved * _M_PER_MM, x, y)
    if not np.isfinite(top).all():
        row, column = np.argwhere(~np.isfinite(top))[0]
        where = f"({x[column] * 1e3:.4g}, {y[row] * 1e3:.4g}) mm"
        raise InputError(f"{name} has a hole at {where} from its centre; give a closed solid of the whole plate")
    return top - scene.base_thickness_m


def _check_faces(file: Path, name: str) -> None:
    """A face of many corners is cut into triangles at a cost that grows faster than they do."""
    with open_regular(file) as stream:
        while line := stream.readline(_MAX_LINE_BYTES):
            if len(line) == _MAX_LINE_BYTES or (line[:2] == b"f " and len(line.split()) - 1 > MAX_CORNERS):
                raise InputError(f"{name} has a face of more than {MAX_CORNERS} corners; export triangles")


def _check_length(file: Path, name: str) -> None:
    """A binary STL file tells how many triangles it has: 80 bytes of text, their number, 50 bytes for each."""
    size = file.stat().st_size
    with open_regular(file) as stream:
        head = stream.read(1024)
    if size < 84 or (head.startswith(b"solid") and b"facet" in head):
        return
    count = int.from_bytes(head[80:84], "little")
    if size != 84 + 50 * count:
        raise DamagedDataError(
            f"{name} has {size} bytes, and the {count} triangles that it announces take {84 + 50 * count}; "
            "copy or export it again"
        )


def top_heights(triangles_m: FloatArray, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Highest z of triangles over each point of a grid.

    Args:
        triangles_m: corners [m], shape [T, 3, 3].
        x_m: rising positions of the columns [m], shape [W].
        y_m: of the rows [m], shape [H].

    Returns:
        z [m], shape [H, W]; -inf where there is no triangle.
    """
    top = np.full((len(y_m), len(x_m)), -np.inf)
    slack = 1e-9 * max(float(np.ptp(x_m)), float(np.ptp(y_m)), 1e-12)
    low, high = triangles_m.min(axis=1), triangles_m.max(axis=1)
    first_x, first_y = np.searchsorted(x_m, low[:, 0] - slack), np.searchsorted(y_m, low[:, 1] - slack)
    wide = np.searchsorted(x_m, high[:, 0] + slack, side="right") - first_x
    tall = np.searchsorted(y_m, high[:, 1] + slack, side="right") - first_y
    counts = wide * tall
    ends = np.cumsum(counts)
    start = 0
    while start < len(counts):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + _PAIRS, side="right")))
        part = np.repeat(np.arange(start, stop), counts[start:stop])
        place = np.arange(len(part)) - np.repeat(ends[start:stop] - counts[start:stop] - before, counts[start:stop])
        rows, columns = first_y[part] + place // wide[part], first_x[part] + place % wide[part]
        heights, inside = _heights_at(triangles_m[part], x_m[columns], y_m[rows])
        np.maximum.at(top, (rows[inside], columns[inside]), heights[inside])
        start = stop
    return top


def _heights_at(triangles_m: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """z of each triangle over its point, and whether the point lies in it; vertical triangles have none."""
    a, b, c = triangles_m[:, 0], triangles_m[:, 1], triangles_m[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (b[:, 1] - a[:, 1])
    flat = np.abs(area) > 1e-18
    safe = np.where(flat, area, 1.0)
    u = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (c[:, 0] - a[:, 0]) * (y - a[:, 1])) / safe
    v = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (x - a[:, 0]) * (b[:, 1] - a[:, 1])) / safe
    edge = 1e-6  # STL rounds to float32
    inside = flat & (u >= -edge) & (v >= -edge) & (u + v <= 1 + edge)
    return a[:, 2] + u * (b[:, 2] - a[:, 2]) + v * (c[:, 2] - a[:, 2]), inside


def is_solid(path: PathLike) -> bool:
    """Whether a file is a solid, by its suffix."""
    return Path(path).suffix.lower() in SUFFIXES
