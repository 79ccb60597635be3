"""A bench with its numbers and its light, and images as they are on it."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch

from warp_caustics.calibration.flat_light import flat_light
from warp_caustics.calibration.plate_border import crossed_pixels
from warp_caustics.found_bench.bench_numbers import AMBIENT, WHY_NOT_TOLD, BenchNumbers
from warp_caustics.found_bench.bench_record import FoundBench, FoundNumber
from warp_caustics.found_bench.picture_size import enlarged
from warp_caustics.found_bench.thin_relief import ThinRelief
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.reconstruct.pyramid import in_units_of_radiosity
from warp_caustics.reconstruct.seen_camera.aligned_channels import of_size
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

SLANTS = ("tilt_x_rad", "tilt_y_rad", "lamp_x_m", "lamp_y_m")
"""Numbers of light that comes from aside."""
BEND_LIGHT = ("gap_m", "base_thickness_m", "index_offset")
"""Numbers that heights make up for and lines nearly do."""
LEAST_TOLD = 5e-3
"""Change of how far light is bent, relative to it, that people are told of: 5 um of a line 1 mm high."""


@dataclass(frozen=True)
class Bench:
    """A bench and its light.

    Attributes:
        values: of its numbers, by name.
        field: brightness of each channel less 1, then slopes along x and y and curvatures x^2, xy, y^2 of all
            channels, x and y from -1 to 1 over the picture, shape [n_w + 5].
        sigma: standard deviations of values, by name; empty of the told one.
        rounds: benches about which the image was linearised on the way to it.
    """

    values: Mapping[str, float]
    field: FloatArray
    sigma: Mapping[str, float] = dataclasses.field(default_factory=dict)
    rounds: int = 0

    @classmethod
    def told(cls, numbers: BenchNumbers) -> "Bench":
        """As it is told, evenly lit."""
        values = {name: numbers.before[name] for name in numbers.names}
        return cls(values, np.zeros(numbers.scene.n_wavelengths + 5))

    @classmethod
    def found(cls, numbers: BenchNumbers, record: Mapping[str, Any], told_stray: float) -> "Bench":
        """As a record of :class:`~warp_caustics.found_bench.bench_record.FoundBench` has it, evenly lit.

        Args:
            numbers: of a bench whose told stray light has been taken off the image.
            record: of a search on the image as it was.
            told_stray: that was taken off, of flat light.
        """
        used = {number["name"]: number for number in record["numbers"] if number["name"] in numbers.names}
        values = {name: number["found"] for name, number in used.items()}
        if AMBIENT in values:
            values[AMBIENT] = (values[AMBIENT] - told_stray) / (1 + told_stray)
        sigma = {name: number["sigma"] for name, number in used.items()}
        told = cls.told(numbers)
        return dataclasses.replace(told, values={**told.values, **values}, sigma=sigma)

    def moved(self, numbers: BenchNumbers, step: FloatArray) -> "Bench":
        """The one a round of a search further on, within what its numbers may be.

        Args:
            numbers: whose values move, one after another, and then the field.
            step: in their units, shape [K + n_w + 5].
        """
        names = numbers.names
        values = {name: self.values[name] + float(by) for name, by in zip(names, step, strict=False)}
        found, field = {**self.values, **numbers.within(values)}, self.field + step[len(names) :]
        return dataclasses.replace(self, values=found, field=field, rounds=self.rounds + 1)

    def is_told(self, numbers: BenchNumbers) -> bool:
        """Whether nothing of it is other than told."""
        return all(value == numbers.before[name] for name, value in self.values.items()) and not self.field.any()

    def uneven(self, pixels: int) -> float:
        """Difference of the brightest place and the darkest one of a flat picture [1]."""
        return float(np.ptp(self._shared(pixels)))

    def light(self, pixels: int) -> FloatArray:
        """What each pixel is brighter by than on the even bench [1], shape [n_w, m, m]."""
        channels = len(self.field) - 5
        light: FloatArray = 1 + self.field[:channels, None, None] + self._shared(pixels)
        return np.broadcast_to(light, (channels, pixels, pixels))

    def _shared(self, pixels: int) -> FloatArray:
        """What channels have in common of it, shape [m, m], row by row and column by column."""
        along_x, along_y, square_x, both, square_y = self.field[-5:]
        if not self.field[-5:].any():
            return np.zeros((1, 1))
        x = (np.arange(pixels) + 0.5) * (2 / pixels) - 1
        columns, rows = (a * x + b * (x**2 - 1 / 3) for a, b in ((along_x, square_x), (along_y, square_y)))
        shared: FloatArray = columns + rows[:, None] + np.outer(both * x, x)
        return shared


class ShownLight(NamedTuple):
    """What a bench and its light make of a picture on that bench's own even plate: factor * E + added.

    Attributes:
        factor: shape [n_w, m, m] [1].
        added: of stray light, in units of the radiosity, same shape.
    """

    factor: torch.Tensor
    added: torch.Tensor

    @classmethod
    def by(cls, numbers: BenchNumbers, bench: Bench, device: torch.device) -> "ShownLight":
        """By a bench (:func:`lit`)."""
        stray = bench.values.get(AMBIENT, numbers.before[AMBIENT])
        light = _light_on(tuple(bench.field.tolist()), numbers.scene.image_pixels, device) / (1 + stray)
        if _is_parallel(numbers, bench):
            return cls(light, stray * light)
        return cls(light / torch.from_numpy(flat_ratio(numbers, bench)).to(light), stray * light)


@lru_cache(maxsize=2)
def _light_on(field: tuple[float, ...], pixels: int, device: torch.device) -> torch.Tensor:
    """:meth:`Bench.light` on a device: other benches have the same, and to bring it there takes longer than a picture.

    Not to be written to.
    """
    return torch.tensor(Bench({}, np.array(field)).light(pixels), dtype=torch.float64, device=device)


def field_modes(channels: int, pixels: int) -> FloatArray:
    """Patterns of :attr:`Bench.field`, shape [n_w + 5, n_w, m, m]."""
    own = np.eye(channels)[:, :, None, None] * np.ones((pixels, pixels))
    modes: FloatArray = np.concatenate([own, np.repeat(shared_modes(pixels)[:, None], channels, axis=1)])
    return modes


@lru_cache(maxsize=2)
def field_modes_on(channels: int, pixels: int, device: torch.device) -> torch.Tensor:
    """:func:`field_modes` in float32 on a device, made once; not to be written to."""
    return torch.from_numpy(field_modes(channels, pixels)).to(device, torch.float32)


def shared_modes(pixels: int) -> FloatArray:
    """Patterns that channels have in common, shape [5, m, m]."""
    x = (np.arange(pixels) + 0.5) * (2 / pixels) - 1
    along_x, along_y = np.broadcast_to(x, (pixels, pixels)), np.broadcast_to(x[:, None], (pixels, pixels))
    return np.stack([along_x, along_y, along_x**2 - 1 / 3, along_x * along_y, along_y**2 - 1 / 3])


def seen_on(
    image: CausticImage, numbers: BenchNumbers, bench: Bench, exposure: FloatArray | None = None
) -> CausticImage:
    """An image as it would be on the bench's own flat plate, evenly lit, without stray light and of its scene's size.

    Pixels that the border of the plate's picture crosses there do not count.

    Args:
        image: as it was measured.
        numbers: that the bench's are.
        bench: that it was taken on.
        exposure: of the image, shape [n_w]; 1 if None.
    """
    scene, stray = numbers.scene, bench.values.get(AMBIENT, numbers.before[AMBIENT])
    level = np.asarray(scene.radiosity_W_m2, np.float64) * (1.0 if exposure is None else exposure)
    irradiance, noise = np.asarray(image.irradiance), image.noise_std
    if not _is_lit_evenly(numbers, bench):
        irradiance = irradiance.astype(np.float64) / bench.light(scene.image_pixels)
        irradiance = irradiance * (1 + stray) - stray * level[:, None, None]
        noise = None if noise is None else np.asarray(noise) * stretched(numbers, bench)
    if not _is_parallel(numbers, bench):
        irradiance = irradiance * flat_ratio(numbers, bench)
    found, mask = numbers.scene_of(bench.values), image.mask
    if found != scene and (crossed := crossed_pixels(found)).any():
        mask = ~crossed & (np.ones(irradiance.shape, bool) if mask is None else np.asarray(mask, bool))
    seen = dataclasses.replace(image, irradiance=irradiance, noise_std=noise, mask=mask)
    return of_size(seen, 1 / numbers.picture_size(bench.values), "cpu")


def stretched(numbers: BenchNumbers, bench: Bench) -> FloatArray:
    """By how much :func:`seen_on` stretches each channel's noise, shape [n_w]: 1 % for 1 % of stray light taken off.

    Args:
        numbers: that the bench's are.
        bench: that the image was taken on.
    """
    if _is_lit_evenly(numbers, bench):
        return np.ones(numbers.scene.n_wavelengths)
    stray = bench.values.get(AMBIENT, numbers.before[AMBIENT])
    by_channel: FloatArray = ((1 + stray) / bench.light(numbers.scene.image_pixels)).mean(axis=(1, 2))
    return by_channel


def as_measured(found: Reconstruction, numbers: BenchNumbers, bench: Bench, exposure: FloatArray) -> Reconstruction:
    """A result with its images as the measured one is.

    Args:
        found: with images of the bench's own, evenly lit plate; what the camera shows is of its own size.
        numbers: that the bench's are.
        bench: on which heights are.
        exposure: of the measured image, shape [n_w].
    """
    size = numbers.picture_size(bench.values)
    image = lit(found.image, numbers, bench, exposure, size)
    shown = None if found.shown is None else lit(found.shown, numbers, bench, exposure)
    return dataclasses.replace(found, image=image, shown=shown)


def lit(shown: FloatArray, numbers: BenchNumbers, bench: Bench, exposure: FloatArray, size: float = 1.0) -> FloatArray:
    """The inverse of :func:`seen_on` for irradiance [W/m^2], shape [n_w, m, m].

    Args:
        shown: on the bench's own flat plate.
        numbers: that the bench's are.
        bench: on which it is.
        exposure: of the measured image, shape [n_w].
        size: of the measured picture over what is shown.
    """
    scene, stray = numbers.scene, bench.values.get(AMBIENT, numbers.before[AMBIENT])
    level = np.asarray(scene.radiosity_W_m2, np.float64) * exposure
    sized = enlarged(torch.as_tensor(shown, dtype=torch.float64), size).numpy()
    light = (sized / flat_ratio(numbers, bench) + stray * level[:, None, None]) / (1 + stray)
    measured: FloatArray = (light * bench.light(scene.image_pixels)).astype(shown.dtype)
    return measured


def bench_record(numbers: BenchNumbers, bench: Bench) -> FoundBench:
    """What was found, number by number; all of it is used. Numbers that had not to be asked are as told."""
    found, unasked = [], []
    for p in numbers.parameters:
        if p.name not in bench.sigma and bench.values[p.name] == numbers.before[p.name]:
            unasked += [p] if p.name in WHY_NOT_TOLD else []
            continue
        value = bench.values[p.name]
        number = FoundNumber.of(p, numbers.before[p.name], value, bench.sigma.get(p.name), is_used=True)
        found.append(dataclasses.replace(number, found=value))
    untold = [FoundNumber.not_told(p, numbers.before[p.name]) for p in (*unasked, *numbers.not_told)]
    return FoundBench((*found, *untold), True, "lines explain the image better on it", bench.rounds, numbers.is_picture)


def bench_warnings(numbers: BenchNumbers, bench: Bench, record: FoundBench) -> list[str]:
    """What the user should know, also where gap, base and index are other together and none of them by itself."""
    told, found = (ThinRelief.of(each).linear for each in (numbers.scene, numbers.scene_of(bench.values)))
    names = {number.name for number in record.numbers if number.verdict == "found"}
    if names & set(BEND_LIGHT) or abs(found / told - 1) < LEAST_TOLD:
        return record.warnings()
    together = (
        f"lines tell of a bench with {100 * (found / told - 1):+.1f} % on base, gap and index together, which of them "
        "the image hardly says; heights are those on that bench: check it, or take --set-up known"
    )
    return [*record.warnings(), together]


def flat_ratio(numbers: BenchNumbers, bench: Bench) -> FloatArray:
    """Light of a flat plate on the bench over that on the told one, shape [n_w, m, m]; 1 for parallel light."""
    told, found = numbers.scene, numbers.scene_of(bench.values)
    if _is_parallel(numbers, bench):
        return np.ones((told.n_wavelengths, told.image_pixels, told.image_pixels))
    return _level(found) / _level(told)


def _is_lit_evenly(numbers: BenchNumbers, bench: Bench) -> bool:
    """Whether the lamp's light is even and as bright as told, and none is stray."""
    return not bench.values.get(AMBIENT, numbers.before[AMBIENT]) and not bench.field.any()


def _is_parallel(numbers: BenchNumbers, bench: Bench) -> bool:
    """Whether light is parallel on the told bench and on the found one, behind flat plates the same everywhere."""
    return numbers.scene.is_collimated and numbers.scene_of(bench.values).is_collimated


@lru_cache(maxsize=4)
def _level(scene: Scene) -> FloatArray:
    light: FloatArray = flat_light(in_units_of_radiosity(scene, scene.image_pixels), scene.image_pixels).numpy()
    level = np.maximum(light, 1e-3)
    level.flags.writeable = False
    return level
