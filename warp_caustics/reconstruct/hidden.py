"""Places of an image that are dark because something hid them: a clamp, a frame, a finger.

Behind a relief it is dark where its light was bent away. Light goes D, through base and gap, per slope, and slopes of
printed glass are below one, so no relief clears a place of light whose middle lies farther than D from the next light.
Taken for relief, a hidden corner was answered by one of a millimetre. So such a place does not count, is shown to
methods as even light, and what lies behind it is as uncertain as the relief elsewhere is high.
"""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from warp_caustics.found_bench.picture_size import way_of_light_m
from warp_caustics.scene import Scene

if TYPE_CHECKING:
    from warp_caustics.reconstruct.base import CausticImage, Reconstruction

DARK = 0.1
"""Of the median of each wavelength: what is dark for it, stray light and all."""
STEEPEST = 1.0
"""Slope by which light is bent at most."""
LEAST_PX = 4
"""Smallest half width of a place that is looked at: dead columns and dust are narrower."""
RIM_PX = 3
"""By which a place is made wider: its edge is no relief either."""


def hidden_place(image: "CausticImage", scene: Scene) -> npt.NDArray[np.bool_] | None:
    """Where an image is hidden, shape [m, m]; None where it is not.

    Args:
        image: as it was measured.
        scene: as the bench is told.
    """
    values = np.asarray(image.irradiance)
    if values.ndim != 3 or values.shape[1] != values.shape[2] or len(values) != scene.n_wavelengths:
        return None
    shines = np.asarray(scene.radiosity_W_m2) > 0
    level = np.nanmedian(values, axis=(1, 2), keepdims=True)
    is_dark = values < DARK * level
    if image.mask is not None:
        is_dark &= np.asarray(image.mask, bool)
    dark = np.asarray(is_dark[shines].all(axis=0), bool)
    least = max(STEEPEST * way_of_light_m(scene) / (max(scene.plate_size_m) / len(dark)), LEAST_PX)
    if dark.all() or dark.sum() < least**2:
        return None
    middles = scipy.ndimage.distance_transform_edt(dark) > least
    if not middles.any():
        return None
    labels, _ = scipy.ndimage.label(dark)
    hidden = np.isin(labels, np.unique(labels[middles]))
    grown: npt.NDArray[np.bool_] = scipy.ndimage.binary_dilation(hidden, iterations=RIM_PX)
    return grown


def without_place(image: "CausticImage", hidden: npt.NDArray[np.bool_]) -> "CausticImage":
    """The image with even light, which does not count, where it is hidden, shape [m, m]."""
    values = np.array(image.irradiance)
    level = np.nanmedian(values, axis=(1, 2))
    values[:, hidden] = level[:, None]
    mask = np.ones(values.shape, bool) if image.mask is None else np.array(image.mask, bool)
    mask[:, hidden] = False
    return dataclasses.replace(image, irradiance=values, mask=mask)


def with_hidden(result: "Reconstruction", hidden: npt.NDArray[np.bool_], scene: Scene) -> "Reconstruction":
    """A result that says what was hidden, and how uncertain heights are behind it.

    Args:
        result: of the image without that place.
        hidden: shape [m, m].
        scene: as the bench is told.
    """
    share = float(hidden.mean())
    warning = (
        f"{100 * share:.2g} % of the image are darker than any relief makes it there: taken for hidden and left out; "
        "heights behind it are a guess: take what hides it away, or check the gap"
    )
    uncertainty = result.uncertainty_m
    if uncertainty is not None:
        n = len(uncertainty)
        near = way_of_light_m(scene) / (max(scene.plate_size_m) / len(hidden))
        reached = scipy.ndimage.distance_transform_edt(~hidden) <= near
        rows = np.minimum((np.arange(n) + 0.5) * len(hidden) / n, len(hidden) - 1).astype(int)
        behind = reached[np.ix_(rows, rows)]
        # Heights elsewhere tell how high what is printed there may be.
        seen = result.heights_m[~behind] if not behind.all() else result.heights_m
        relief = float(np.sqrt(np.mean(np.square(seen))))
        uncertainty = np.where(behind, np.hypot(uncertainty, relief), uncertainty)
    counters = {**result.counters, "hidden": share}
    return dataclasses.replace(
        result, uncertainty_m=uncertainty, counters=counters, warnings=(*result.warnings, warning)
    )
