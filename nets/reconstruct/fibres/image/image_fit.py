"""Lines fitted to the image: L-BFGS on the exact model, in coordinates in which the image changes alike.

Two hundred numbers instead of sixteen thousand heights: noise has nowhere to
go, and what one photon path says of a line holds for all of the line.

Descent is preconditioned by Gauss-Newton's matrix (Nocedal & Wright, Numerical Optimization, sections 7.2, 10.3): the
image's derivatives by all numbers, by differences of simulations with few pixels and photons, one batch for all lines.
"""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from nets.reconstruct.fibres.image.descent import LOSS_SCALE, Beside, Descent, Fitted, in_coordinates
from nets.reconstruct.fibres.image.descent_numbers import DescentNumbers
from warp_caustics.one_thread import one_thread
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import measurement_at, simulator_at
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.exact_picture import ExactPicture
from warp_caustics.recorded_gradient import RecordedGradient
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.scene import Scene
from warp_caustics.types import BoolArray, FloatArray

RIDGE_REGULARISATION = 1e-2
"""Added to the normal matrix, relative to its diagonal: keeps lines on top of each other apart."""
HEIGHT_SHARE = 1e-2
"""Weight of the heights in the metric, relative to the image: what the image does not show stays where it is."""
DIFFERENCE_M = 5e-6
"""Largest height by which reliefs of a difference differ [m]; to either side by half of it beside numbers of a bench,
which nearly make up for lines. Caustics are sharp: to one side, what is left to second order looked like information.
Lines 0.7 % higher on a bench of so much less gap are worth 3 squares of deviations by what they leave, and were 15 by
such differences. For the metric of lines alone they do, and take half the time."""
BATCH_HEIGHTS = {"cpu": 1 << 18, "cuda": 1 << 22}
"""Heights simulated at a time, at most: on a CPU more would only take more memory, on a GPU launches count."""
MEMORY_SHARE = 1 / 64
"""Of a GPU's memory, that images of reliefs simulated at a time may take; what is made of them takes several times as
much."""
BORDER_PIXELS = 1
"""Ring of pixels that does not count: what happens at the edge of a plate is not in the model."""
WIDTH = 0.05
"""Residual, relative to the radiosity, from which on a pixel counts less."""
FINE_PHOTONS_PER_PIXEL = 8
"""With the four of a usual lattice, wrong lines explain an own field's image at 256 pixels better (0.0038) than the
true ones (0.0050): they fit the lattice. With eight, worse (0.0025 and 0.0020)."""
FEW_PHOTONS_PER_PIXEL = 16
"""On the fewest pixels."""
EXTRAPOLATED = 4
"""Times as many photons tell what a lattice is off by."""
METRIC_PHOTONS_PER_PIXEL = 4
"""Of the differences that descents take their metric from, on the fewest pixels."""
DESCENTS = 3
"""One after the other, at most, each without the numbers that are held where it begins."""
CONVERGED = 1e-5
"""Of the loss, see ``ftol`` of L-BFGS-B."""


def reliefs_at_once(device: torch.device, samples: int, values: int) -> int:
    """How many reliefs are simulated together.

    Args:
        device: where.
        samples: along a side of each.
        values: of each one's image, in single precision.
    """
    most = BATCH_HEIGHTS[device.type] // samples**2
    if device.type == "cuda":
        memory = torch.cuda.get_device_properties(device).total_memory
        most = min(most, int(MEMORY_SHARE * memory / (4 * values)))
    return max(1, most)


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
        camera: whose blur is in the model; its channels lie together. None for a perfect one.
    """

    def __init__(
        self,
        scene: Scene,
        image: CausticImage,
        model: LineModel,
        pixels: int,
        width: float = WIDTH,
        photons_per_pixel: int = FEW_PHOTONS_PER_PIXEL,
        report: Callable[[float], None] | None = None,
        metric: "ImageFit | None" = None,
        camera: ChannelCamera | None = None,
    ):
        self.model, self.width, self.report, self.metric = model, width, report, metric or self
        self.simulator = simulator_at(scene, pixels, model.device, photons_per_pixel)
        self.measurement = measurement_at(image, scene, pixels, self.simulator.device, BORDER_PIXELS)
        self.camera = camera or ChannelCamera.perfect(scene.n_wavelengths, scene.image_pixels)
        self._blur = None
        if np.any(self.camera.blur):
            self._blur = blur_matrices(pixels, self.camera.blur_at(pixels), self.simulator.device)
        self.missing: torch.Tensor | None = None
        """Of the image, for its lattice and the camera's point spread; None where nobody asked."""
        self._at_once = reliefs_at_once(self.simulator.device, model.n, self.measurement.irradiance.numel())
        # Of what is here alone: a graph that knew this fit would stay as long as nobody looks for unused objects.
        measurement, blur = self.measurement, self._blur
        self._gradient = RecordedGradient(
            self.simulator,
            lambda seen, _heights: measurement.data_term(seen, "charbonnier", width),
            None if blur is None else lambda caustic: blurred(caustic, blur),
        )

    def correct_at(self, heights_m: torch.Tensor) -> None:
        """Compare from now on as a lattice without end would, and the camera itself, about a relief [m], shape [n, n].

        What the lattice makes a caustic too soft by changes little while lines move by micrometres, and is taken off
        what was measured. Eight photons a pixel leave 0.6 % of a flat plate's light of a sharp caustic, which lines of
        a section that is a little blunter explain on a bench whose gap is 24 um wider: 1.8 um off, and 0.4 without.
        """
        relief = heights_m.contiguous()
        with torch.no_grad():
            self.correct_by(ExactPicture(self.simulator, self.camera, EXTRAPOLATED)(relief) - self.seen(relief))

    def correct_by(self, missing: torch.Tensor | None) -> None:
        """The same by what is missing of the image, in units of the radiosity, shape [n_w, m, m]; None for nothing."""
        if missing is None:
            return
        measured = self.measurement.irradiance
        if self.missing is not None:
            measured.add_(self.missing)
        # In place: a graph that was recorded reads from here.
        measured.sub_(missing)
        self.missing = missing

    def seen(self, heights_m: torch.Tensor) -> torch.Tensor:
        """What the camera shows of a relief [m], shape [..., n, n], in units of the radiosity; differentiable."""
        caustic = self.simulator(heights_m.contiguous())
        return caustic if self._blur is None else blurred(caustic, self._blur)

    def loss(self, heights_m: torch.Tensor, *, at_exposure: bool = False) -> float:
        """Misfit of a relief [m], shape [n, n]; as bright as the image, channel by channel, if so wished."""
        if not at_exposure:
            return self.losses(heights_m[None])[0]
        measured, weight = self.measurement.irradiance, self.measurement.weight
        with torch.no_grad():
            seen = self.seen(heights_m)
            light = (
                (seen * weight).sum((1, 2), dtype=torch.float64),
                (measured * weight).sum((1, 2), dtype=torch.float64),
            )
            ratio = torch.where(light[0] > 0, light[1] / light[0], 1.0).float()
            return float(self.measurement.data_term(seen * ratio[:, None, None], "charbonnier", self.width))

    def losses(self, heights_m: torch.Tensor, about_m: torch.Tensor | None = None) -> list[float]:
        """Misfits of reliefs [m], shape [B, n, n]; a CPU takes less time for such as differ from one in places.

        Args:
            heights_m: the reliefs.
            about_m: that one [m], shape [n, n]; None if there is none.
        """
        found = []
        with torch.no_grad():
            for seen in self._seen_of_each(heights_m, about_m):
                loss = seen.sub_(self.measurement.irradiance).double()
                loss.square_().add_(self.width**2).sqrt_().sub_(self.width).mul_(self.measurement.weight)
                found.append(loss.flatten(1).sum(dim=1))
            values = torch.cat(found) / self.measurement.weight.sum(dtype=torch.float64)
        listed: list[float] = values.tolist()
        return listed

    def losses_with_each(self, lines: torch.Tensor, tried: torch.Tensor) -> list[float]:
        """Misfits of lines [m], shape [L, 6], with each of others besides: one, [K, 6], or several, [K, E, 6]."""
        return self.losses(self.model.with_each(lines, tried), self.model.heights(lines))

    def _seen_of_each(self, heights_m: torch.Tensor, about_m: torch.Tensor | None) -> Iterator[torch.Tensor]:
        """What the camera shows of reliefs [m], shape [B, n, n], some at a time, by what they differ from one in."""
        parts = heights_m.split(self._at_once)
        if about_m is None or len(heights_m) < 2 or not self.simulator.traces_changes:
            yield from map(self.seen, parts)
            return
        seen = self.seen(about_m)
        for some in parts:
            yield self._changed(about_m, some, seen).add_(seen)

    def _changed(self, first_m: torch.Tensor, others_m: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        """What the camera shows of reliefs, shape [B, n, n], less what it does, and was seen, of one, shape [n, n]."""
        if not self.simulator.traces_changes:
            return self.seen(others_m).sub_(seen)
        caustic = self.simulator.change(first_m, others_m)
        return caustic if self._blur is None else blurred(caustic, self._blur)

    def with_gradient(
        self, heights_m: torch.Tensor, beside: Beside | None = None, amplitudes: FloatArray | None = None
    ) -> tuple[float, torch.Tensor, FloatArray]:
        """Misfit of a relief [m], its gradient [1/m], shape [n, n], and that by amplitudes of what is beside, [K]."""
        if (beside is None or amplitudes is None) and heights_m.is_cuda:
            found = self._gradient(heights_m)
            return float(found.value), found.gradient, np.zeros(0)
        leaf = heights_m.detach().contiguous().requires_grad_()
        if beside is None or amplitudes is None:
            loss = self.measurement.data_term(self.seen(leaf), "charbonnier", self.width)
            (gradient,) = torch.autograd.grad(loss, leaf)
            return float(loss.detach()), gradient, np.zeros(0)
        b = torch.tensor(amplitudes, dtype=torch.float32, device=leaf.device, requires_grad=True)
        image = self.seen(leaf) + torch.tensordot(b, beside.at(self.measurement.irradiance.shape[-1]), 1)
        loss = self.measurement.data_term(image, "charbonnier", self.width)
        gradient, by_b = torch.autograd.grad(loss, (leaf, b))
        apart = amplitudes - beside.before
        believed = beside.weight / 2 * float(apart @ apart)
        return float(loss.detach()) + believed, gradient, by_b.double().cpu().numpy() + beside.weight * apart

    def normal_matrix(
        self, heights_m: torch.Tensor, derivatives: torch.Tensor, beside: Beside | None = None
    ) -> torch.Tensor:
        """Gauss-Newton's matrix J W J^T of the misfit [1/m^2], shape [P + K, P + K], float64, on the CPU.

        W is the Charbonnier weight 1 / sqrt(r^2 + width^2) of each pixel's residual r, J by differences of simulations.

        Args:
            heights_m: relief [m], shape [n, n].
            derivatives: of it by the numbers [1], shape [P, n, n].
            beside: what else changes the image, K of them.
        """
        step = DIFFERENCE_M / derivatives.flatten(1).abs().amax(dim=1).clamp_min(1e-6)
        with torch.no_grad():
            image = self.seen(heights_m)
            residual = image - self.measurement.irradiance
            weight = self.measurement.weight / (residual.square() + self.width**2).sqrt()
            weight = (weight / self.measurement.weight.sum()).flatten()
            count = len(derivatives)
            jacobian = image.new_empty(count + (0 if beside is None else len(beside.modes)), image.numel())
            parts = [each.split(self._at_once) for each in (jacobian[:count], derivatives, step)]
            for rows, some, by in zip(*parts, strict=True):
                change = by[:, None, None] * some
                if beside is None:
                    moved = self._changed(heights_m, heights_m + change, image)
                else:
                    moved = self._changed(heights_m, heights_m + change / 2, image)
                    moved.sub_(self._changed(heights_m, heights_m - change / 2, image))
                torch.div(moved.flatten(1), by[:, None], out=rows)
            if beside is not None:
                jacobian[count:] = beside.at(image.shape[-1]).flatten(1)
            return ((jacobian * weight) @ jacobian.T).double().cpu()

    def descend(
        self, lines: torch.Tensor, iterations: int, *, with_section: bool = False, beside: Beside | None = None
    ) -> Fitted:
        """Lines that explain the image better; never worse.

        A number at the end of its range that would go on outwards is held there: beyond it nothing changes, and a
        search along a line that was promised a descent there finds none. Where one arrives there on the way the descent
        goes on without it.

        Args:
            lines: where to start, shape [L, 6] [m], float64.
            iterations: of L-BFGS, at most.
            with_section: the model's section is found with them, and left at its best.
            beside: what else may change the image; its amplitudes start from 0.
        """
        if not len(lines):
            return Fitted(
                lines, self.loss(self.model.heights(lines)), np.zeros(0 if beside is None else len(beside.modes))
            )
        descent = Descent(self, lines, with_section, beside)
        left, held = iterations, None
        try:
            for _ in range(DESCENTS):
                start, value, gradient = descent.at_best()
                held_now = descent.is_held(start, gradient)
                if left < 1 or held_now.all() or (held is not None and np.array_equal(held_now, held)):
                    break
                held = held_now
                to_numbers, back = self._coordinates(descent.best.lines, start, descent.numbers, beside, held)
                objective = partial(in_coordinates, descent, to_numbers, back, (value, gradient))
                settings = {"maxiter": left, "maxfun": int(1.3 * left) + 2, "maxcor": 30, "ftol": CONVERGED}
                here = np.zeros(int((~held).sum()))
                found = scipy.optimize.minimize(objective, here, jac=True, method="L-BFGS-B", options=settings)
                left -= found.nfev
        finally:
            self.model.shape = descent.shape
        return descent.best

    def _coordinates(
        self, lines: torch.Tensor, start: FloatArray, numbers: DescentNumbers, beside: Beside | None, held: BoolArray
    ) -> tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray], FloatArray]]:
        """Coordinates in which Gauss-Newton's matrix of the scaled loss is the unit; and how gradients follow.

        Of all numbers but those that are held.
        """
        heights, by_line = self.model.with_jacobian(lines)
        derivatives = numbers.derivatives(lines, by_line)
        seen = self.metric.normal_matrix(heights, derivatives, beside).numpy()
        flat = derivatives.flatten(1)
        printed = np.zeros_like(seen)
        printed[: len(flat), : len(flat)] = (flat @ flat.T).double().cpu().numpy()
        # The exponent and what is beside have other units than lengths: they have their share of the image only.
        printed[lines.numel() :] = printed[:, lines.numel() :] = 0
        lengths = slice(0, lines.numel())
        share = max(np.trace(seen[lengths, lengths]), 1e-30) / max(np.trace(printed), 1e-30)
        seen += HEIGHT_SHARE * share * printed
        if beside is not None:
            seen[len(flat) :, len(flat) :] += beside.weight * np.eye(len(beside.modes))
        diagonal = np.diag(seen)
        scale = np.sqrt(LOSS_SCALE * (diagonal + 1e-9 * diagonal[lengths].max()))
        free = ~held
        scale, seen = scale[free], seen[np.ix_(free, free)]
        unit = LOSS_SCALE * seen / np.outer(scale, scale)
        identity = torch.eye(len(scale), dtype=torch.float64)
        with one_thread():
            factor = torch.linalg.cholesky(torch.from_numpy(unit) + RIDGE_REGULARISATION * identity)
            inverse = torch.linalg.solve_triangular(factor, identity, upper=False).numpy()

        transposed = np.ascontiguousarray(inverse.T)

        # Products are summed by NumPy itself: a BLAS takes as many threads as a machine has cores for matrices from a
        # hundred numbers on, which took 16 cores 60 ms where one needs 20 us.
        def to_numbers(u: FloatArray) -> FloatArray:
            moved = start.copy()
            moved[free] += np.einsum("ij,j->i", transposed, u) / scale
            return moved

        def back(gradient: FloatArray) -> FloatArray:
            pulled: FloatArray = np.einsum("ij,j->i", inverse, gradient[free] / scale)
            return pulled

        return to_numbers, back
