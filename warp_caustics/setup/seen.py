"""Numbers of a camera: how they are read from its parameters and written into them, differentiably."""

from collections.abc import Mapping, Sequence

import torch

from warp_caustics.camera.config import LARGEST_COLOUR_SCALE, LARGEST_MAGNIFICATION, LEAST_MAGNIFICATION
from warp_caustics.camera.parameters import CameraParameters
from warp_caustics.setup.parameter import Parameter

LARGEST_SHIFT_PX = 8192.0

Place = tuple[str, tuple[int, ...]]
"""Field of :class:`CameraParameters` and index in it."""

_AXES = ("x", "y")
_LIGHT = ("light_x", "light_y", "light_xx", "light_xy", "light_yy")

PLACING = ("shift_x_px", "shift_y_px", "magnification", "colour_shift_x_px", "colour_shift_y_px", "colour_scale")
"""Groups for which a photo's pixels are not those of the window."""
TURNING = ("turn_rad", "homography")
BLURRING = ("psf_px", "box_px")


def camera_places(parameters: CameraParameters) -> dict[str, tuple[Parameter, Place]]:
    """All parameters of a camera by their names, with where they stand in its tensors.

    Args:
        parameters: gives the numbers of wavelengths n_w and channels C; no batch.
    """
    colours, wavelengths = parameters.mixing.shape
    far = LARGEST_SHIFT_PX
    found: dict[str, tuple[Parameter, Place]] = {}

    def add(
        name: str, symbol: str, unit: str, low: float, high: float, prior: float, meaning: str, place: Place
    ) -> None:
        is_squared = place[0] in BLURRING
        found[name] = Parameter(name, symbol, unit, low, high, prior, "camera", meaning, is_squared), place

    for k, axis in enumerate(_AXES):
        what = f"of the picture towards {axis}"
        add(f"shift_{axis}_px", f"s_{axis}", "px", -far, far, 1.0, what, ("shift_px", (k,)))
    add("turn_rad", "phi", "rad", -3.2, 3.2, 2e-3, "of the picture from x towards y", ("turn_rad", ()))
    low, high = LEAST_MAGNIFICATION, LARGEST_MAGNIFICATION
    add("magnification", "M", "1", low, high, 3e-3, "camera pixels per window pixel", ("magnification", ()))
    for i in range(3):
        for j in range(3 - (i == 2)):
            add(f"homography.{i}.{j}", f"H_{i}{j}", "1", -10, 10, 2e-3, "of the homography", ("homography", (i, j)))
    for c in range(wavelengths):
        for k, axis in enumerate(_AXES):
            name, what = f"colour_shift_{axis}_px.{c}", f"of wavelength {c} towards {axis}"
            add(name, f"a_{axis}{c}", "px", -far, far, 0.3, what, ("colour_shift_px", (c, k)))
        most = LARGEST_COLOUR_SCALE
        what = f"magnification of wavelength {c}, less 1"
        add(f"colour_scale.{c}", f"c_{c}", "1", -most, most, 1e-3, what, ("colour_scale", (c,)))
        what = f"PSF of wavelength {c}, standard deviation"
        add(f"psf_px.{c}", f"sigma_{c}", "px", 0.0, far, 0.4, what, ("psf_px", (c,)))
        add(f"box_px.{c}", f"b_{c}", "px", 0.0, far, 0.4, f"square blur of wavelength {c}", ("box_px", (c,)))
        for k, name in enumerate(_LIGHT):
            what = f"unevenness {name[6:]} of wavelength {c}"
            add(f"{name}.{c}", f"l_{name[6:]},{c}", "1", -1.0, 1.0, 0.05, what, ("light", (c, k)))
        what = f"stray light of wavelength {c}"
        add(f"ambient.{c}", f"A_{c}", "1", 0.0, 100.0, 0.02, what, ("ambient", (c,)))
    for row in range(colours):
        for c in range(wavelengths):
            what = f"wavelength {c} in channel {row}"
            add(f"mixing.{row}.{c}", f"m_{row}{c}", "1", 0.0, 100.0, 0.03, what, ("mixing", (row, c)))
        add(f"gain.{row}", f"G_{row}", "1", 1e-6, 1e6, 0.05, f"of channel {row}", ("gain", (row,)))
    return found


def camera_values(parameters: CameraParameters, places: Mapping[str, Place]) -> dict[str, float]:
    """Values of named parameters."""
    return {name: float(getattr(parameters, field)[index]) for name, (field, index) in places.items()}


def with_camera_values(nominal: CameraParameters, places: Sequence[Place], values: torch.Tensor) -> CameraParameters:
    """Camera parameters with some of their numbers replaced; differentiable by them, forward and backward.

    Args:
        nominal: of the type and on the device of the values.
        places: where the values belong, K of them.
        values: shape [K].
    """
    fields = nominal._asdict()
    for field in dict.fromkeys(field for field, _ in places):
        chosen = [k for k, (name, _) in enumerate(places) if name == field]
        index = [places[k][1] for k in chosen]
        if index == [()]:
            fields[field] = values[chosen[0]]
            continue
        axes = tuple(torch.tensor(axis, device=values.device) for axis in zip(*index, strict=True))
        fields[field] = fields[field].index_put(axes, values[chosen])
    return CameraParameters(**fields)
