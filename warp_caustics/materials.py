"""Refractive index of glasses and exit media.

Sellmeier's equation, n^2 - 1 = sum_i B_i lambda^2 / (lambda^2 - C_i) with lambda
in micrometres. Coefficients, with their sources:

- ``fused_silica``: I. H. Malitson, J. Opt. Soc. Am. 55, 1205 (1965), 20 C.
- ``n_bk7``: Schott optical glass data sheet N-BK7, 22 C.
- ``soda_lime``: M. Rubin, Solar Energy Materials 12, 275 (1985), clear float
  glass; not a Sellmeier fit but n = 1.5130 - 0.003169 lambda^2 + 0.003962 / lambda^2.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache

from warp_caustics.errors import InputError

_SELLMEIER_B_C_UM2: dict[str, tuple[tuple[float, float], ...]] = {
    "fused_silica": (
        (0.6961663, 0.0684043**2),
        (0.4079426, 0.1162414**2),
        (0.8974794, 9.896161**2),
    ),
    "n_bk7": (
        (1.03961212, 0.00600069867),
        (0.231792344, 0.0200179144),
        (1.01046945, 103.560653),
    ),
}


def _sellmeier(terms: Sequence[tuple[float, float]]) -> Callable[[float], float]:
    def index(wavelength_um: float) -> float:
        squared = wavelength_um**2
        return math.sqrt(1.0 + sum(b * squared / (squared - c) for b, c in terms))

    return index


def _soda_lime(wavelength_um: float) -> float:
    return 1.5130 - 0.003169 * wavelength_um**2 + 0.003962 / wavelength_um**2


_GLASSES: dict[str, Callable[[float], float]] = {
    **{name: _sellmeier(terms) for name, terms in _SELLMEIER_B_C_UM2.items()},
    "soda_lime": _soda_lime,
}

GLASS_NAMES: tuple[str, ...] = tuple(_GLASSES)

MIN_WAVELENGTH_M, MAX_WAVELENGTH_M = 200e-9, 2.5e-6
"""Range [m] in which the dispersion formulas hold."""


REFERENCE_WAVELENGTH_M = 587.56e-9
"""The helium d line [m], where catalogues give a glass's index: a melt's two numbers are its offset there and its
dispersion."""


def melt_index(glass: str | float, wavelength_m: float, offset: float = 0.0, dispersion_scale: float = 1.0) -> float:
    """Refractive index of one melt of a glass, n_d + offset + scale (n - n_d) with n and n_d of the catalogue.

    Args:
        glass: as for :func:`refractive_index`; a constant index has no dispersion to scale.
        wavelength_m: vacuum wavelength [m].
        offset: of the index at the d line, :data:`REFERENCE_WAVELENGTH_M`.
        dispersion_scale: dispersion over that of the catalogue.

    Raises:
        InputError: as :func:`refractive_index`.
    """
    index = refractive_index(glass, wavelength_m)
    if offset == 0 and dispersion_scale == 1:
        return index
    return index + offset + (dispersion_scale - 1) * (index - refractive_index(glass, REFERENCE_WAVELENGTH_M))


@lru_cache(maxsize=1024)
def refractive_index(glass: str | float, wavelength_m: float) -> float:
    """Refractive index of a medium.

    Args:
        glass: a name of :data:`GLASS_NAMES`, ``"air"`` or ``"vacuum"`` (both 1),
            or a number used at every wavelength.
        wavelength_m: vacuum wavelength [m].

    Raises:
        InputError: unknown name, or a wavelength outside the formulas' range.
    """
    if isinstance(glass, int | float):
        return float(glass)
    if glass in ("air", "vacuum"):
        return 1.0
    if glass not in _GLASSES:
        raise InputError(
            f"glass {glass!r} is not known; use one of {', '.join(GLASS_NAMES)} or a constant index such as 1.46"
        )
    if not MIN_WAVELENGTH_M <= wavelength_m <= MAX_WAVELENGTH_M:
        raise InputError(
            f"wavelength {wavelength_m:g} m is outside {MIN_WAVELENGTH_M:g} to {MAX_WAVELENGTH_M:g} m, "
            f"the range of the dispersion formula of {glass}; give metres (530 nm is 530e-9)"
        )
    return _GLASSES[glass](wavelength_m * 1e6)


_DENSITIES_KG_M3: dict[str, float] = {"fused_silica": 2200.0, "n_bk7": 2510.0, "soda_lime": 2500.0}
"""Fused silica and N-BK7 from their data sheets, rounded; float glass varies by 1 %."""


def density(glass: str | float) -> float | None:
    """Density of a glass [kg/m^3]; None where only its index is known."""
    return _DENSITIES_KG_M3.get(glass) if isinstance(glass, str) else None
