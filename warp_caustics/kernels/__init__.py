"""Warp kernels, one stage per file: photons -> surface -> trace -> splat.

``fused`` and ``fused_adjoint`` do surface, refraction and splat of a photon at
once: by ``collimated`` for light from straight above, by ``general`` for other
light. The separate stages serve tapes. Both meet in ``pixels``, which knows how
a footprint is spread over pixels. ``rows`` does the same for lattices on a CPU,
sixteen photons at a time, in snippets that repeat those formulas for vectors;
``blocks`` refracts scattered photons so, and ``gaussian_pixels`` spreads them.
``lattice_surface`` and ``surface_adjoint`` lead from photons back to the
relief's coefficients on a GPU, the latter everywhere for scattered photons.
Where a GPU's results are to repeat, sums are in ``fixed_point``.

Kernels know nothing of torch. Each file has a memoised factory, because Warp
never promotes float32 to float64: ``trace_kernels(wp.float64)`` is the same
source specialised once more. Outputs come last in every signature.

Kernels differentiated by Warp (surface, trace) have bodies without loops that
carry values; the splat loops do carry values, so their adjoint is written by
hand and Warp's is switched off.
"""

from typing import Any

import warp as wp

# Banners would disturb --json output and tests; problems still come through as warnings.
wp.config.log_level = wp.LOG_WARNING

MAP_NAMES = ("h", "h_x", "h_y", "h_xx", "h_xy", "h_yy")
"""Planes of the surface maps: height [m], slopes [1], second derivatives [1/m]."""

RECORD_NAMES = ("column", "row", "var_column", "cov", "var_row", "amplitude")
"""Planes of the footprint records: centre [px], covariance [px^2], irradiance x pixels [W/m^2]."""


def specialised(struct: type, *key: Any) -> Any:
    """Warp struct of a class whose annotations depend on the key: a name of its own keeps C++ types apart."""
    words = [getattr(part, "__name__", str(part)) for part in key]
    struct.__name__ = struct.__qualname__ = "_".join([struct.__name__, *words])
    return wp.struct(struct)


def dtype_of(bits: int) -> Any:
    """Warp scalar type of the given width in bits, 32 or 64."""
    return {32: wp.float32, 64: wp.float64}[bits]
