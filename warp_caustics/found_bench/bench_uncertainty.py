"""What of the heights' uncertainty is the bench's: each number's deviation times what heights do in answer to it.

    u_bench^2 = sum over theta of (dh / d theta)^2 sigma_theta^2,

the law of propagation of JCGM 100:2008 (GUM), equation 10, for numbers that were measured independently, with the
derivatives of :mod:`~warp_caustics.found_bench.thin_relief`. All heights of a plate are off together: it is a standard
deviation over benches, and no mean over a plate makes it smaller.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from warp_caustics.found_bench.bench_record import NOT_TOLD
from warp_caustics.found_bench.thin_relief import MAGNIFICATION, TURN, parameters_of, relief_responses
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

BASE_M = 5e-6
"""Of a micrometer screw, and the plate's own variation."""
GAP_M = 1e-5
"""Of a feeler gauge or a spacer; and of a plate that lies on its screen, where dust and what both are not flat make a
gap."""
INDEX = 3e-4
"""Of a melt against its catalogue: glass of grade 3 is within 0.0005."""
GLASS = 0.05
"""Of the index of a glass whose dispersion is found to be another, per multiple of the told one: it is another glass.
That of common glasses is 0.03 and 0.06 higher where their dispersion is 1.2 to 1.3 times that of silica."""
LAMP_DISTANCE = 0.01
"""Of a lamp's distance, relative."""
VERGENCE_PER_M = 0.02
"""Of light that is collimated: the lamp's image is 50 m away or farther."""
CORNER_PX = 0.05
"""Of each of the window's corners, along x and along y, where two edges cross that are fitted along all their length;
what four of them leave of its place, turn and size."""
IN_DOUBT = "in doubt"
DISPERSION, INDEX_OFFSET = "dispersion_scale", "index_offset"


def careful_widths(scene: Scene) -> dict[str, float]:
    """Standard deviations of a bench that somebody measured with care, by name.

    Four corners at (+-h/2, +-h/2), each off by e, tell the middle to e / 2 and turn and size to e / (h sqrt 2).
    """
    corner = CORNER_PX * max(scene.pixel_size_m)
    window = corner / (max(scene.plate_size_m) * math.sqrt(2))
    widths = {
        "base_thickness_m": BASE_M,
        "gap_m": GAP_M,
        "index_offset": INDEX,
        "screen_x_m": corner / 2,
        "screen_y_m": corner / 2,
        TURN: window,
        MAGNIFICATION: window,
    }
    if scene.is_collimated:
        return widths | {"vergence_per_m": VERGENCE_PER_M}
    return widths | {"lamp_distance_m": LAMP_DISTANCE * scene.light_distance_m}


def bench_widths(
    scene: Scene, told: Mapping[str, float] | None = None, found: Iterable[Mapping[str, Any]] = ()
) -> dict[str, float]:
    """Standard deviations of what is used of a bench, by name; of those that heights answer to.

    Args:
        scene: as it is told.
        told: how well its numbers are known, by name; 0 is exact. Others are :func:`careful_widths`.
        found: numbers that an image told of, as :class:`~warp_caustics.found_bench.bench_record.FoundNumber` records
            them; one that is in doubt may be what the image says.
    """
    known = [p.name for p in parameters_of(scene)]
    widths = careful_widths(scene) | dict(told or {})
    found = list(found)
    for number in found:
        if number["name"] == DISPERSION and number["verdict"] == "found" and INDEX_OFFSET not in (told or {}):
            widths[INDEX_OFFSET] = math.hypot(INDEX, GLASS * (number["found"] - number["told"]))
    for number in found:
        if number["verdict"] != NOT_TOLD:
            apart = number["seen"] - number["found"] if number["verdict"] == IN_DOUBT else 0.0
            widths[number["name"]] = math.hypot(number["sigma"], apart)
    return {name: widths[name] for name in known if widths.get(name)}


@dataclass(frozen=True, eq=False)
class BenchUncertainty:
    """The bench's part.

    Attributes:
        total_m: standard deviation of each height [m], shape [n, n].
        widths: of the numbers, by name, in their units.
        rms_m: what each number makes of it, root mean square over the plate [m].
    """

    total_m: FloatArray
    widths: dict[str, float]
    rms_m: dict[str, float]

    def beside(self, name: str, sigma_m: float) -> "BenchUncertainty":
        """With a part in quadrature that is the same everywhere.

        Args:
            name: of the part.
            sigma_m: its standard deviation [m]; 0 is none.
        """
        if not sigma_m:
            return self
        widths, rms_m = self.widths | {name: sigma_m}, self.rms_m | {name: sigma_m}
        return BenchUncertainty(np.hypot(self.total_m, sigma_m), widths, rms_m)

    @property
    def record(self) -> dict[str, Any]:
        """For a result's counters [um]."""
        return {
            "bench_um": 1e6 * _rms(self.total_m),
            "numbers": {
                name: {"sigma": width, "um": 1e6 * self.rms_m[name]}
                for name, width in sorted(self.widths.items(), key=lambda pair: -self.rms_m[pair[0]])
            },
        }


def bench_uncertainty(scene: Scene, heights: FloatArray, widths: Mapping[str, float]) -> BenchUncertainty:
    """u_bench of heights found on a bench.

    Args:
        scene: the bench.
        heights: [m], shape [n, n].
        widths: standard deviations by name, of :func:`bench_widths`.

    Raises:
        InputError: a name that no bench has.
    """
    heights = np.asarray(heights, np.float64)
    responses = relief_responses(scene, heights, widths) if widths else {}
    total, each = np.zeros_like(heights), {}
    for name, response in responses.items():
        part = widths[name] * response
        total += part**2
        each[name] = _rms(part)
    return BenchUncertainty(np.sqrt(total), dict(widths), each)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))
