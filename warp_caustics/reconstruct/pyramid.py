"""Coarse versions of a measured caustic.

Pixels are means over squares, so a coarse pixel is exactly the mean of its
fine pixels, and the same scene simulated with fewer pixels must reproduce it.
"""

import dataclasses

import numpy as np
import torch

from warp_caustics.errors import InputError, MismatchError
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.colour_filters import found_pattern, own_pixels
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

DARK_FLOOR = 0.05
"""Noise is taken to grow as the root of the irradiance (shot noise), from this irradiance on."""


def check_image(image: CausticImage, scene: Scene) -> CausticImage:
    """Refuse an image that does not belong to the scene.

    Returns:
        The image as methods take it: masked pixels that hold no number are dark, and pixels that were made up behind a
        sensor's colour filters are known.

    Raises:
        MismatchError: wrong number of wavelengths or pixels, or a mask of another shape.
        InputError: values that count and are not finite, no light at all, or no pixel that counts.
    """
    expected = (scene.n_wavelengths, scene.image_pixels, scene.image_pixels)
    if image.irradiance.shape != expected:
        raise MismatchError(
            f"image has shape {list(image.irradiance.shape)}, the scene {list(expected)}; "
            "crop or resample it, or set scene.image_pixels and scene.wavelengths_m"
        )
    mask = None if image.mask is None else np.asarray(image.mask, dtype=bool)
    if mask is not None and mask.shape != expected:
        raise MismatchError(
            f"mask has shape {list(mask.shape)}, the image {list(expected)}; give one value per pixel and wavelength"
        )
    if mask is not None and not mask.any():
        raise InputError("all pixels are masked, none is left to reconstruct from; check saturation and mask")
    is_finite = np.isfinite(image.irradiance)
    is_counted = np.ones(expected, bool) if mask is None else mask
    if not is_finite[is_counted].all():
        count = int((~is_finite[is_counted]).sum())
        raise InputError(f"image has {count} pixels that are not finite, 0 may be; mask or repair them")
    mean = float(image.irradiance[is_counted].mean())
    if mean <= 0:
        raise InputError(f"image has mean {mean:g} W/m^2, above 0 it must be: nothing to see; check the dark frame")
    if not is_finite.all() or not (mask is None or mask is image.mask):
        image = dataclasses.replace(image, irradiance=np.where(is_finite, image.irradiance, 0), mask=mask)
    pattern = found_pattern(image.irradiance) if image.own is None else None
    return image if pattern is None else dataclasses.replace(image, own=own_pixels(pattern, expected[-1]))


def check_initial(initial: FloatArray, scene: Scene) -> None:
    """Refuse a starting relief that does not fit the scene.

    Raises:
        InputError: wrong shape, values that are not finite, or a hole through the plate.
    """
    n = scene.height_samples
    if initial.shape != (n, n):
        raise InputError(f"initial heights have shape {list(initial.shape)}, the scene needs [{n}, {n}]; resample them")
    if not np.isfinite(initial).all():
        raise InputError("initial heights are not finite everywhere; repair them")
    if initial.min() <= -scene.base_thickness_m:
        raise InputError(
            f"initial height {initial.min():g} m cuts through the plate of {scene.base_thickness_m:g} m; give metres"
        )


def measurement_at(
    image: CausticImage, scene: Scene, pixels: int, device: torch.device, border: int = 0, *, made_up: bool = False
) -> Measurement:
    """The caustic binned to pixels x pixels, in units of the radiosity.

    Args:
        image: what was measured.
        scene: of the measurement.
        pixels: along a side; must divide the image's.
        device: where to put it.
        border: outermost pixels that do not count.
        made_up: pixels count, too, that colour filters left to be made up; they do wherever pixels are binned, for
            each then has some that was measured.
    """
    m = image.irradiance.shape[-1]
    factor = m // pixels
    shines = torch.tensor(scene.radiosity_W_m2, dtype=torch.float64, device=device)[:, None, None]
    scale = torch.where(shines > 0, shines, 1.0)
    relative = torch.as_tensor(image.irradiance, device=device).double() / scale
    mask = (shines > 0).expand(relative.shape)
    if image.mask is not None:
        mask = mask & torch.as_tensor(image.mask, device=device)
    if image.own is not None and image.is_mosaic and factor == 1 and not made_up:
        mask = mask & torch.as_tensor(image.own, device=device)
    relative = torch.where(mask, relative, 0.0)

    def binned(values: torch.Tensor) -> torch.Tensor:
        return values.reshape(-1, pixels, factor, pixels, factor).sum(dim=(2, 4)) if factor > 1 else values

    counts = binned(mask.double())
    # A coarse pixel with a saturated part would be too dark: it counts only if all of it does.
    whole = counts == factor**2
    if border:
        inside = torch.zeros_like(whole)
        inside[:, border:-border, border:-border] = True
        whole = whole & inside
    mean = binned(relative) / counts.clamp_min(1)
    noise = None
    if image.noise_std is not None and (np.asarray(image.noise_std) > 0).all():
        std = torch.as_tensor(np.asarray(image.noise_std, dtype=np.float64), device=device)[:, None, None] / scale
        noise = std * mean.clamp_min(DARK_FLOOR).sqrt() / factor
    return Measurement(irradiance=mean.float(), weight=whole.float(), noise=noise)


def simulator_at(
    scene: Scene, pixels: int, device: str | torch.device, photons_per_pixel: int | None = None
) -> CausticSimulator:
    """Simulates what :func:`measurement_at` measures: so many pixels, in units of the radiosity.

    So that weights of an objective mean the same for dim and bright light.

    Args:
        scene: the set-up.
        pixels: size of the image.
        device: where to simulate.
        photons_per_pixel: of the lattice; the preset's if None.
    """
    photons = None if photons_per_pixel is None else photons_per_pixel * pixels**2
    return CausticSimulator(in_units_of_radiosity(scene, pixels), "lattice", n_photons=photons, device=device)


def in_units_of_radiosity(scene: Scene, pixels: int) -> Scene:
    """The scene with so many pixels, and radiosity 1 wherever light shines."""
    ones = tuple(float(radiosity > 0) for radiosity in scene.radiosity_W_m2)
    return scene.model_copy(update={"image_pixels": pixels, "radiosity_W_m2": ones})


def usual_pixels(scene: Scene) -> int:
    """Image size that saves time and loses little: halved while more than twice the height samples."""
    pixels, most = scene.image_pixels, 2 * scene.height_samples
    while pixels > most and pixels % 2 == 0:
        pixels //= 2
    return pixels


def judged_pixels(scene: Scene, found_at: int | None) -> int:
    """Pixels per side at which heights are judged that were found with so many; None for all.

    At no fewer than there are heights, where the image has them: with fewer, wrong heights explain the image, too.
    """
    pixels = found_at or scene.image_pixels
    while pixels < scene.height_samples and scene.image_pixels % (2 * pixels) == 0:
        pixels *= 2
    return pixels if pixels >= scene.height_samples else scene.image_pixels


def level_sizes(image_pixels: int, coarsest: int, finest: int) -> list[int]:
    """Image sizes from coarse to fine: finest, finest / 2, ... while whole and at least coarsest."""
    if not 1 <= finest <= image_pixels or image_pixels % finest:
        raise InputError(f"finest level of {finest} pixels does not divide the image of {image_pixels}; use a divisor")
    sizes = [finest]
    while sizes[0] % 2 == 0 and sizes[0] // 2 >= coarsest:
        sizes.insert(0, sizes[0] // 2)
    return sizes
