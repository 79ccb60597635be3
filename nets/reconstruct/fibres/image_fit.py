"""Lines fitted to the image: L-BFGS on the exact model, in a metric in which all lines count alike.

Two hundred numbers instead of sixteen thousand heights: noise has nowhere to
go, and what one photon path says of a line holds for all of the line.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import measurement_at, simulator_at
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

RIDGE_REGULARISATION = 1e-2
"""Added to the normal matrix of the heights, relative to its diagonal: keeps lines on top of each other apart."""
STEP_M = 1e-6
"""Height change that counts as one [m, RMS over the plate]."""
BORDER_PIXELS = 1
"""Ring of pixels that does not count: what happens at the edge of a plate is not in the model."""
CONVERGED = 1e-5
"""Of the loss, see ``ftol`` of L-BFGS-B."""


@dataclass
class Fitted:
    """Lines and how well they explain the image.

    Attributes:
        lines: shape [L, 6] [m].
        loss: mean Charbonnier misfit, in units of the radiosity.
    """

    lines: torch.Tensor
    loss: float


class ImageFit:
    """The misfit of lines to an image.

    Args:
        scene: the set-up.
        image: what was measured.
        model: renders lines.
        pixels: size of the image to compare at; divides that of the scene.
        width: residual, relative to the radiosity, from which on the misfit grows linearly.
        photons_per_pixel: of the simulation.
        report: called after each evaluation with its loss; may raise.
    """

    def __init__(
        self,
        scene: Scene,
        image: CausticImage,
        model: LineModel,
        pixels: int,
        width: float = 0.05,
        photons_per_pixel: int = 16,
        report: Callable[[float], None] | None = None,
    ):
        self.model, self.width, self.report = model, width, report
        self.simulator = simulator_at(scene, pixels, model.device, photons_per_pixel)
        self.measurement = measurement_at(image, scene, pixels, self.simulator.device, BORDER_PIXELS)

    def loss(self, heights_m: torch.Tensor) -> float:
        """Misfit of a relief [m], shape [n, n]."""
        with torch.no_grad():
            image = self.simulator(heights_m.contiguous())
            return float(self.measurement.data_term(image, "charbonnier", self.width))

    def with_gradient(self, heights_m: torch.Tensor) -> tuple[float, torch.Tensor]:
        """Misfit of a relief [m], and its gradient [1/m], shape [n, n]."""
        leaf = heights_m.detach().contiguous().requires_grad_()
        loss = self.measurement.data_term(self.simulator(leaf), "charbonnier", self.width)
        (gradient,) = torch.autograd.grad(loss, leaf)
        return float(loss.detach()), gradient

    def descend(self, lines: torch.Tensor, iterations: int) -> Fitted:
        """Lines that explain the image better; never worse.

        Args:
            lines: where to start, shape [L, 6] [m], float64.
            iterations: of L-BFGS, at most.
        """
        if not len(lines):
            return Fitted(lines, self.loss(self.model.heights(lines)))
        to_lines, back = self._metric(lines)
        best = Fitted(lines, np.inf)

        def objective(u: FloatArray) -> tuple[float, FloatArray]:
            moved = self.model.clamped(to_lines(u))
            heights, jacobian = self.model.with_jacobian(moved)
            loss, gradient = self.with_gradient(heights)
            if loss < best.loss:
                best.lines, best.loss = moved, loss
            if self.report is not None:
                self.report(loss)
            by_line = (jacobian.flatten(1) @ gradient.reshape(-1)).double().cpu().numpy()
            # L-BFGS-B's tolerances are absolute, and its first step has length one.
            return 1e3 * loss, 1e3 * back(by_line)

        settings = {"maxiter": iterations, "maxfun": int(1.3 * iterations) + 2, "maxcor": 30, "ftol": CONVERGED}
        scipy.optimize.minimize(objective, np.zeros(lines.numel()), jac=True, method="L-BFGS-B", options=settings)
        return best

    def _metric(
        self, lines: torch.Tensor
    ) -> tuple[Callable[[FloatArray], torch.Tensor], Callable[[FloatArray], FloatArray]]:
        """Coordinates in which a unit step changes the heights by STEP_M; and how gradients follow."""
        jacobian = self.model.with_jacobian(lines)[1].flatten(1)
        normal = (jacobian @ jacobian.T).double().cpu().numpy() / jacobian.shape[1]
        scale = np.sqrt(np.diag(normal)) + 1e-6
        factor = np.linalg.cholesky(normal / np.outer(scale, scale) + RIDGE_REGULARISATION * np.eye(len(scale)))
        start = lines.numpy().ravel()

        def to_lines(u: FloatArray) -> torch.Tensor:
            return torch.from_numpy((start + STEP_M * np.linalg.solve(factor.T, u) / scale).reshape(lines.shape))

        def back(gradient: FloatArray) -> FloatArray:
            pulled: FloatArray = STEP_M * np.linalg.solve(factor, gradient / scale)
            return pulled

        return to_lines, back
