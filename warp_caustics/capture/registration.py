"""Where the scene's window lies in a photo: a homography, then the lens.

Positions on the screen are metres from the centre of the scene's window, x
along columns and y along rows. A camera without a lens error maps them to
pixels by a homography, whatever its direction; the distortion follows.

Not handled: a screen that is not flat.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from warp_caustics.capture.distortion import Distortion, Points
from warp_caustics.errors import InputError, MismatchError

CORNERS = ("-x-y", "+x-y", "+x+y", "-x+y")
"""Names of the window's corners by the signs of their position, around it; also the order of an unnamed list."""
CORNER_SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])

MIN_ANGLE_DEG = 20.0
"""Smallest angle of a usable quadrilateral; a camera that flat above the screen sees nothing of use."""
MAX_FIT_PX = 2.0
"""Root mean square misfit of more than four points from which a registration is refused [camera px]."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Map from the screen to the photo.

    Attributes:
        homography: takes (x, y, 1) [m] to homogeneous ideal pixels, shape [3, 3].
        plate_size_m: extent of the window along x and y [m].
        distortion: the lens, or None for an ideal one.
        points_px: what the map was fitted to, as it lies in the photo, shape [N, 2].
        figures: numbers on the fit by name, their unit in the name.
        notes: how the points were found, one line each.
        warnings: one line for each thing a person should know.
        offset_px: (x, y) of the first pixel kept of a cropped photo.
    """

    homography: npt.NDArray[np.float64]
    plate_size_m: tuple[float, float]
    distortion: Distortion | None
    points_px: Points
    figures: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    offset_px: tuple[float, float] = (0.0, 0.0)

    def to_photo(self, position_m: npt.ArrayLike) -> Points:
        """Pixels (x, y) of positions on the screen [m], both of shape [..., 2]."""
        position = np.asarray(position_m, np.float64)
        mapped = position @ self.homography[:, :2].T + self.homography[:, 2]
        ideal = mapped[..., :2] / mapped[..., 2:]
        shown = ideal if self.distortion is None else self.distortion.distort(ideal)
        return np.asarray(shown - np.array(self.offset_px))

    def box(self, height: int, width: int, margin_px: int) -> tuple[slice, slice]:
        """Rows and columns of a photo [height, width] that hold the window and a margin."""
        outline = self.outline_px()
        low = np.floor(outline.min(axis=0)).astype(int) - margin_px
        high = np.ceil(outline.max(axis=0)).astype(int) + margin_px + 1
        rows = slice(max(0, int(low[1])), min(height, int(high[1])))
        return rows, slice(max(0, int(low[0])), min(width, int(high[0])))

    def cropped(self, box: tuple[slice, slice]) -> "Registration":
        """The same for the part of the photo in rows and columns ``box``."""
        x, y = self.offset_px
        return replace(self, offset_px=(x + box[1].start, y + box[0].start))

    def corners_px(self) -> Points:
        """The window's corners in the photo, in the order of CORNERS, shape [4, 2]."""
        return self.to_photo(CORNER_SIGNS * np.array(self.plate_size_m) / 2)

    def outline_px(self, points_per_side: int = 64) -> Points:
        """The window's outline in the photo, shape [4 * points_per_side, 2]."""
        corners = CORNER_SIGNS * np.array(self.plate_size_m) / 2
        along = (np.arange(points_per_side) / points_per_side)[:, None]
        sides = [a + along * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        return self.to_photo(np.concatenate(sides))

    def inside(self, height: int, width: int) -> npt.NDArray[np.bool_]:
        """Pixels of the photo whose centre lies in the window, shape [height, width]."""
        from skimage.draw import polygon2mask

        return np.asarray(polygon2mask((height, width), self.outline_px()[:, ::-1]), bool)


def window_positions_m(
    rows: npt.NDArray[np.float64], columns: npt.NDArray[np.float64], pixels: int, plate_size_m: tuple[float, float]
) -> Points:
    """Positions [m] of the window's pixel coordinates, pixel centres at whole numbers, shape [rows, columns, 2]."""
    x = ((columns + 0.5) / pixels - 0.5) * plate_size_m[0]
    y = ((rows + 0.5) / pixels - 0.5) * plate_size_m[1]
    return np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1)


def fitted_registration(
    position_m: npt.ArrayLike,
    points_px: npt.ArrayLike,
    plate_size_m: tuple[float, float],
    *,
    distortion: Distortion | None = None,
    mirrored: bool = False,
    notes: tuple[str, ...] = (),
    figures: Mapping[str, float] | None = None,
) -> Registration:
    """Fit the homography to points, by least squares in the photo's ideal pixels (normalised DLT).

    Args:
        position_m: known positions on the screen [m], shape [N, 2], N at least 4.
        points_px: where they lie in the photo [px], shape [N, 2].
        plate_size_m: extent of the window [m].
        distortion: the lens.
        mirrored: the photo shows the screen from behind.
        notes: how the points were found.
        figures: numbers on that.

    Raises:
        InputError: too few points, points in a line, crossed or mirrored, or points that fit no plane.
    """
    from skimage.transform import ProjectiveTransform

    position, shown = np.asarray(position_m, np.float64), np.asarray(points_px, np.float64)
    if len(position) < 4:
        raise InputError(f"{len(position)} points are too few to find the window; give four or more")
    ideal = shown if distortion is None else distortion.undistort(shown)
    size = np.array(plate_size_m)
    # Metres over pixels would be badly scaled where skimage normalises each side by itself; halves of the plate are 1.
    fit = ProjectiveTransform.from_estimate(position / (size / 2), ideal)
    if not fit or not np.isfinite(fit.params).all():
        raise InputError("the points lie on a line or coincide; give the four corners of the window")
    homography = fit.params @ np.diag([2 / size[0], 2 / size[1], 1.0])
    found = Registration(homography / homography[2, 2], plate_size_m, distortion, shown, {}, notes)
    misfit = np.linalg.norm(found.to_photo(position) - shown, axis=-1)
    rms = float(np.sqrt(np.mean(misfit**2)))
    if len(position) > 4 and rms > MAX_FIT_PX:
        worst = int(misfit.argmax())
        raise InputError(
            f"the points fit no flat window: {rms:.3g} px off (root mean square, limit {MAX_FIT_PX:g}), "
            f"point {worst + 1} most, {misfit[worst]:.3g} px; check order and positions"
        )
    corners = found.corners_px()
    check_quadrilateral(corners, mirrored)
    turned, warnings = _orientation(corners, mirrored)
    numbers = {**(figures or {}), "points": float(len(position)), "turned_deg": turned}
    if len(position) > 4:
        numbers["fit_rms_px"] = rms
    return Registration(found.homography, plate_size_m, distortion, shown, numbers, notes, warnings)


def check_quadrilateral(corners_px: Points, mirrored: bool | None) -> None:
    """Refuse corners that no camera can see, in the order of CORNERS, shape [4, 2].

    Args:
        corners_px: the corners in the photo.
        mirrored: whether the photo shows the screen from behind; None if either will do.

    Raises:
        InputError: crossed, not convex, nearly flat, or running the wrong way round.
    """
    before, after = np.roll(corners_px, 1, axis=0) - corners_px, np.roll(corners_px, -1, axis=0) - corners_px
    turn = after[:, 0] * before[:, 1] - after[:, 1] * before[:, 0]
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    if not np.isfinite(corners_px).all() or (lengths < 1).any():
        raise InputError("two corners of the window coincide; give each once")
    sines = turn / lengths
    listed = "; ".join(f"{name} at {x:.1f}, {y:.1f}" for name, (x, y) in zip(CORNERS, corners_px, strict=True))
    if (sines > 0).any() and (sines < 0).any():
        raise InputError(
            f"the corners are no convex quadrilateral ({listed}); two are swapped, the order is {', '.join(CORNERS)}"
        )
    if np.abs(sines).min() < np.sin(np.deg2rad(MIN_ANGLE_DEG)):
        raise InputError(f"a corner of the window is sharper than {MIN_ANGLE_DEG:g} deg or straight ({listed})")
    if mirrored is not None and (sines < 0).all() != mirrored:
        if mirrored:
            raise InputError(
                f"the corners run as in an upright photo ({listed}); leave mirrored out, or check the order"
            )
        raise InputError(
            f"the corners run the wrong way round ({listed}); if the camera looks at the screen from behind, "
            f"say mirrored, else give them in the order {', '.join(CORNERS)}"
        )


def _orientation(corners_px: Points, mirrored: bool) -> tuple[float, tuple[str, ...]]:
    """Angle [deg] between the window's y and the photo's rows, and a warning where it is large."""
    up = corners_px[2] + corners_px[3] - corners_px[0] - corners_px[1]
    turned = float(np.rad2deg(np.arctan2(-up[0], up[1])))
    if abs(turned) <= 45:
        return turned, ()
    text = f"the window is turned by {turned:.0f} deg in the photo; check the names of the corners if it should not be"
    return turned, (text,)


def check_in_photo(registration: Registration, height: int, width: int) -> float:
    """Sharpness of a photo for a window: camera pixels along one of its sides, at the coarsest.

    Raises:
        MismatchError: a corner lies outside the photo.
    """
    corners = registration.corners_px()
    for name, (x, y) in zip(CORNERS, corners, strict=True):
        if not (-1 <= x <= width and -1 <= y <= height):
            raise MismatchError(
                f"corner {name} of the window lies at {x:.1f}, {y:.1f}, outside the photo of {width} x {height} pixels"
                "; show the whole window, or check the corners"
            )
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).min())
