"""A user's scene as a network sees it that knows other numbers of pixels and samples, another plate, other wavelengths.

Refraction knows no length: where heights, base, gap, lamp and plate are all multiplied by one factor, so is the place
where each ray lands, and the image of as many pixels is the same. So a plate of 30 mm on a base of 3 mm is, to a
network whose plate has 50 mm, a plate of 50 mm on a base of 5 mm, and its heights are 3/5 of what the network answers.
Exact in geometric optics, which the simulator is; angles and indices stay. Lines look 5/3 as wide and high.

Wavelengths are no lengths here: they come in by the index of the glass alone. A channel of the network without a
wavelength of its own shows the middle one.
"""

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from warp_caustics.scene import Scene

PIXELS = (0.5, 4.0)
"""Image pixels per side over the network's own: 256 to 2048 for 512."""
SAMPLES = (0.25, 4.0)
"""Height samples likewise: 32 to 512 for 128."""
SIZES = (0.4, 2.0)
"""Size of the plate likewise: 20 to 100 mm for 50 mm."""
LARGEST_STRETCH = 0.01
"""By how much a plate may be more oblong than the network's: a slope seen as 1 % steeper is what refinement mends."""
SAME = 1e-9
"""Relative difference of lengths that are one but for rounding."""


@dataclass(frozen=True)
class SeenScene:
    """A user's scene for a network.

    Attributes:
        user: the scene of the measurement.
        scene: what the network sees: its own plate, grid and number of wavelengths, the user's bench scaled.
        scale: its lengths over the user's.
        channels: which of the user's channels each channel of the network shows.
    """

    user: Scene
    scene: Scene
    scale: float
    channels: tuple[int, ...]

    @property
    def is_same(self) -> bool:
        """Whether images and heights are the network's own as they are."""
        return (
            self.scale == 1.0
            and self.channels == tuple(range(self.user.n_wavelengths))
            and self.user.image_pixels == self.scene.image_pixels
            and self.user.height_samples == self.scene.height_samples
        )

    @property
    def working(self) -> Scene:
        """The user's scene with as many samples as heights are found and refined with.

        No fewer than the network answers with: a plate is finer than few samples say, and a relief of 64 that is bent
        until it explains the image of one of 128 is worse than its start (two plates: from 27 um to 89 um). More only
        where there are as many pixels for each as the network has: what pixels do not tell is bent, too (a relief of
        256 under 512 pixels: from 28 um to 33 um, one of 128 from 26 to 19). The user's are made of these at the end.
        """
        ratio = self.scene.image_pixels / self.scene.height_samples
        told = min(self.user.height_samples, int(self.user.image_pixels / ratio))
        samples = max(told, self.scene.height_samples)
        if samples == self.user.height_samples:
            return self.user
        return self.user.model_copy(update={"height_samples": samples})

    @property
    def shown(self) -> int:
        """Different wavelengths that the network sees."""
        return len(set(self.channels))

    @property
    def record(self) -> dict[str, Any]:
        """What was resampled and scaled, for a result's settings; empty where nothing was."""
        if self.is_same:
            return {}
        return {
            "image_pixels": self.scene.image_pixels,
            "height_samples": self.scene.height_samples,
            "lengths_scaled_by": self.scale,
            "channels": list(self.channels),
            "refined_samples": self.working.height_samples,
        }


def grid_problems(scene: Scene, trained: Scene) -> list[str]:
    """Why a scene's grid, plate or light cannot be brought to a network's, with the nearest bound; empty if it can."""
    found = []
    for key, (low, high) in (("image_pixels", PIXELS), ("height_samples", SAMPLES)):
        value, own = getattr(scene, key), getattr(trained, key)
        least, most = math.ceil(low * own), math.floor(high * own)
        if not least <= value <= most:
            found.append(f"{key} is {value} here, the nearest that it serves is {least if value < least else most}")
    (x, y), (own_x, own_y) = scene.plate_size_m, trained.plate_size_m
    stretch = (x / y) / (own_x / own_y)
    if not 1 / (1 + LARGEST_STRETCH) <= stretch <= 1 + LARGEST_STRETCH:
        # Not to be stretched: two slopes of one relief would be seen as different ones.
        found.append(
            f"plate_size_m is {_millimetres(x, y)} here, one side {max(stretch, 1 / stretch) - 1:.0%} too long for a "
            f"network of {_millimetres(own_x, own_y)}"
        )
    else:
        size, own = math.sqrt(x * y), math.sqrt(own_x * own_y)
        low, high = (bound * own for bound in SIZES)
        if not low * (1 - SAME) <= size <= high * (1 + SAME):
            bound = low if size < low else high
            found.append(f"plate_size_m is {_millimetres(x, y)} here, the nearest that it serves is {1e3 * bound:g} mm")
    if _is_dark(trained).count(True) and (_is_dark(trained) != _is_dark(scene)):
        found.append(f"radiosity_W_m2 is {trained.radiosity_W_m2} there and {scene.radiosity_W_m2} here")
    return found


def seen_scene(scene: Scene, trained: Scene) -> SeenScene:
    """A scene as a network sees it.

    Args:
        scene: the user's, without :func:`grid_problems`.
        trained: the network's.
    """
    channels = channels_shown(scene, trained)
    ratio = math.sqrt(math.prod(trained.plate_size_m) / math.prod(scene.plate_size_m))
    scale = 1.0 if abs(ratio - 1) < SAME else ratio
    larger = scaled(scene, scale)
    wavelengths: list[float] = []
    for channel in channels:
        wavelength = scene.wavelengths_m[channel]
        while wavelength in wavelengths:  # no scene has one twice; the index is the same to all digits that count
            wavelength = math.nextafter(wavelength, 0.0)
        wavelengths.append(wavelength)
    update: dict[str, Any] = {
        "plate_size_m": trained.plate_size_m,
        "image_pixels": trained.image_pixels,
        "height_samples": trained.height_samples,
        "wavelengths_m": tuple(wavelengths),
        "radiosity_W_m2": trained.radiosity_W_m2,
    }
    for key in LENGTHS:
        update[key] = _rounded(getattr(larger, key), getattr(trained, key))
    return SeenScene(scene, larger.model_copy(update=update), scale, channels)


LENGTHS = ("base_thickness_m", "light_position_m", "screen_position_m", "lamp_radius_m")
"""Of a scene, besides its plate's."""


def scaled(scene: Scene, scale: float) -> Scene:
    """The scene with all its lengths multiplied; pixels and samples are as many."""
    if scale == 1.0:
        return scene

    def longer(value: Any) -> Any:
        return tuple(scale * each for each in value) if isinstance(value, tuple) else scale * value

    return scene.model_copy(update={key: longer(getattr(scene, key)) for key in ("plate_size_m", *LENGTHS)})


def in_own_lengths(scene: Scene, scale: float) -> Scene:
    """A scene that was scaled, in the lengths of before, rounded to what is said of them."""
    if scale == 1.0:
        return scene

    def said(value: Any) -> Any:
        return tuple(map(said, value)) if isinstance(value, tuple) else float(f"{value / scale:.6g}")

    return scene.model_copy(update={key: said(getattr(scene, key)) for key in ("plate_size_m", *LENGTHS)})


def channels_shown(scene: Scene, trained: Scene) -> tuple[int, ...]:
    """Which of the user's channels each channel of a network shows.

    Wavelengths go where the network's are nearest, in its order; the middle channel has one always, and those without
    show its picture. Dark wavelengths show nothing, and of more than the network has the nearest are shown.
    """
    count, dark = trained.n_wavelengths, _is_dark(scene)
    if any(_is_dark(trained)):
        return tuple(range(count))
    theirs = sorted(range(count), key=lambda k: trained.wavelengths_m[k])
    ours = sorted((k for k, none in enumerate(dark) if not none), key=lambda k: scene.wavelengths_m[k])
    middle, shared = count // 2, min(count, len(ours))

    def far(pairs: Iterable[tuple[int, int]]) -> float:
        return sum(abs(trained.wavelengths_m[own] - scene.wavelengths_m[user]) for own, user in pairs)

    choices: list[tuple[tuple[int, int], ...]] = [
        tuple(zip(places, users, strict=True))
        for places in itertools.combinations(theirs, shared)
        for users in itertools.combinations(ours, shared)
        if middle in places
    ]
    chosen = dict(min(choices, key=far))
    return tuple(chosen.get(channel, chosen[middle]) for channel in range(count))


def _is_dark(scene: Scene) -> list[bool]:
    return [value == 0 for value in scene.radiosity_W_m2]


def _rounded(value: Any, like: Any) -> Any:
    """A length, or the network's own where it is the same but for rounding."""
    if isinstance(value, tuple):
        return tuple(_rounded(one, other) for one, other in zip(value, like, strict=True))
    return like if math.isclose(value, like, rel_tol=SAME) else value


def _millimetres(x: float, y: float) -> str:
    return f"{1e3 * x:g} x {1e3 * y:g} mm"
