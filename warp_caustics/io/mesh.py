"""The plate as a printable solid, in millimetres.

x is right (columns), y grows with the row, z is up; the flat bottom is z = 0
and the plate is centred on x = y = 0. Samples sit at cell centres, so the
surface is continued flat over the outermost half cell to reach the plate's
edge. The top is triangulated, not smoothed: between samples it departs from
the optical spline by at most about pitch^2 / 8 times the curvature.
"""

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from warp_caustics.errors import InputError
from warp_caustics.io.atomic import PathLike, atomic_path

if TYPE_CHECKING:
    from trimesh import Trimesh

_MM_PER_M = 1e3
_SUFFIXES = (".stl", ".ply", ".obj")


def _axis_mm(samples: int, extent_m: float) -> npt.NDArray[np.float64]:
    """Plate edge, cell centres, plate edge along one axis [mm], shape [samples + 2]."""
    centres = (np.arange(samples) + 0.5) / samples - 0.5
    return np.concatenate([[-0.5], centres, [0.5]]) * extent_m * _MM_PER_M


def _top_faces(side: int) -> npt.NDArray[np.int64]:
    """Two triangles per cell of a side x side grid of vertices, seen counter-clockwise from above."""
    index = np.arange(side * side).reshape(side, side)
    here, right = index[:-1, :-1].ravel(), index[:-1, 1:].ravel()
    below, diagonal = index[1:, :-1].ravel(), index[1:, 1:].ravel()
    return np.concatenate([np.stack([here, right, diagonal], 1), np.stack([here, diagonal, below], 1)])


def _rim(side: int) -> npt.NDArray[np.int64]:
    """Vertices around the grid, counter-clockwise from above, shape [4 (side - 1)]."""
    index = np.arange(side * side).reshape(side, side)
    return np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])


def _check_solid(heights: npt.NDArray[np.float64], plate_size_m: tuple[float, float], base_m: float) -> None:
    if heights.ndim != 2 or heights.shape[0] != heights.shape[1] or heights.shape[0] < 2:
        raise InputError(f"heights have shape {heights.shape}; give a square map [n, n] of at least 2 x 2 samples")
    if not np.isfinite(heights).all():
        row, column = np.argwhere(~np.isfinite(heights))[0]
        raise InputError(f"height at [{row}, {column}] is {heights[row, column]}; give finite heights")
    if not all(0 < size <= 1 for size in plate_size_m):
        raise InputError(f"plate size {plate_size_m} is not between 0 and 1 m; give metres")
    if not 0 < base_m <= 1:
        raise InputError(f"base thickness {base_m:g} m is not between 0 and 1 m; give metres")
    thickness = base_m + heights
    if thickness.min() <= 0:
        row, column = np.unravel_index(int(thickness.argmin()), thickness.shape)
        raise InputError(
            f"the plate is {thickness.min() * 1e3:.4g} mm thick at [{row}, {column}] "
            f"(base {base_m * 1e3:g} mm, height {heights[row, column] * 1e3:.4g} mm); thicken the base"
        )


def height_field_mesh(
    heights_m: npt.ArrayLike, plate_size_m: float | tuple[float, float], base_thickness_m: float
) -> "Trimesh":
    """Watertight solid of plate and relief, in millimetres, with normals outwards.

    Args:
        heights_m: relief above the base [m], shape [n, n].
        plate_size_m: extent of the plate [m], one number or (x, y).
        base_thickness_m: thickness without relief [m].

    Returns:
        A mesh of 2 (n + 1)^2 triangles on top, 8 (n + 1) on the sides and 4 (n + 1) below.

    Raises:
        InputError: no square, finite map, lengths that are no metres, or a plate without thickness somewhere.
    """
    import trimesh

    heights = np.asarray(heights_m, dtype=np.float64)
    size = (plate_size_m, plate_size_m) if isinstance(plate_size_m, int | float) else plate_size_m
    _check_solid(heights, size, base_thickness_m)
    n = len(heights)
    side = n + 2
    z = (base_thickness_m + np.pad(heights, 1, mode="edge")) * _MM_PER_M
    y, x = np.meshgrid(_axis_mm(n, size[1]), _axis_mm(n, size[0]), indexing="ij")
    top = np.stack([x, y, z], axis=-1).reshape(-1, 3)

    rim = _rim(side)
    following = np.roll(rim, -1)
    below = len(top) + np.arange(len(rim))
    below_following = np.roll(below, -1)
    centre = np.full(len(rim), len(top) + len(rim))
    bottom = np.concatenate([top[rim] * [1, 1, 0], [[0, 0, 0]]])
    faces = np.concatenate(
        [
            _top_faces(side),
            np.stack([below, below_following, following], 1),
            np.stack([below, following, rim], 1),
            np.stack([below_following, below, centre], 1),
        ]
    )
    mesh = trimesh.Trimesh(vertices=np.concatenate([top, bottom]), faces=faces, process=False)
    mesh.units = "mm"
    return mesh


def write_mesh(path: PathLike, mesh: "Trimesh") -> None:
    """Write a solid for printing, in its own millimetres; it appears complete or not at all.

    None of the formats records a unit; say millimetres when handing the file on.

    Args:
        path: .stl (binary), .ply (binary) or .obj.
        mesh: a closed solid, for example of :func:`height_field_mesh`.

    Raises:
        InputError: unknown suffix, or a mesh that is not a closed solid.
        ResourceError: the disk is full.
    """
    suffix = Path(os.fspath(path)).suffix.lower()
    if suffix not in _SUFFIXES:
        raise InputError(f"suffix {suffix!r} of {os.fspath(path)!r} is not known; use one of {', '.join(_SUFFIXES)}")
    if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0):
        raise InputError("the mesh is not a closed solid with normals outwards; it would not print, repair it")
    with atomic_path(path) as temporary:
        mesh.export(str(temporary), file_type=suffix[1:])
