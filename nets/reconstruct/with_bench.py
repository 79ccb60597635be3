"""A result whose uncertainty knows how well the bench is known."""

import dataclasses
import math
from collections.abc import Collection, Mapping
from typing import NamedTuple, Protocol

import numpy as np

from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import NOT_TOLD
from warp_caustics.found_bench.bench_uncertainty import BenchUncertainty, bench_uncertainty, bench_widths
from warp_caustics.found_bench.care import care_of
from warp_caustics.found_bench.thin_relief import parameters_of
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

KEPT_BY_HEIGHTS = 2.0
"""By how much more than the rest of an image says a bench may be off: heights keep half of it and more to themselves
(docs/found_bench.md)."""
FLATNESS_M = 5e-7
"""Standard deviation from a plane of a base that was chosen with care. Half of the prints of
configs/benches/careful.yaml are bowed by up to 3 um, 0.8 um in the root mean square of all; no source measures one."""
FLATNESS = "flatness_m"


class Told(NamedTuple):
    """What numbers of a bench leave open, of which an image tells.

    Attributes:
        deviation_m: standard deviation of heights [m], shape [n, n].
        sigma: of the numbers, by name, in their units.
    """

    deviation_m: FloatArray
    sigma: dict[str, float]


class Teller(Protocol):
    """What an image tells of numbers of its bench that are as told."""

    @property
    def names(self) -> Collection[str]:
        """Of the numbers."""

    def known(self, widths: Mapping[str, float]) -> Told:
        """What is left open by these, of which so much is known before, by name."""


def with_bench(
    found: Reconstruction,
    numbers: BenchNumbers,
    counted: Collection[str] = (),
    flatness_m: float | None = None,
    told: Teller | None = None,
) -> Reconstruction:
    """The result with the bench's part in its uncertainty, in quadrature; one without an uncertainty as it is.

    ``counters["uncertainty"]`` says the parts: root mean squares over the plate [um]; and how much less care was taken
    of the bench than is assumed, so much less well are numbers known that no image tells
    (:mod:`warp_caustics.found_bench.care`). Nor does any image tell a bow of the base, which bends light by less than
    a thousandth of what lines do, and is in the heights as large as it is.

    Args:
        found: heights on the grid of the numbers' scene.
        numbers: of the bench as it is told, with what is known of them.
        counted: names of those that the uncertainty has a part of already, having been found with lines.
        flatness_m: standard deviation of the base from a plane [m]; None: nobody says, so that it is known as well as
            the rest of the bench.
        told: what the image tells of some numbers; None: nothing.
    """
    if found.uncertainty_m is None:
        return found
    told_of = found.counters.get("bench", {}).get("numbers", [])
    known = {p.name for p in parameters_of(numbers.scene)}
    # Heights answer to a bench that was found nearly as they do to the told one, whose numbers have these names.
    widths = bench_widths(numbers.scene, numbers.told_widths, told_of)
    care = care_of(found.counters, numbers)
    told_by_image = {number["name"] for number in told_of if number["verdict"] != NOT_TOLD}
    widths, widened = care.widened(widths, told_by_image.union(numbers.told_widths, counted))
    # A bench that looks like another, and is used as it is told, may be that one.
    for cause in found.counters.get("rest", {}).get("causes", []):
        if cause["is_bench"]:
            widths[cause["name"]] = math.hypot(
                widths.get(cause["name"], 0.0), KEPT_BY_HEIGHTS * cause["value"], cause["sigma"]
            )
    widths = {name: widths[name] for name in widths if name in known and name not in counted}
    flat = care.times * FLATNESS_M if flatness_m is None else flatness_m
    part = _bench_part(numbers.scene, found.heights_m, widths, told).beside(FLATNESS, flat)
    network = float(np.sqrt(np.mean(np.square(found.uncertainty_m, dtype=np.float64))))
    whole = np.hypot(found.uncertainty_m, part.total_m)
    if flatness_m is None and care.times > 1:
        widened = [*widened, FLATNESS]
    record = {"network_um": 1e6 * network, **part.record, "care": care.record(part.widths, widened)}
    return dataclasses.replace(found, uncertainty_m=whole, counters=found.counters | {"uncertainty": record})


def _bench_part(
    scene: Scene, heights_m: FloatArray, widths: Mapping[str, float], told: Teller | None
) -> BenchUncertainty:
    """The bench's part; numbers that the image tells have their shares of it by what would be theirs without that."""
    names = set(widths).intersection(told.names if told is not None else ())
    if told is None or not names:
        return bench_uncertainty(scene, heights_m, widths)
    others = bench_uncertainty(scene, heights_m, {name: widths[name] for name in widths if name not in names})
    before = bench_uncertainty(scene, heights_m, {name: widths[name] for name in names})
    known = told.known({name: widths.get(name, 0.0) for name in told.names})
    whole, rms = (float(np.sqrt(np.mean(np.square(each)))) for each in (before.total_m, known.deviation_m))
    shares = {name: part * rms / whole if whole else 0.0 for name, part in before.rms_m.items()}
    return BenchUncertainty(
        np.hypot(others.total_m, known.deviation_m),
        others.widths | {name: known.sigma[name] for name in names},
        others.rms_m | shares,
    )
