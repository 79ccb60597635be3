"""What a search for the bench came to, and the result it makes."""

import dataclasses

from warp_caustics.found_bench.bench_record import FoundBench
from warp_caustics.reconstruct.base import Reconstruction


@dataclasses.dataclass(frozen=True, eq=False)
class TriedBench:
    """What one search came to.

    Attributes:
        told: heights on the bench that was told.
        kept: the better of those and of what was found.
        record: number by number.
        used: values of the found bench, by name.
        left: of the image there; infinite where no heights were found.
        timings_s: of the search.
    """

    told: Reconstruction
    kept: Reconstruction
    record: FoundBench
    used: dict[str, float]
    left: float
    timings_s: dict[str, float]

    @property
    def is_kept(self) -> bool:
        """Whether heights are those of the found bench."""
        return self.record.is_kept

    def or_better(self, other: "TriedBench") -> "TriedBench":
        """What leaves less of the image, this or a later search, with the time of both; an interruption ends both."""
        better = other if other.is_kept and other.left < self.left else self
        kept = better.kept
        if other.kept.stop_reason == "interrupted":
            kept = dataclasses.replace(kept, stop_reason="interrupted")
        names = {**self.timings_s, **other.timings_s}
        both = {name: self.timings_s.get(name, 0.0) + other.timings_s.get(name, 0.0) for name in names}
        return dataclasses.replace(better, kept=kept, timings_s=both)

    def recorded(self) -> Reconstruction:
        """The result, with the record of the bench."""
        return dataclasses.replace(
            self.kept,
            timings_s=self.told.timings_s | self.timings_s,
            counters=self.kept.counters | {"bench": self.record.record},
            warnings=(*self.kept.warnings, *self.record.warnings()),
        )
