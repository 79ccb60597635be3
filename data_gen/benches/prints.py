"""Which kind of prints a sample is of, and how it is printed, as numbers for its record."""

import bisect
import itertools
from collections.abc import Sequence

import numpy as np

from data_gen.benches.columns import PRINT_NAMES
from data_gen.dataset_config import DatasetConfig, sample_generator
from data_gen.reliefs import made_print
from data_gen.variety import PrintTraits, draw_traits, plain_traits
from warp_caustics.prints.paths import MAX
from warp_caustics.prints.sections import KINDS
from warp_caustics.types import FloatArray


class PrintKinds:
    """Kinds of prints of a data set.

    Attributes:
        datasets: the data set once for each kind, with its reliefs.
        fingerprint: of the data set.
    """

    def __init__(self, dataset: DatasetConfig, fingerprint: str):
        prints = dataset.bench.prints if dataset.bench is not None else None
        self.fingerprint = fingerprint
        self.datasets = (
            (dataset,)
            if prints is None
            else tuple(dataset.model_copy(update={"reliefs": kind.reliefs}) for kind in prints)
        )
        self._bounds = list(itertools.accumulate(kind.share for kind in prints or ())) or [1.0]

    def number(self, sample: int) -> int:
        """Of a sample's kind."""
        if len(self.datasets) == 1:
            return 0
        unit = float(sample_generator(self.fingerprint, "print kind", sample).random())
        return min(bisect.bisect_right(self._bounds, unit * self._bounds[-1]), len(self._bounds) - 1)

    def columns(self, samples: Sequence[int]) -> dict[str, FloatArray]:
        """How samples are printed, columns of shape [B]."""
        rows = [self._record(sample) for sample in samples]
        return {name: np.array([row[name] for row in rows], dtype=np.float64) for name in PRINT_NAMES}

    def _record(self, sample: int) -> dict[str, float]:
        number = self.number(sample)
        own = self.datasets[number]
        made = made_print(own, self.fingerprint, sample)
        traits = _traits(own, self.fingerprint, sample) if made is None else made.traits
        record = dict.fromkeys(PRINT_NAMES, 0.0)
        record |= {
            "print_kind": float(number),
            "print_section": float(KINDS.index(traits.section)),
            "print_exponent": traits.exponent,
            "print_reach": traits.reach,
            "print_contact_angle_rad": traits.contact_angle_rad,
            "print_merging": 0.0 if traits.merging == MAX else traits.merging,
            "print_base_wave_m": traits.wave[0],
        }
        record |= dict(zip(("print_bow_xx", "print_bow_xy", "print_bow_yy"), traits.bow, strict=True))
        return record if made is None else record | made.record()


def _traits(dataset: DatasetConfig, fingerprint: str, sample: int) -> PrintTraits:
    plain, variety = plain_traits(dataset.reliefs.profile), dataset.reliefs.variety
    if variety is None:
        return plain
    return draw_traits(variety, plain, dataset.scene.plate_size_m, sample_generator(fingerprint, "traits", sample))
