"""A result that says whether its heights may be wrong by much more than it states."""

import dataclasses

import numpy as np

from warp_caustics.found_bench.doubt import doubt_of
from warp_caustics.reconstruct.base import Reconstruction


def with_doubt(found: Reconstruction) -> Reconstruction:
    """The result with ``counters["doubt"]`` and its warnings; as it is where the rest of its image was not asked.

    Last of all, when causes and the bench have their parts in the uncertainty.

    Args:
        found: with ``counters["rest"]``.
    """
    if "rest" not in found.counters:
        return found
    stated = found.uncertainty_m
    stated_um = None if stated is None else 1e6 * float(np.sqrt(np.mean(np.square(stated, dtype=np.float64))))
    doubt = doubt_of(found.counters, stated_um)
    return dataclasses.replace(
        found,
        counters=found.counters | {"doubt": doubt.record},
        warnings=(*found.warnings, *doubt.warnings()),
    )
