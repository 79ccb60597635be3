"""Landweber iteration on the caustic: data term, step size and the updates of SfC's three variants.

Kassubeck et al., Shape from Caustics, WACV 2021; the problem stands in the package. All steps and thresholds are
relative to the problem at hand, so they hold for any units of length and light.
"""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import torch

from warp_caustics.data_gradient import image_adjoint
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.sfc.shrinkage import soft_shrink
from warp_caustics.reconstruct.sfc.wavelets import WaveletBasis
from warp_caustics.reconstruct.volume import VolumeBand
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

SfcDataTerm = Literal["l2", "l1"]

PROBE_M = 1e-7
"""Largest height change of the finite difference behind the step [m]: far below any fold, far above rounding."""

POWER_ITERATIONS = 12
"""Enough for a few per cent of the largest eigenvalue."""


def curvature(simulator: CausticSimulator, measurement: Measurement, heights: FloatArray) -> float:
    """L: largest eigenvalue of the Gauss-Newton Hessian J^T W J of the l2 data term [1/m^2].

    Power iteration v <- J^T W J v, normalised; J v by central differences of the image, J^T by the exact adjoint.
    Gradient descent on the linearised problem converges for steps below 2 / L.

    Args:
        simulator: the model, in units of the radiosity.
        measurement: which pixels count.
        heights: where to linearise [m], shape [n, n].
    """
    where = torch.tensor(heights, dtype=torch.float32, device=simulator.device)
    direction = torch.from_numpy(np.random.default_rng(0).standard_normal(heights.shape)).to(where)
    weight = measurement.weight / measurement.weight.sum()
    largest = 0.0
    for _ in range(POWER_ITERATIONS):
        direction = direction / direction.norm()
        probe = PROBE_M / float(direction.abs().max())
        with torch.no_grad():
            forward = (simulator(where + probe * direction) - simulator(where - probe * direction)) / (2 * probe)
        direction = image_adjoint(simulator, where, weight * forward)
        largest = float(direction.double().norm())
        if largest == 0:
            break
    return largest


class Update(Protocol):
    """One iteration: heights [m] and their gradient [1/m], both [n, n], and the step tau [m^2], to new heights."""

    def __call__(self, heights: FloatArray, gradient: FloatArray, step: float) -> FloatArray: ...


@dataclass(frozen=True)
class PlainUpdate:
    """``baseline``: h - tau g, only kept from cutting through the plate and from leaving it by more than it can.

    Attributes:
        lowest_m: heights are kept above [m]; the simulator knows no hole.
        highest_m: and below [m]: a diverging descent must not end in infinities.
    """

    lowest_m: float
    highest_m: float

    def __call__(self, heights: FloatArray, gradient: FloatArray, step: float) -> FloatArray:
        return np.clip(heights - step * gradient, self.lowest_m, self.highest_m)


@dataclass(frozen=True)
class PixelUpdate:
    """``landweber_pixel``: gradient step, soft shrinkage between bounds, mask, volume heuristic.

    Attributes:
        threshold: alpha, weight of the l1 prior [1/m]: every iteration shrinks the heights by tau alpha.
        lowest_m: a [m].
        highest_m: b [m].
        mask: 1 where glass may be, else 0, shape [n, n].
        band: keeps the printed volume; None if it is unknown.
        sample_pitch_m: distance of samples along x and y [m].
    """

    threshold: float
    lowest_m: float
    highest_m: float
    mask: FloatArray
    band: VolumeBand | None
    sample_pitch_m: tuple[float, float]

    def __call__(self, heights: FloatArray, gradient: FloatArray, step: float) -> FloatArray:
        return self.constrained(heights - step * gradient, step)

    def constrained(self, heights: FloatArray, step: float) -> FloatArray:
        """Everything but the gradient step. The volume may lift heights over b a little, as published."""
        result: FloatArray = self.mask * soft_shrink(heights, step * self.threshold, self.lowest_m, self.highest_m)
        if self.band is not None:
            result = self.band.apply(result, self.mask, self.sample_pitch_m)
        return result


@dataclass(frozen=True)
class WaveletUpdate:
    """``landweber_wavelet``: gradient step and shrinkage on wavelet coefficients, then the pixels' constraints.

    Attributes:
        basis: the wavelets.
        threshold: alpha_w, weight of the l1 prior on coefficients [1/m].
        pixels: what follows on the heights.
    """

    basis: WaveletBasis
    threshold: float
    pixels: PixelUpdate

    def __call__(self, heights: FloatArray, gradient: FloatArray, step: float) -> FloatArray:
        # Coefficients are of finite norm as the heights are: the published bounds of +-1e4 never act.
        coefficients = self.basis.analyse(heights) - step * self.basis.adjoint(gradient)
        shrunk = soft_shrink(coefficients, step * self.threshold)
        return self.pixels.constrained(self.basis.synthesise(shrunk), step)
