"""What was found of a bench, number by number, for the record and for people."""

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

from warp_caustics.found_bench.bench_numbers import AMBIENT, WHY_NOT_TOLD
from warp_caustics.setup.parameter import Parameter

SIGNIFICANT = 4.0
"""Standard deviations from what was told at which a number is found to be another."""
TOLD = 0.8
"""What an image leaves of a prior width at most where it says something."""
LEAST = {"screen_x_m": 6e-6, "screen_y_m": 6e-6, "vergence_per_m": 0.05, "dispersion_scale": 0.06, AMBIENT: 4e-3}
"""Systematic deviations: what plates on benches that are as told show besides (docs/found_bench.md)."""

NOT_TOLD: Literal["not told by this image"] = "not told by this image"
Verdict = Literal["found", "as told", "in doubt", "not told by this image"]
"""In doubt: the image says otherwise, but heights on that bench explain it no better, and what was told is used."""


def deviation(parameter: Parameter, sigma: float | None) -> float:
    """Standard deviation of a number, what no image shows beside its noise included; at most what was known before."""
    if sigma is None:
        return parameter.prior
    return min(math.hypot(sigma, LEAST.get(parameter.name, 0.0)), parameter.prior)


def verdict_of(parameter: Parameter, told: float, value: float, sigma: float | None) -> Verdict:
    """What an image says of a number: sigma is what its noise leaves, None where it was not looked for."""
    whole = deviation(parameter, sigma)
    if sigma is None or whole > TOLD * parameter.prior:
        return NOT_TOLD
    return "found" if abs(value - told) > SIGNIFICANT * whole else "as told"


@dataclass(frozen=True)
class FoundNumber:
    """One number of a bench, in its unit.

    Attributes:
        name: as in :mod:`warp_caustics.setup`.
        unit: "1" for a ratio.
        told: what was told.
        found: what is used; the same unless the verdict is ``found`` and heights are those of the found bench.
        seen: what the image says; None of a number that was not looked for.
        sigma: standard deviation.
        prior: of what was told.
        verdict: what the image says.
        why: of a number that no image tells.
    """

    name: str
    unit: str
    told: float
    found: float
    seen: float | None
    sigma: float
    prior: float
    verdict: Verdict
    why: str = ""

    @classmethod
    def of(cls, parameter: Parameter, told: float, seen: float, sigma: float | None, *, is_used: bool) -> "FoundNumber":
        """Of a number that was looked for.

        Args:
            parameter: which.
            told: what was told.
            seen: what the image says.
            sigma: what its noise leaves; None where the search broke off.
            is_used: heights are those of the found bench.
        """
        verdict = verdict_of(parameter, told, seen, sigma)
        if verdict == "found" and not is_used:
            verdict = "in doubt"
        used = seen if verdict == "found" else told
        whole = deviation(parameter, sigma)
        return cls(
            parameter.name, parameter.unit, told, used, None if sigma is None else seen, whole, parameter.prior, verdict
        )

    @classmethod
    def not_told(cls, parameter: Parameter, told: float) -> "FoundNumber":
        """Of a number that heights make up for."""
        name, why = parameter.name, WHY_NOT_TOLD[parameter.name]
        return cls(name, parameter.unit, told, told, None, parameter.prior, parameter.prior, NOT_TOLD, why)


@dataclass(frozen=True)
class FoundBench:
    """A bench beside the one that was told.

    Attributes:
        numbers: all of them.
        is_kept: heights are those of the found bench.
        why: of that.
        rounds: steps that were taken.
    """

    numbers: tuple[FoundNumber, ...]
    is_kept: bool
    why: str
    rounds: int

    @property
    def record(self) -> dict[str, Any]:
        """For a result's counters."""
        return {
            "numbers": [asdict(number) for number in self.numbers],
            "is_kept": self.is_kept,
            "why": self.why,
            "rounds": self.rounds,
        }

    def warnings(self) -> list[str]:
        """What the user should know, a line for all numbers."""
        off = [number for number in self.numbers if number.verdict == "found"]
        if not off:
            return []
        listed = ", ".join(f"{n.name} {n.found:.3g} +- {n.sigma:.1g} instead of {n.told:.3g}" for n in off)
        return [
            f"the image tells of another bench than was told: {listed}; heights are those on that bench, check it, or "
            "take --set-up known"
        ]
