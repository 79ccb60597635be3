"""What was to be printed: a height map, a solid or a list of lines; and the part of the plate that is judged."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from warp_caustics.data_gradient import lowest_height_m
from warp_caustics.errors import InputError, MismatchError

LARGEST_LINE_ERROR_M = 2e-6
"""A map is made of lines if they differ from it by no more than this [m]."""
MOST_THICKNESSES = 3.0
"""A design higher than so many thicknesses of its plate is taken for one in another unit, unless a person says it is
not: a line of Tab. 3 is at most 2 mm high, on a plate of 3 mm."""

if TYPE_CHECKING:
    from warp_caustics.prints.line import Line, Section
    from warp_caustics.scene import Scene
    from warp_caustics.types import FloatArray


@dataclass(frozen=True, eq=False)
class Nominal:
    """A plate as it was to be printed.

    Attributes:
        relief_m: heights [m], shape [n, n].
        lines: that make up the relief; empty if they are not known.
        section: of the lines.
        origin: one line on where it comes from.
    """

    relief_m: "FloatArray"
    lines: "tuple[Line, ...]" = ()
    section: "Section" = "cosine"
    origin: str = ""

    @classmethod
    def of_lines(cls, lines: "Sequence[Line]", scene: "Scene", section: "Section" = "cosine") -> "Nominal":
        """Of printed lines, on a scene's samples."""
        from warp_caustics.prints.line import line_relief

        relief = line_relief(lines, scene.height_samples, scene.plate_size_m, section=section)
        return cls(relief, tuple(lines), section, _told(lines, section))


def read_nominal(
    path: str, scene: "Scene", section: "Section" = "cosine", *, highest_m: float | None = None
) -> Nominal:
    """Read a design on a scene's samples.

    Args:
        path: list of lines or design (.csv, .yaml), solid in millimetres (.stl, .ply, .obj), or height map in metres.
        scene: gives plate size and number of samples.
        section: of the printed lines.
        highest_m: largest height that is believed [m]; ``MOST_THICKNESSES`` times the plate's thickness if None.

    Raises:
        InputError: a file that cannot be used, or a design higher than that.
        MismatchError: a solid of another size.
    """
    from warp_caustics.io.heights import read_heights
    from warp_caustics.io.solid import is_solid, read_solid
    from warp_caustics.prints.design_file import design_relief, is_design, read_design
    from warp_caustics.prints.line_list import is_line_list, read_lines

    n = scene.height_samples
    if is_line_list(path) and is_design(path):
        design = read_design(path)
        how = f"design {path!r} of {len(design.paths)} printed lines, compared as a map"
        printed = Nominal(design_relief(design, n, scene.plate_size_m), section=section, origin=how)
        return _checked(printed, path, scene, highest_m)
    if is_line_list(path):
        nominal = Nominal.of_lines(read_lines(path), scene, section)
        return _checked(replace(nominal, origin=f"{nominal.origin} of {path!r}"), path, scene, highest_m)
    if is_solid(path):
        how = f"top surface of {path!r}, read as millimetres, above a base of {scene.base_thickness_m * 1e3:g} mm"
        return _checked(Nominal(read_solid(path, scene), section=section, origin=how), path, scene, highest_m)
    heights: FloatArray = read_heights(path)
    how = f"height map {path!r}"
    if len(heights) != n:
        how += f", resampled from {len(heights)} to {n} samples per side ({_method(len(heights), n)})"
        heights = resampled(heights, n)
    return _checked(Nominal(heights, section=section, origin=how), path, scene, highest_m)


def with_lines(nominal: Nominal, path: str, scene: "Scene") -> Nominal:
    """A design with the printed lines that its relief is made of; one that has them already stays as it is.

    Args:
        nominal: on the scene's samples; its section is that of the lines.
        path: of its file, for messages.
        scene: gives plate size and number of samples.

    Raises:
        MismatchError: lines do not make the relief to within ``LARGEST_LINE_ERROR_M``.
    """
    import torch

    from warp_caustics.prints.model import Limits, LineModel, lines_of
    from warp_caustics.prints.vectorise import lines_of_relief

    if nominal.lines:
        return nominal
    limits = Limits(width_m=(5e-5, 1e-2), height_m=(5e-6, 1e-2))
    model, relief = LineModel(scene, nominal.section, limits=limits), torch.tensor(nominal.relief_m)
    rows = lines_of_relief(model, relief, torch.zeros_like(relief))
    error = float((model.heights(rows).double() - relief).abs().max())
    if error > LARGEST_LINE_ERROR_M:
        raise MismatchError(
            f"the {len(rows)} printed lines found in design {path!r} differ from it by up to {error * 1e6:.3g} um; "
            "leave --find-lines out, or give the list of lines"
        )
    lines = tuple(lines_of(rows))
    return replace(nominal, lines=lines, origin=f"{nominal.origin}, made of {_told(lines, nominal.section)}")


def _told(lines: "Sequence[Line]", section: "Section") -> str:
    return f"{len(lines)} printed lines" + ("" if section == "cosine" else f" of section {section!r}")


def _checked(nominal: Nominal, path: str, scene: "Scene", highest_m: float | None) -> Nominal:
    lowest, highest = float(nominal.relief_m.min()), float(nominal.relief_m.max())
    if lowest <= lowest_height_m(scene):
        raise InputError(f"design {path!r} goes {-lowest * 1e3:.4g} mm below the plate's top; check units and base")
    if highest == lowest:
        raise InputError(f"design {path!r} is flat, there is nothing to compare with; check the file and its units")
    most = MOST_THICKNESSES * scene.base_thickness_m if highest_m is None else highest_m
    if highest > most:
        how = f"{MOST_THICKNESSES:g} times the plate's thickness" if highest_m is None else "--max-height"
        raise InputError(
            f"design {path!r} is up to {highest * 1e3:.4g} mm high, above {most * 1e3:.4g} mm ({how}); check its "
            f"units, or say that it is so: --max-height {np.ceil(highest * 1e4) / 10:g}mm"
        )
    return nominal


def _method(old: int, new: int) -> str:
    return "mean of blocks" if old % new == 0 else "linear between cell centres, smoothed before where it gets coarser"


def resampled(heights_m: "FloatArray", samples: int) -> "FloatArray":
    """A height map [m], shape [k, k], on samples x samples cells of the same plate."""
    from skimage.transform import downscale_local_mean, resize

    old = len(heights_m)
    if old % samples == 0:
        blocks: FloatArray = downscale_local_mean(heights_m, (old // samples, old // samples))
        return blocks
    smooth = old > samples
    linear: FloatArray = resize(
        heights_m, (samples, samples), order=1, mode="edge", anti_aliasing=smooth, preserve_range=True
    )
    return linear


def judged_part(mask: str | None, margin_m: float, scene: "Scene") -> npt.NDArray[np.bool_]:
    """Where the plate is judged, shape [n, n].

    Args:
        mask: image or height map, nonzero is judged; row 0 is the lowest y. None judges everywhere.
        margin_m: width of the border that is not judged [m].
        scene: gives plate size and number of samples.

    Raises:
        InputError: unreadable, not square, or nothing is left to judge.
    """
    from warp_caustics.height_field import cell_centres
    from warp_caustics.io.images import read_image

    n = scene.height_samples
    judged = np.ones((n, n), bool)
    if mask is not None:
        marked = (read_image(mask).values != 0).any(axis=0)
        if marked.shape[0] != marked.shape[1]:
            height, width = marked.shape
            raise InputError(f"mask {mask!r} is {width} x {height} pixels; give a square one of the plate")
        nearest = ((np.arange(n) + 0.5) * len(marked) / n).astype(int)
        judged = marked[np.ix_(nearest, nearest)]
    inside = [np.abs(cell_centres(n, size)) <= size / 2 - margin_m for size in scene.plate_size_m]
    judged = judged & inside[1][:, None] & inside[0][None, :]
    if not judged.any():
        where = f"mask {Path(mask).name!r}" if mask is not None else f"margin of {margin_m * 1e3:g} mm"
        raise InputError(f"{where} leaves nothing of the plate to judge; mark the judged part, or lower --margin")
    return judged
