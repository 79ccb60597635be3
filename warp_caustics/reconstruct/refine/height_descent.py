"""Adam on the heights, all of it on the device: simulate, compare, step.

A step is some eighty launches. On a GPU they are recorded once and replayed,
and the host reads what they found every few steps only, so that it is never
waited for. What decides (which relief is the best, whether only noise is left)
is therefore decided on the device.
"""

import math
from collections.abc import Callable

import numpy as np
import torch

from warp_caustics.cuda_graph import recorded
from warp_caustics.data_gradient import lowest_height_m
from warp_caustics.engine import MAX_GRAPH_PHOTONS
from warp_caustics.reconstruct.objective import Evaluation, Measurement
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.refine.relief_objective import ReliefObjective
from warp_caustics.reconstruct.refine.wavelengths_in_turn import WavelengthsInTurn, single_wavelengths
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

READ_EVERY = 10
"""Steps of a GPU between readings."""

UNRECORDED = 2
"""Steps before recording: the first loads kernels."""

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8


class HeightDescent:
    """Adam (Kingma and Ba 2015) with a step that falls to a twentieth along a cosine (Loshchilov and Hutter 2017).

    Args:
        simulator: in units of the radiosity, at the pixels that count.
        options: resolved; weights, number and size of steps.
        in_turn: whether each step looks at one wavelength only: a third of the time, where photons take it.
    """

    def __init__(self, simulator: CausticSimulator, options: RefineOptions, in_turn: bool = False):
        assert options.max_iterations is not None
        assert options.step_m is not None
        self.simulator, self.options = simulator, options
        self.steps, device, n = options.max_iterations, simulator.device, simulator.scene.height_samples
        self.lowest = lowest_height_m(simulator.scene)

        def zeros(*shape: int) -> torch.Tensor:
            return torch.zeros(shape, dtype=torch.float64, device=device)

        self.heights, self.best, self.mean, self.square = (zeros(n, n) for _ in range(4))
        self.best_objective = zeros()
        self.is_running = torch.ones((), dtype=torch.bool, device=device)
        self.number = torch.zeros(1, dtype=torch.int64, device=device)
        self.log = zeros(self.steps, 3)
        self.rates = torch.tensor(_rates(self.steps, options.step_m), dtype=torch.float64, device=device)
        self.single = single_wavelengths(simulator) if in_turn else {}
        self.objective: ReliefObjective | WavelengthsInTurn | None = None
        self.graph: torch.cuda.CUDAGraph | None = None
        is_small = simulator.n_photons <= MAX_GRAPH_PHOTONS
        self.is_recorded = device.type == "cuda" and is_small and not in_turn

    def run(
        self,
        measurement: Measurement,
        heights: FloatArray,
        note: Callable[[Evaluation], None],
        blur: torch.Tensor | None = None,
    ) -> None:
        """Descend; the result is :meth:`best_heights`, also after an interruption.

        Args:
            measurement: what was seen, in the simulator's units and pixels.
            heights: where to start [m], shape [n, n].
            note: called for each step in order, late by some on a GPU; may raise.
            blur: of the camera at these pixels, see :class:`ReliefObjective`.
        """
        self._start(measurement, heights, blur)
        every = READ_EVERY if self.simulator.device.type == "cuda" else 1
        read = 0
        for number in range(self.steps):
            self._advance(number)
            if (number + 1) % every == 0 or number + 1 == self.steps:
                for values in self.log[read : number + 1].tolist():
                    note(Evaluation.read(values))
                read = number + 1

    def best_heights(self) -> FloatArray:
        """The relief of the lowest objective so far, or the first that leaves only noise [m], shape [n, n]."""
        found: FloatArray = self.best.cpu().numpy().copy()
        return found

    def _start(self, measurement: Measurement, heights: FloatArray, blur: torch.Tensor | None) -> None:
        start = torch.as_tensor(np.asarray(heights, dtype=np.float64))
        for state in (self.heights, self.best):
            state.copy_(start)
        for state in (self.mean, self.square, self.number):
            state.zero_()
        self.best_objective.fill_(math.inf)
        self.is_running.fill_(True)
        if self.single:
            self.objective = WavelengthsInTurn(self.single, measurement, self.options, blur)
            return
        kept, kept_blur = (None, None) if self.objective is None else (self.objective.measurement, self.objective.blur)
        is_same = kept is not None and (kept.noise is None) == (measurement.noise is None)
        if kept is None or not is_same or (kept_blur is None) != (blur is None):
            # Its own: the next image is copied over it.
            own = Measurement(
                measurement.irradiance.clone(),
                measurement.weight.clone(),
                None if measurement.noise is None else measurement.noise.clone(),
            )
            own_blur = None if blur is None else blur.clone()
            self.objective, self.graph = ReliefObjective(self.simulator, own, self.options, own_blur), None
            return
        # A recorded step reads the tensors that it was recorded with.
        kept.irradiance.copy_(measurement.irradiance)
        kept.weight.copy_(measurement.weight)
        if kept.noise is not None and measurement.noise is not None:
            kept.noise.copy_(measurement.noise)
        if kept_blur is not None and blur is not None:
            kept_blur.copy_(blur)

    def _advance(self, number: int) -> None:
        if not self.is_recorded or (number < min(UNRECORDED, self.steps) and self.graph is None):
            self._step()
            return
        if self.graph is None:
            self.graph, _ = recorded(self._step)
        self.graph.replay()

    def _step(self) -> None:
        """One step, without a word to the host."""
        assert self.objective is not None
        values, gradient = self.objective(self.heights)
        objective, _, noise = values
        self.log.index_copy_(0, self.number, values[None])
        is_better = self.is_running & (objective < self.best_objective)
        only_noise = self.is_running & (noise <= self.options.discrepancy)
        self.best.copy_(torch.where(is_better | only_noise, self.heights, self.best))
        self.best_objective.copy_(torch.where(is_better, objective, self.best_objective))
        self.is_running.logical_and_(~only_noise)
        rate, first, second = self.rates.index_select(0, self.number)[0]
        self.mean.mul_(BETA_1).add_(gradient, alpha=1 - BETA_1)
        self.square.mul_(BETA_2).addcmul_(gradient, gradient, value=1 - BETA_2)
        change = rate * (self.mean / first) / ((self.square / second).sqrt() + EPSILON)
        self.heights.sub_(change).clamp_(min=self.lowest)
        self.number.add_(1)


def _rates(steps: int, step_m: float) -> list[tuple[float, float, float]]:
    """Step size [m] and both bias corrections of Adam, of each step."""
    least = step_m / 20
    return [
        (
            least + (step_m - least) * (1 + math.cos(math.pi * k / steps)) / 2,
            1 - BETA_1 ** (k + 1),
            1 - BETA_2 ** (k + 1),
        )
        for k in range(steps)
    ]
