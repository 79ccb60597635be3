"""What was found of a bench, number by number, for the record and for people."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from warp_caustics.found_bench.bench_numbers import VERGENCE, WHY_NOT_TOLD
from warp_caustics.setup.parameter import Parameter

SIGNIFICANT = 4.0
"""Standard deviations from what was told at which a number is found to be another."""
TOLD = 0.8
"""What an image leaves of a prior width at most where it says something."""
NOT_TOLD: Literal["not told by this image"] = "not told by this image"
Verdict = Literal["found", "as told", "in doubt", "not told by this image"]
"""In doubt: the image says otherwise, but heights on that bench explain it no better, and what was told is used."""


def deviation(parameter: Parameter, sigma: float | None) -> float:
    """Standard deviation of a number: what an image leaves, at most what was known before."""
    return parameter.prior if sigma is None else min(sigma, parameter.prior)


def verdict_of(parameter: Parameter, told: float, value: float, sigma: float | None) -> Verdict:
    """What an image says of a number: sigma is its deviation, None where it was not looked for."""
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
        why: no image tells a number; or what a vergence is of, in records of a bench.
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
            sigma: its deviation; None where the search broke off.
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
        is_picture: a vergence is that of a picture of another size, and not of a lamp.
    """

    numbers: tuple[FoundNumber, ...]
    is_kept: bool
    why: str
    rounds: int
    is_picture: bool = False

    @property
    def record(self) -> dict[str, Any]:
        """For a result's counters."""
        return {
            "numbers": [asdict(number) | {"why": number.why or self._remark(number)} for number in self.numbers],
            "is_kept": self.is_kept,
            "why": self.why,
            "rounds": self.rounds,
            "is_picture": self.is_picture,
        }

    def warnings(self) -> list[str]:
        """What the user should know, a line for all numbers."""
        lines = []
        listed = self._listed("found")
        if listed:
            lines.append(
                f"the image tells of another bench than was told: {listed}; heights are those on that bench: check it, "
                "or take --set-up known"
            )
        listed = self._listed("in doubt")
        if listed:
            lines.append(
                f"the bench is in doubt: the image looks as of {listed}, but heights on that bench explain it no "
                "better; heights are those on the bench that was told: check it"
            )
        return lines

    def _listed(self, verdict: Verdict) -> str:
        return ", ".join(
            f"{n.name} {n.seen:.3g} +- {n.sigma:.1g} instead of {n.told:.3g}{in_brackets(self._remark(n))}"
            for n in self.numbers
            if n.verdict == verdict
        )

    def _remark(self, number: FoundNumber) -> str:
        """What a vergence is of that is no lamp's, where it is another than told."""
        if number.name != VERGENCE or number.seen is None or number.verdict not in ("found", "in doubt"):
            return ""
        if number.seen < 0:
            return "a picture that is too small, or light that converges"
        return "a picture that is too large" if self.is_picture and number.seen > 0 else ""


def in_brackets(remark: str) -> str:
    """After a space; nothing for an empty one."""
    return f" ({remark})" if remark else ""


def is_picture_smaller(record: Mapping[str, Any]) -> bool:
    """Whether heights are those of a picture that is too small, by :attr:`FoundBench.record`."""
    return any(number["name"] == VERGENCE and number["found"] < 0 for number in record["numbers"])


def is_picture_larger(record: Mapping[str, Any]) -> bool:
    """Whether heights are those of a picture that is too large, by :attr:`FoundBench.record`."""
    larger = any(number["name"] == VERGENCE and number["found"] > 0 for number in record["numbers"])
    return bool(record["is_kept"] and record["is_picture"]) and larger
