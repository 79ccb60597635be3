"""A scene and a photon plan as the kernels see them: the structs of ``kernels/photons.py``, filled in."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import warp as wp

from warp_caustics.kernels import dtype_of
from warp_caustics.kernels.effects import Effects
from warp_caustics.kernels.fixed_point import MOST_STEPS
from warp_caustics.kernels.photons import optics_struct, photons_struct
from warp_caustics.kernels.profiles import REACH
from warp_caustics.photons import PhotonPlan
from warp_caustics.scene import Profile, Scene

MIN_SIGMA_PX = 0.02
"""Standard deviation added to every footprint [px]: keeps the image differentiable where a caustic focuses
a footprint to a point, and is far below what a pixel can show."""

MAX_SIGMA_FRACTION = 1 / 16
"""Footprints wider than this fraction of the image are shrunk to it, keeping their energy: next to grazing
exit they grow without bound, and so would the work."""

WIDE_PIXELS = 100
"""Footprints that cover more pixels than this, and than four times that of a flat plate, are left to several
GPU threads each: a launch would otherwise wait for the few threads that have thousands of pixels."""

BRIGHTEST = 2**10
"""Times the light of a path on a flat plate that a path may carry where sums are in fixed point; it is cut off there,
so that no sum can overflow. Slanting light gathers as much on slopes of 2800, and the light of a lamp where a relief
rises through 97 % of the way to it."""


def footprint_sigma_m(scene: Scene, smoothing: float, n_photons: int) -> float:
    """Standard deviation of the footprint on the plate [m], s sqrt(A / (8 pi n_l)).

    The covariance of the biweight kernel 3/pi (1 - r^2)^2 of Frisvad et al. on
    a disc of radius s sqrt(A / (pi n_l)).
    """
    return smoothing * math.sqrt(scene.plate_area_m2 / (8 * math.pi * n_photons))


def effects_of(scene: Scene) -> Effects:
    """Effects that a scene asks for."""
    has_lamp = scene.lamp_half_angle_rad > 0 or scene.lamp_radius_m > 0
    return Effects(
        fresnel=scene.fresnel,
        lamp=has_lamp,
        tilt=scene.is_tilted,
        point=not scene.is_collimated,
        second_hits=scene.second_hits == "lost",
    )


def lamp_sigma(scene: Scene) -> float:
    """Standard deviation of the lamp along an axis, half a disc's radius: of directions [rad], or of the source [m]."""
    return math.sin(scene.lamp_half_angle_rad) / 2 if scene.is_collimated else scene.lamp_radius_m / 2


def flat_shares(scene: Scene) -> list[float]:
    """Share of collimated light that both faces of a flat plate let through, relative to normal incidence, [n_w].

    1 for a point source: its flat plate is that right below it.
    """
    if not scene.is_tilted:
        return [1.0] * scene.n_wavelengths
    cosine = -scene.light_direction[2]

    def face(cos_in: float, ratio: float) -> tuple[float, float]:
        cos_out = math.sqrt(1 - ratio**2 * (1 - cos_in**2))
        s, p = ratio * cos_in + cos_out, cos_in + ratio * cos_out
        return (1 + ratio) ** 2 / 2 * cos_in * cos_out * (s**-2 + p**-2), cos_out

    shares = []
    for glass, outside in zip(scene.glass_indices, scene.exit_indices, strict=True):
        first, inside = face(cosine, 1 / glass)
        shares.append(first * face(inside, glass / outside)[0])
    return shares


def spectra_of(scene: Scene) -> list[list[float]]:
    """What photons of each wavelength are told: 1 / n, n over that behind the plate, L_i, flat share; [4, n_w]."""
    indices, exits = scene.glass_indices, scene.exit_indices
    ratios = [n / e for n, e in zip(indices, exits, strict=True)]
    return [[1 / n for n in indices], ratios, list(scene.radiosity_W_m2), flat_shares(scene)]


def flat_sigma_m(scene: Scene, smoothing: float, n_photons: int) -> float:
    """Standard deviation of the widest footprint that a flat plate shows below the lamp [m]."""
    ways = [
        scene.base_thickness_m / glass - scene.screen_position_m[2] / outside
        for glass, outside in zip(scene.glass_indices, scene.exit_indices, strict=True)
    ]
    angle = lamp_sigma(scene) / (1.0 if scene.is_collimated else scene.light_distance_m)
    return math.hypot(footprint_sigma_m(scene, smoothing, n_photons), angle * max(ways))


class Optics:
    """What is the same for all photons of a plan, made once.

    Attributes:
        scene: where it comes from; of several, the first.
        effects: what kernels are built with.
        flat_sigma_px: standard deviation of a flat plate's footprints along x [px]; of several scenes the widest.
        shared: struct ``Optics``; :meth:`photons` copies it.
        steps: of fixed-point sums per W/m^2, a power of two; of several scenes the same.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        plan: PhotonPlan,
        smoothing: float,
        profile: Profile,
        device: torch.device,
        dtype: torch.dtype,
        spectra: torch.Tensor | None = None,
    ):
        """Fill the structs.

        Args:
            scenes: one set-up, or one for each relief of a batch, all with the same effects.
            plan: gives the number of photons.
            smoothing: s.
            profile: of the footprints.
            device: of the arrays.
            dtype: of everything.
            spectra: :func:`spectra_of` each scene on the device, shape [S, 4, n_w], where somebody has copied those of
                many scenes at once; a copy waits for the device.
        """
        self.scene = scene = scenes[0]
        self.effects = effects_of(scene)._replace(many_benches=len(scenes) > 1)
        warp_dtype = dtype_of(torch.finfo(dtype).bits)
        if spectra is None:
            spectra = torch.tensor([spectra_of(one) for one in scenes], dtype=dtype, device=device)
        self._spectra = wp.from_torch(spectra.contiguous(), requires_grad=False)
        self._struct, struct = photons_struct(warp_dtype), optics_struct(warp_dtype)
        numbers = [_numbers(one, plan, smoothing, profile) for one in scenes]
        self.steps, most_steps = _steps(scenes, plan)
        for row in numbers:
            row.update(steps=self.steps, most_steps=most_steps)
        self.shared = struct()
        for name, value in numbers[0].items():
            setattr(self.shared, name, value)
        # A tape looks into every array of a struct.
        warp_device = wp.device_from_torch(device)
        self._nothing = wp.empty((0, 0, 0), dtype=wp.uint8, device=warp_device)
        self._table, self._benches = None, wp.empty(0, dtype=struct, device=warp_device)
        if len(scenes) > 1:
            self._table = _table(struct, numbers, device)
            pointer = self._table.data_ptr()
            self._benches = wp.array(ptr=pointer, dtype=struct, shape=(len(scenes),), device=warp_device)
        sigma = max(flat_sigma_m(one, smoothing, plan.count) for one in scenes)
        self.flat_sigma_px = sigma / scene.pixel_size_m[0]

    def photons(self, positions: torch.Tensor, count: int | None = None, columns: int = 0) -> Any:
        """Struct ``Photons`` of photons at positions [N, 2] [m]; for a lattice by its axes with count and columns."""
        photons = self._struct()
        photons.positions = wp.from_torch(positions.detach(), requires_grad=False)
        photons.count = len(positions) if count is None else count
        photons.columns = columns
        pitch_x, pitch_y = self.scene.sample_pitch_m
        photons.samples_per_m_x, photons.samples_per_m_y = 1 / pitch_x, 1 / pitch_y
        photons.samples = self.scene.height_samples
        photons.spectra = self._spectra
        photons.clear = self._nothing
        photons.optics = self.shared
        photons.benches = self._benches
        return photons

    def with_clear(self, photons: Any, clear: torch.Tensor) -> Any:
        """The same struct, told which paths are clear: uint8, shape [B, n_w, N]."""
        told = self._struct()
        for name in self._struct.vars:
            setattr(told, name, getattr(photons, name))
        told.clear = wp.from_torch(clear, requires_grad=False)
        return told


def _table(struct: Any, numbers: list[dict[str, Any]], device: torch.device) -> torch.Tensor:
    """Structs ``Optics`` as bytes [S, size] on a device, copied without waiting for it."""
    layout = struct.numpy_dtype()
    table = np.zeros(len(numbers), dtype=layout)
    for name in numbers[0]:
        table[name] = [row[name] for row in numbers]
    held = torch.from_numpy(table.view(np.uint8).reshape(len(numbers), -1))
    return held.pin_memory().to(device, non_blocking=True) if device.type == "cuda" else held


def _steps(scenes: Sequence[Scene], plan: PhotonPlan) -> tuple[float, float]:
    """Steps of fixed-point sums per W/m^2, and how many a path may carry: all paths may meet in one pixel."""
    flat = max(_area(scene, plan) * max(scene.radiosity_W_m2) for scene in scenes) or 1.0
    # Radiosities from 1e-12 on keep it below 2^100, within float32.
    steps = 2.0 ** math.floor(math.log2(MOST_STEPS / (plan.count * BRIGHTEST * flat)))
    return steps, BRIGHTEST * flat * steps


def _area(scene: Scene, plan: PhotonPlan) -> float:
    """Area of the plate that a path stands for, in pixels."""
    return scene.plate_area_m2 / plan.count / math.prod(scene.pixel_size_m)


def _numbers(scene: Scene, plan: PhotonPlan, smoothing: float, profile: Profile) -> dict[str, Any]:
    """Members of a struct ``Optics``."""
    width, length = scene.plate_size_m
    pixel_x, pixel_y = scene.pixel_size_m
    flat = flat_sigma_m(scene, smoothing, plan.count)
    flat_pixels = math.prod(2 * REACH[profile] * flat / size + 1 for size in (pixel_x, pixel_y))
    # A photon at distance a from an edge of the plate has its footprint squeezed to a / squeeze across it.
    # That moves a sixth of a lattice cell's light to its neighbour, which must not show: only inside a pixel.
    is_fine = plan.count >= scene.image_pixels**2
    light_x, light_y, light_z = scene.light_position_m
    return {
        "base": scene.base_thickness_m,
        "gap": -scene.screen_position_m[2],
        "window_x": scene.screen_position_m[0] - width / 2,
        "window_y": scene.screen_position_m[1] - length / 2,
        "pixels_per_m_x": 1 / pixel_x,
        "pixels_per_m_y": 1 / pixel_y,
        "image_pixels": scene.image_pixels,
        "sigma0": footprint_sigma_m(scene, smoothing, plan.count),
        "half_x": width / 2,
        "half_y": length / 2,
        "squeeze": REACH[profile] if plan.placement == "lattice" and is_fine else 0.0,
        "min_var": MIN_SIGMA_PX**2,
        "max_var": (MAX_SIGMA_FRACTION * scene.image_pixels) ** 2,
        "wide_pixels": max(WIDE_PIXELS, 4 * flat_pixels),
        "area": _area(scene, plan),
        "lamp_var": lamp_sigma(scene) ** 2,
        "tilt": scene.light_direction,
        "light_x": light_x,
        "light_y": light_y,
        "light_z": light_z,
        "light_distance": scene.light_distance_m,
        "cos_cone": math.cos(scene.emission_half_angle_rad),
    }
