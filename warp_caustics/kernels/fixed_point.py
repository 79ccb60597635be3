"""Sums that are the same in whatever order their terms come: in whole numbers, since floating additions round.

A term is counted in steps, to the nearest. The size of a step is a power of two, so that nothing but that is rounded,
and such that all terms together stay within 2^62 steps: see ``warp_caustics/optics.py`` for light, and
``surface_adjoint.py`` for gradients.
"""

from typing import Any, no_type_check

import warp as wp

from warp_caustics.kernels.made_once import made_once

MOST_STEPS = 2.0**62
"""Steps of all terms together, at most; half of what 64 bits hold, for what rounding adds."""


def sum_type(dtype: Any, is_fixed: bool) -> Any:
    """Type of the sums of terms of such a type."""
    return wp.int64 if is_fixed else dtype


@made_once
def counting_function(dtype: Any, is_fixed: bool) -> Any:
    """``counted``: a term, given in steps, as it is added to sums of :func:`sum_type`."""
    if is_fixed:

        @no_type_check
        @wp.func
        def counted(term: dtype):
            return wp.int64(wp.rint(term))

    else:

        @no_type_check
        @wp.func
        def counted(term: dtype):
            return term

    return counted
