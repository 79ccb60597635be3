"""Whether heights may be wrong by much more than they say: one decision, from all that a result knows of itself.

    E^2 = (max(1, r)^2 u_image^2 + u_bench^2 + (S^2 - 1) u_care^2) / u^2

is the error that is to be expected over the stated uncertainty u. What is left of the image is r times what reliefs
leave that are off by u_image; parts of the bench leave nothing of an image, for heights make up for them. u_care is
what gap, base and index make of u_bench where nobody says how well they are known: no image tells them, and what is
assumed is a bench that was measured with care. Whether it was, other numbers tell. By the Birge ratio (R. T. Birge,
Phys. Rev. 40, 207 (1932)) deviations that are S times as large as their widths say that all widths are S times too
small; here S is the second largest of independent signs, for one may be an accident, and two are a habit.

A number of the bench that was found to be another is part of u, by as much as it is uncertain. It is told, and is no
doubt; in a result whose uncertainty has no part of it, it is.

Ratios of parts of the image, and the area of dirt, were tried and tell nothing (docs/trust.md).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.bench_record import NOT_TOLD
from warp_caustics.found_bench.bench_uncertainty import careful_widths
from warp_caustics.found_bench.rest_causes import GRAIN, MIXING, SPOTS, UNEVEN, Cause
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera

MOST_TIMES = 1.5
"""Error to be expected, over the stated uncertainty, up to which nothing is said. At 1.5, one that is three times the
stated uncertainty is two deviations away: one result in twenty would be wrong."""
UNTOLD = ("gap_m", "base_thickness_m", "index_offset")
"""Numbers that no image tells, and that act as a factor on the heights."""
UNIFORM = 1 / math.sqrt(3)
"""Root mean square over the end of a range from 0."""
CAREFUL = {
    AMBIENT: 0.006 * UNIFORM, UNEVEN: 0.005 * UNIFORM, MIXING: 0.01 * UNIFORM, GRAIN: 0.005 * UNIFORM,
    SPOTS: 2 * UNIFORM, "colours_px": 0.05 * UNIFORM, "blur_px": 0.5,
}  # fmt: skip
"""Of light, camera and dirt beside a bench that was measured with care: ranges of configs/benches/careful.yaml; every
lens blurs, so that the sharp one's own blur counts whole. Units of the causes' values."""
SET_UP = "set-up"
"""The sign of place and lamp, which are one: a lamp that is nearer and aside moves the picture, too."""


@dataclass(frozen=True)
class Doubt:
    """How wrong heights may be, and why.

    Attributes:
        times: error to be expected over the stated uncertainty (root mean squares over the plate); None without one.
        ratio: of what is left of the image to what the uncertainty leaves; None without one.
        care: S, at least 1.
        signs: deviations in widths of a careful bench, by name, the largest first.
        unsaid: numbers of :data:`UNTOLD` that nobody gave a width of.
        apart: causes that heights have made up for, and that no uncertainty has a part of.
    """

    times: float | None
    ratio: float | None
    care: float
    signs: Mapping[str, float]
    unsaid: tuple[str, ...]
    apart: tuple[Cause, ...] = ()

    @property
    def is_doubtful(self) -> bool:
        """Whether a warning is due."""
        return bool(self.apart) or (self.times is not None and self.times > MOST_TIMES)

    @property
    def record(self) -> dict[str, Any]:
        """For a result's counters."""
        return {
            "times": self.times,
            "care": self.care,
            "signs": dict(self.signs),
            "is_doubtful": self.is_doubtful,
        }

    def warnings(self) -> list[str]:
        """What the user should know."""
        told = []
        if self.apart:
            told.append(
                "the image looks as of a bench other than told, and heights have made up for some of it: "
                f"{'; '.join(cause.words for cause in self.apart)}; measure it, or take --set-up estimate"
            )
        if self.times is None or self.times <= MOST_TIMES:
            return told
        is_left = self.ratio is not None and self.ratio > MOST_TIMES
        if is_left:
            told.append(
                f"{self.ratio:.2g} times as much is left of the image as heights would leave that are as uncertain as "
                f"is said (limit {MOST_TIMES:g}): they may be wrong by more; check lamp, place and camera"
            )
        else:
            first = ", ".join(f"{name} {size:.2g}" for name, size in list(self.signs.items())[:3])
            told.append(
                f"heights may be wrong by {self.times:.2g} times what is said (limit {MOST_TIMES:g}): the image shows "
                f"less care than is assumed ({first} times its width), and no image tells {', '.join(self.unsaid)}; "
                "say how well they are known, --prior gap_m=50um"
            )
        return told


def doubt_of(counters: Mapping[str, Any], numbers: BenchNumbers, stated_um: float | None) -> Doubt:
    """Whether heights may be wrong by much more than they say.

    Args:
        counters: of a result, with what is left of its image and the parts of its uncertainty.
        numbers: of the bench as it is told, with what is known of them.
        stated_um: root mean square of the stated uncertainty over the plate [um]; None without one.
    """
    rest, parts = counters["rest"], counters.get("uncertainty")
    known = {} if parts is None else parts["numbers"]
    bench = tuple(Cause(**cause) for cause in rest["causes"] if cause["is_bench"])
    apart = tuple(cause for cause in bench if cause.name not in known)
    signs = signs_of_care(counters, numbers)
    care = max([1.0, *list(signs.values())[1:2]])
    unsaid = tuple(name for name in UNTOLD if name in known and name not in numbers.told_widths)
    ratio = rest["ratio"]
    if stated_um is None:
        return Doubt(None, ratio, care, signs, unsaid, apart)
    image, of_bench = (stated_um, 0.0) if parts is None else (parts["network_um"], parts["bench_um"])
    assumed = math.hypot(*(known[name]["um"] for name in unsaid))
    expected = math.hypot(max(1.0, ratio or 0.0) * image, of_bench, math.sqrt(care**2 - 1) * assumed)
    times = expected / math.hypot(image, of_bench, 1e-12)
    return Doubt(times, ratio, care, signs, unsaid, apart)


def signs_of_care(counters: Mapping[str, Any], numbers: BenchNumbers) -> dict[str, float]:
    """Deviations of what an image tells, in widths of a careful bench, by name; the largest first.

    Of the bench those beyond their own uncertainty. Dispersion is none: colours apart look the same.
    """
    widths = careful_widths(numbers.scene) | dict(numbers.told_widths)
    found: dict[str, float] = {}

    def take(sign: str, size: float) -> None:
        found[sign] = max(found.get(sign, 0.0), size)

    def take_number(name: str, value: float, sigma: float) -> None:
        beyond = math.sqrt(max(value**2 - sigma**2, 0.0))
        if name == AMBIENT:
            take(AMBIENT, beyond / CAREFUL[AMBIENT])
        elif name != "dispersion_scale" and widths.get(name):
            take(SET_UP, beyond / widths[name])

    for number in counters.get("bench", {}).get("numbers", []):
        if number["seen"] is not None and number["verdict"] != NOT_TOLD:
            take_number(number["name"], number["seen"] - number["told"], number["sigma"])
    for cause in counters["rest"]["causes"]:
        if cause["is_bench"] or cause["name"] == AMBIENT:
            take_number(cause["name"], cause["value"], cause["sigma"])
        elif cause["name"] in CAREFUL:
            take(cause["name"], cause["value"] / CAREFUL[cause["name"]])
    if "camera" in counters:
        camera = ChannelCamera.of_record(counters["camera"], numbers.scene.image_pixels)
        take("colours_px", float(camera.apart_px.max()) / CAREFUL["colours_px"])
        take("blur_px", float(camera.blur.max()) / CAREFUL["blur_px"])
    return dict(sorted(found.items(), key=lambda pair: -pair[1]))
