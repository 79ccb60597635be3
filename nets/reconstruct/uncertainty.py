"""How wrong are the heights, point by point? As wrong as a network disagrees with itself over symmetries, scaled.

What all answers share, no spread can show: the scale is measured, on fields
with known heights, for the eight symmetries of the square.
"""

import math
from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Calibration:
    """Measured relation of spread and error.

    Attributes:
        scale: standard uncertainty = scale * standard deviation over the symmetries.
        within_one, within_two: share of points whose error is within one and two standard uncertainties.
        fields: number of fields it was measured on.
        seed: of these fields (``DatasetConfig(kind="updater", role="data")``, Tab. 3, each seen four times: as
            simulated, blurred by 1 px, with red and blue 0.3 px apart from green, and through a camera that does some
            of everything).
    """

    scale: float
    within_one: float
    within_two: float
    fields: int
    seed: int
    floor_m: float = 0.0
    """Added in quadrature everywhere [m, on the network's own plate]: what all answers have in common."""
    shared: float = 0.0
    """Of the relief around, times the share of the image's contrast that is left: what all get wrong together."""


SHARED = 0.12
"""What all symmetries get wrong together, fitted with what the bench leaves uncertain (docs/trust.md)."""

DIRECT_CALIBRATION = Calibration(
    scale=1.147, within_one=0.711, within_two=0.906, fields=60, seed=777_001, shared=SHARED
)
"""Of the shipped direct network with eight symmetries and the refinement of ``refinement.py`` on a GPU
(``benchmarks.robustness --own 777001 --fields 60 --device cuda``); 68 to 74 % lie within one in each of the cases. A
factor of 1.059 would cover 68.3 % of these plates, but less than 60 % of those with other sections or displaced as a
whole, so that of the weights before stays."""

FAMILY_CALIBRATION = Calibration(
    scale=1.0, within_one=0.75, within_two=0.84, fields=10, seed=51, floor_m=1.5e-6, shared=SHARED
)
"""Of the shipped network that is told of its bench, with the refinement of a CPU, on benches of its family that are
told nearly (``benchmarks.family --told nearly``, with that as its ``SEED``). Where there is relief, 68 and 89 % of the
points lie within one and two, on the same plates that gave the factor; bare plate is covered but for bows, of up to
30 um there, which no image tells."""


BARE_M = 0.1e-6
"""What all answers have in common on bare plate [m]: they lie 0.05 um apart there, and are moved as a whole by as much
to half a micrometre, which no image tells. Thirteen plates of prints of all kinds, four million photons (seed 777003):
53 and 73 % of the bare points lie within one and two without it, 66 and 89 % with it. Less than what is believed of a
base of which nobody says how flat it is, so that it counts only where a bench is told exactly."""


def uncertainty(
    answers: torch.Tensor,
    calibration: Calibration,
    scale: float = 1.0,
    flatness_m: float = 0.0,
    left: torch.Tensor | None = None,
) -> torch.Tensor | None:
    """Standard uncertainty of the mean answer [m], shape [n, n]; None for a single answer.

    Args:
        answers: heights found in each symmetry, turned back, shape [B, n, n] [m].
        calibration: of the network.
        scale: of the network's plate over the user's.
        flatness_m: standard deviation of the base from a plane [m].
        left: relief around each sample times the share of the image's contrast that is left [m], shape [n, n]
            (:mod:`warp_caustics.reconstruct.rest`); None where that is not known.
    """
    if len(answers) < 2:
        return None
    spread = calibration.scale * answers.std(dim=0)
    if left is not None and calibration.shared:
        spread = spread.square().add((calibration.shared * left).square()).sqrt()
    everywhere = math.hypot(calibration.floor_m / scale, flatness_m)
    return spread.square().add(everywhere**2).sqrt() if everywhere else spread
