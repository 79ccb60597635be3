"""How carefully a bench was set up, by what its image tells: numbers that it does not tell are known as much less well.

What is assumed of a bench is that somebody measured it with care. Gap, base and index act on the heights as one factor,
which heights make up for, so that no image tells them; whether the care was taken, other numbers tell. By the Birge
ratio (R. T. Birge, Phys. Rev. 40, 207 (1932)) deviations that are S times as large as their widths say that all widths
are S times too small. S is the second largest of independent signs here, for one may be an accident, and two are a
habit; and at least 1. An accident that were all explains the image once it is known: where lines leave much more than
noise on the bench that was found, the largest sign has it.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.bench_record import NOT_TOLD
from warp_caustics.found_bench.bench_uncertainty import careful_widths
from warp_caustics.found_bench.doubt import UNEXPLAINED, left_by_lines
from warp_caustics.found_bench.rest_causes import GRAIN, MIXING, SPOTS, UNEVEN
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera

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
TOLD_TIMES = 2.0
"""S from which on the user is told: of eight signs of a careful bench two are as large by chance once in twenty."""
SET_UP = "set-up"
"""The sign of place and lamp, which are one: a lamp that is nearer and aside moves the picture, too."""


@dataclass(frozen=True)
class Care:
    """How many times less care was taken than is assumed.

    Attributes:
        times: S, at least 1.
        signs: deviations in widths of a careful bench, by name, the largest first.
    """

    times: float
    signs: Mapping[str, float]

    def record(self, widths: Mapping[str, float], widened: Sequence[str]) -> dict[str, Any]:
        """For a result's counters.

        Args:
            widths: standard deviations that are used, by name.
            widened: names of those that were :meth:`widened`.
        """
        found = {"times": self.times, "signs": dict(self.signs), "widened": list(widened)}
        return found | {"line": self._line(widths, widened)}

    def _line(self, widths: Mapping[str, float], widened: Sequence[str]) -> str:
        """What the user should know; empty where hardly anything was widened."""
        if self.times < TOLD_TIMES or not widened:
            return ""
        most = ", ".join(f"{name} {size:.2g}" for name, size in list(self.signs.items())[:3])
        numbers = ", ".join(f"{name} +- {widths[name]:.2g}" for name in widened)
        return (
            f"the image shows {self.times:.2g} times less care than is assumed ({most} times its width), and no image "
            f"tells {numbers}: known so much less well; say how well they are, --prior gap_m=50um"
        )

    def widened(self, widths: Mapping[str, float], known: Collection[str]) -> tuple[dict[str, float], list[str]]:
        """Standard deviations by name, S times as wide where no image tells and nobody says; and the names of those.

        Args:
            widths: of a bench that was measured with care, or as they are known.
            known: names of numbers whose widths the user or the image says.
        """
        wider = [name for name in UNTOLD if name in widths and name not in known] if self.times > 1 else []
        return dict(widths) | {name: self.times * widths[name] for name in wider}, wider


def care_of(counters: Mapping[str, Any], numbers: BenchNumbers) -> Care:
    """What a result's image tells of the care that was taken.

    Args:
        counters: of the result, with what is left of its image; without that nothing is told.
        numbers: of the bench as it is told, with what is known of them.
    """
    signs = signs_of_care(counters, numbers) if "rest" in counters else {}
    sizes = list(signs.values())
    return Care(max([1.0, *(sizes[:1] if left_by_lines(counters) > UNEXPLAINED else sizes[1:2])]), signs)


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
