"""Lines fitted to the image: L-BFGS on the exact model, in coordinates in which the image changes alike.

Two hundred numbers instead of sixteen thousand heights: noise has nowhere to
go, and what one photon path says of a line holds for all of the line.

Descent is preconditioned by Gauss-Newton's matrix (Nocedal & Wright, Numerical Optimization, sections 7.2, 10.3): the
image's derivatives by all numbers, by differences of simulations with few pixels and photons, one batch for all lines.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.prints.model import LineModel
from warp_caustics.prints.sections import EXPONENTS
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import measurement_at, simulator_at
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

RIDGE_REGULARISATION = 1e-2
"""Added to the normal matrix, relative to its diagonal: keeps lines on top of each other apart."""
HEIGHT_SHARE = 1e-2
"""Weight of the heights in the metric, relative to the image: what the image does not show stays where it is."""
DIFFERENCE_M = 5e-6
"""Largest height by which reliefs of a difference differ [m]."""
BATCH_HEIGHTS = {"cpu": 1 << 18, "cuda": 1 << 22}
"""Heights simulated at a time, at most: on a CPU more would only take more memory, on a GPU launches count."""
BORDER_PIXELS = 1
"""Ring of pixels that does not count: what happens at the edge of a plate is not in the model."""
FINE_PHOTONS_PER_PIXEL = 8
"""With the four of a usual lattice, wrong lines explain an own field's image at 256 pixels better (0.0038) than the
true ones (0.0050): they fit the lattice. With eight, worse (0.0025 and 0.0020)."""
CONVERGED = 1e-5
"""Of the loss, see ``ftol`` of L-BFGS-B."""
LOSS_SCALE = 1e3
"""L-BFGS-B's tolerances are absolute, and its first step has length one."""


@dataclass
class Fitted:
    """Lines and how well they explain the image.

    Attributes:
        lines: shape [L, 6] [m].
        loss: mean Charbonnier misfit, in units of the radiosity.
    """

    lines: torch.Tensor
    loss: float


def clearest_wavelength(image: CausticImage, scene: Scene) -> int:
    """Number of the wavelength that shows most: most pixels that count, then the least noise, then the middle."""
    count = scene.n_wavelengths
    radiosity = np.asarray(scene.radiosity_W_m2, dtype=np.float64)
    noise = np.zeros(count) if image.noise_std is None else np.asarray(image.noise_std) / np.maximum(radiosity, 1e-30)

    def rank(channel: int) -> tuple[float, float, int]:
        seen = 1.0 if image.mask is None else float(np.mean(image.mask[channel]))
        return -round(seen, 2), round(float(noise[channel]), 4), abs(channel - count // 2)

    return min((channel for channel in range(count) if radiosity[channel] > 0), key=rank)


def of_wavelength(image: CausticImage, scene: Scene, channel: int) -> tuple[CausticImage, Scene]:
    """What one wavelength shows of an image, and the scene of it."""
    kept = [channel]
    one = CausticImage(
        np.asarray(image.irradiance)[kept],
        None if image.noise_std is None else np.asarray(image.noise_std)[kept],
        None if image.mask is None else np.asarray(image.mask)[kept],
    )
    update = {"wavelengths_m": (scene.wavelengths_m[channel],), "radiosity_W_m2": (scene.radiosity_W_m2[channel],)}
    return one, scene.model_copy(update=update)


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
        metric: simulates the differences of which the metric is made; this one if None.
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
        metric: "ImageFit | None" = None,
    ):
        self.model, self.width, self.report, self.metric = model, width, report, metric or self
        self.simulator = simulator_at(scene, pixels, model.device, photons_per_pixel)
        self.measurement = measurement_at(image, scene, pixels, self.simulator.device, BORDER_PIXELS)
        self._at_once = max(1, BATCH_HEIGHTS[model.device.type] // model.n**2)

    def loss(self, heights_m: torch.Tensor) -> float:
        """Misfit of a relief [m], shape [n, n]."""
        return self.losses(heights_m[None])[0]

    def losses(self, heights_m: torch.Tensor) -> list[float]:
        """Misfits of reliefs [m], shape [B, n, n]."""
        found = []
        with torch.no_grad():
            for some in heights_m.split(self._at_once):
                residual = (self.simulator(some.contiguous()) - self.measurement.irradiance).double()
                loss = ((residual.square() + self.width**2).sqrt() - self.width) * self.measurement.weight
                found.append(loss.flatten(1).sum(dim=1))
            values = torch.cat(found) / self.measurement.weight.sum(dtype=torch.float64)
        listed: list[float] = values.tolist()
        return listed

    def with_gradient(self, heights_m: torch.Tensor) -> tuple[float, torch.Tensor]:
        """Misfit of a relief [m], and its gradient [1/m], shape [n, n]."""
        leaf = heights_m.detach().contiguous().requires_grad_()
        loss = self.measurement.data_term(self.simulator(leaf), "charbonnier", self.width)
        (gradient,) = torch.autograd.grad(loss, leaf)
        return float(loss.detach()), gradient

    def normal_matrix(self, heights_m: torch.Tensor, derivatives: torch.Tensor) -> torch.Tensor:
        """Gauss-Newton's matrix J W J^T of the misfit [1/m^2], shape [P, P], float64, on the CPU.

        W is the Charbonnier weight 1 / sqrt(r^2 + width^2) of each pixel's residual r, J by differences of simulations.

        Args:
            heights_m: relief [m], shape [n, n].
            derivatives: of it by the numbers [1], shape [P, n, n].
        """
        step = DIFFERENCE_M / derivatives.flatten(1).abs().amax(dim=1).clamp_min(1e-6)
        with torch.no_grad():
            image = self.simulator(heights_m.contiguous())
            residual = image - self.measurement.irradiance
            weight = self.measurement.weight / (residual.square() + self.width**2).sqrt()
            weight = (weight / self.measurement.weight.sum()).flatten()
            rows = []
            for some, by in zip(derivatives.split(self._at_once), step.split(self._at_once), strict=True):
                moved = self.simulator((heights_m + by[:, None, None] * some).contiguous())
                rows.append(((moved - image) / by[:, None, None, None]).flatten(1))
            jacobian = torch.cat(rows)
            return ((jacobian * weight) @ jacobian.T).double().cpu()

    def descend(self, lines: torch.Tensor, iterations: int, *, with_section: bool = False) -> Fitted:
        """Lines that explain the image better; never worse.

        Args:
            lines: where to start, shape [L, 6] [m], float64.
            iterations: of L-BFGS, at most.
            with_section: the model's exponent is found with them, and left at its best.
        """
        if not len(lines):
            return Fitted(lines, self.loss(self.model.heights(lines)))
        model = self.model
        start = lines.numpy().ravel()
        if with_section:
            start = np.append(start, model.exponent)
        to_numbers, back = self._coordinates(lines, start)
        best, exponent = Fitted(lines, np.inf), model.exponent

        def objective(u: FloatArray) -> tuple[float, FloatArray]:
            nonlocal exponent
            numbers = to_numbers(u)
            moved = model.clamped(torch.from_numpy(numbers[: lines.numel()].reshape(lines.shape)))
            if with_section:
                model.exponent = float(np.clip(numbers[-1], *EXPONENTS))
            heights, jacobian = self._rendered(moved, with_section)
            loss, gradient = self.with_gradient(heights)
            if loss < best.loss:
                best.lines, best.loss, exponent = moved, loss, model.exponent
            if self.report is not None:
                self.report(loss)
            by_number = (jacobian.flatten(1) @ gradient.reshape(-1)).double().cpu().numpy()
            return LOSS_SCALE * loss, LOSS_SCALE * back(by_number)

        settings = {"maxiter": iterations, "maxfun": int(1.3 * iterations) + 2, "maxcor": 30, "ftol": CONVERGED}
        try:
            scipy.optimize.minimize(objective, np.zeros(len(start)), jac=True, method="L-BFGS-B", options=settings)
        finally:
            model.exponent = exponent
        return best

    def _rendered(self, lines: torch.Tensor, with_section: bool) -> tuple[torch.Tensor, torch.Tensor]:
        """Relief [m], shape [n, n], and its derivatives by all numbers of a descent, shape [P, n, n]."""
        heights, derivatives = self.model.with_jacobian(lines)
        if with_section:
            derivatives = torch.cat([derivatives, self.model.by_exponent(lines)[None]])
        return heights, derivatives

    def _coordinates(
        self, lines: torch.Tensor, start: FloatArray
    ) -> tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray], FloatArray]]:
        """Coordinates in which Gauss-Newton's matrix of the scaled loss is the unit; and how gradients follow."""
        heights, derivatives = self._rendered(lines, len(start) > lines.numel())
        seen = self.metric.normal_matrix(heights, derivatives).numpy()
        flat = derivatives.flatten(1)
        printed = (flat @ flat.T).double().cpu().numpy()
        # The exponent has another unit than lengths: it has its share of the image only.
        printed[lines.numel() :] = printed[:, lines.numel() :] = 0
        lengths = slice(0, lines.numel())
        share = max(np.trace(seen[lengths, lengths]), 1e-30) / max(np.trace(printed), 1e-30)
        seen += HEIGHT_SHARE * share * printed
        diagonal = np.diag(seen)
        scale = np.sqrt(LOSS_SCALE * (diagonal + 1e-9 * diagonal[lengths].max()))
        unit = LOSS_SCALE * seen / np.outer(scale, scale)
        factor = np.linalg.cholesky(unit + RIDGE_REGULARISATION * np.eye(len(scale)))

        def to_numbers(u: FloatArray) -> FloatArray:
            moved: FloatArray = start + np.linalg.solve(factor.T, u) / scale
            return moved

        def back(gradient: FloatArray) -> FloatArray:
            pulled: FloatArray = np.linalg.solve(factor, gradient / scale)
            return pulled

        return to_numbers, back
