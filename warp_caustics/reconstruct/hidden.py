"""Places of an image that are dark because something hid them: a clamp, a frame, a finger.

Behind a relief it is dark where its light was bent away. Light goes D, through base and gap, per slope, and slopes of
printed glass are below one, so no relief clears a place of light whose middle lies farther than D from the next light.
Taken for relief, a hidden corner was answered by one of a millimetre. So such a place does not count, is shown to
methods as even light, and what lies behind it is as uncertain as the relief elsewhere is high.
"""

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray
from warp_caustics.way_of_light import way_of_light_m

DARK = 0.1
"""Of the median of each wavelength: what is dark for it, stray light and all."""
STEEPEST = 1.0
"""Slope by which light is bent at most."""
LEAST_PX = 4
"""Smallest half width of a place that is looked at: dead columns and dust are narrower."""
RIM_PX = 3
"""By which a place is made wider: its edge is no relief either."""


def hidden_place(
    irradiance: FloatArray, mask: npt.NDArray[np.bool_] | None, scene: Scene
) -> npt.NDArray[np.bool_] | None:
    """Where an image is hidden, shape [m, m]; None where it is not.

    Args:
        irradiance: as it was measured [W/m^2], shape [n_w, m, m].
        mask: False where a pixel does not count, shape [n_w, m, m]; None if all do.
        scene: as the bench is told.
    """
    values = np.asarray(irradiance)
    if values.ndim != 3 or values.shape[1] != values.shape[2] or len(values) != scene.n_wavelengths:
        return None
    shines = np.asarray(scene.radiosity_W_m2) > 0
    level = np.nanmedian(values, axis=(1, 2), keepdims=True)
    is_dark = values < DARK * level
    if mask is not None:
        is_dark &= np.asarray(mask, bool)
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


def without_place(
    irradiance: FloatArray, mask: npt.NDArray[np.bool_] | None, hidden: npt.NDArray[np.bool_]
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Irradiance with even light where it is hidden, shape [m, m], and a mask in which that does not count."""
    values = np.array(irradiance)
    values[:, hidden] = np.nanmedian(values, axis=(1, 2))[:, None]
    counted = np.ones(values.shape, bool) if mask is None else np.array(mask, bool)
    counted[:, hidden] = False
    return values, counted


def uncertain_behind(
    uncertainty_m: FloatArray, heights_m: FloatArray, hidden: npt.NDArray[np.bool_], scene: Scene
) -> FloatArray:
    """Uncertainty with what nobody saw: behind the place, and as far as light is bent, relief as high as elsewhere.

    Args:
        uncertainty_m: of the image without that place [m], shape [n, n].
        heights_m: found [m], shape [n, n].
        hidden: shape [m, m].
        scene: as the bench is told.
    """
    n = len(uncertainty_m)
    near = way_of_light_m(scene) / (max(scene.plate_size_m) / len(hidden))
    reached = scipy.ndimage.distance_transform_edt(~hidden) <= near
    at = np.minimum((np.arange(n) + 0.5) * len(hidden) / n, len(hidden) - 1).astype(int)
    behind = reached[np.ix_(at, at)]
    seen = heights_m if behind.all() else heights_m[~behind]
    relief = np.sqrt(np.mean(np.square(seen)))
    return np.where(behind, np.hypot(uncertainty_m, relief), uncertainty_m)


def hidden_warning(share: float) -> str:
    """What the user should know, of a share of the image."""
    return (
        f"{100 * share:.2g} % of the image are darker than any relief makes it there: taken for hidden and left out; "
        "heights behind it are a guess: take what hides it away, or check the gap"
    )
