"""A measured caustic as one density of light on a grid, as transport needs it."""

from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used

from warp_caustics.errors import InputError
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.exposure import is_exposure
from warp_caustics.reconstruct.pyramid import check_image
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

DARK_CHANNEL = 1e-2
"""A wavelength with less than this share of the light it should have is taken to be switched off."""

TOLERATED_NEGATIVE = 0.02
"""Share of negative light above which a warning is given; dark frames leave some noise below 0."""

TOLERATED_BALANCE = 0.1
"""A mean irradiance so far from the radiosity hints at a wrong exposure or window."""


@dataclass(frozen=True)
class Light:
    """Light on the screen, all wavelengths together.

    Attributes:
        density: mean over the wavelengths of irradiance over radiosity, at least 0, shape [N, N].
        scene: N pixels, only the wavelengths that shine, all of radiosity 1.
        balance: mean of the density; 1 if no light is lost.
        exposure: of the image, by which its caustic is to be compared, shape [n_w]; 1 unless it is far from that.
        warnings: what was left out or repaired.
    """

    density: FloatArray
    scene: Scene
    balance: float
    exposure: FloatArray
    warnings: tuple[str, ...]


def light_of(image: CausticImage, scene: Scene, cells: int) -> Light:
    """The density of light of an image on cells x cells squares.

    Wavelengths count alike: refraction by their mean index then sends light to the right place to first order in
    the dispersion. A pixel that is masked in one wavelength takes the others', and a pixel masked in all its nearest
    neighbour.

    Raises:
        MismatchError: image of another size than the scene's.
        InputError: not finite, or no light.
    """
    image = check_image(image, scene)
    radiosity = np.asarray(scene.radiosity_W_m2)
    valid = np.ones(image.irradiance.shape, bool) if image.mask is None else image.mask.astype(bool)
    relative = image.irradiance.astype(np.float64) / np.maximum(radiosity, 1e-300)[:, None, None]
    means = [float(r[v].mean()) if v.any() else 0.0 for r, v in zip(relative, valid, strict=True)]
    shining = [c for c in range(len(means)) if radiosity[c] > 0 and means[c] > DARK_CHANNEL]
    if not shining:
        raise InputError(
            f"image has {max(means):g} of the light of a flat plate, less than {DARK_CHANNEL:g} in every wavelength; "
            "check exposure and dark frame"
        )
    warnings = [
        f"wavelength {scene.wavelengths_m[c] * 1e9:.0f} nm has {means[c]:.2g} of its light and is left out; "
        "check that its source is on"
        for c in range(len(means))
        if radiosity[c] > 0 and c not in shining
    ]
    relative, valid = relative[shining], valid[shining]
    negative = float(np.maximum(-relative * valid, 0).sum() / np.abs(relative * valid).sum())
    if negative > TOLERATED_NEGATIVE:
        warnings.append(f"{negative:.1%} of the light is negative and taken as 0; check the dark frame")
    density = _merged(np.maximum(relative, 0.0), valid)
    density = density.reshape(cells, -1, cells, density.shape[0] // cells).mean(axis=(1, 3))
    balance = float(density.mean())
    if abs(balance - 1) > TOLERATED_BALANCE:
        warnings.append(f"mean irradiance is {balance:.3g} of the radiosity; check exposure, flat frame and window")
    exposure = np.ones(len(means))
    exposure[shining] = [means[c] for c in shining]
    if not is_exposure(exposure, TOLERATED_BALANCE):
        exposure = np.ones(len(means))
    update = {"image_pixels": cells, "wavelengths_m": tuple(scene.wavelengths_m[c] for c in shining)}
    used = scene.model_copy(update=update | {"radiosity_W_m2": (1.0,) * len(shining)})
    return Light(without_border(density), used, balance, exposure, tuple(warnings))


def without_border(density: FloatArray) -> FloatArray:
    """The outermost cells replaced by their inner neighbours.

    What happens at the very edge of a plate is not in the model; 4e-4 of the light missing there, spread over the
    plate, would bend it by 50 um.
    """
    return np.pad(density[1:-1, 1:-1], 1, mode="edge") if len(density) > 2 else density


def _merged(relative: FloatArray, valid: FloatArray) -> FloatArray:
    """Mean over the wavelengths that are valid, nearest neighbour where none is; shape [m, m]."""
    count = valid.sum(axis=0)
    merged: FloatArray = (relative * valid).sum(axis=0) / np.maximum(count, 1)
    if (count == 0).any():
        nearest = scipy.ndimage.distance_transform_edt(count == 0, return_distances=False, return_indices=True)
        merged = merged[tuple(nearest)]
    return merged
