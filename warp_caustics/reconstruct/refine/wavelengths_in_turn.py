"""The objective of ``refine``, a third of it at a time: each evaluation looks at one wavelength.

All wavelengths show the same relief, a little shifted: glass bends blue 2 % more
than red. So one of them tells nearly the way that all tell together, at a third
of the time, and the next step hears the next one. Where launches take the time
and not photons, on a GPU, nothing is saved.
"""

from collections.abc import Mapping

import torch

from warp_caustics.reconstruct.objective import EvaluationTensors, Measurement
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.refine.relief_objective import ReliefObjective
from warp_caustics.simulator import CausticSimulator


def single_wavelengths(simulator: CausticSimulator) -> dict[int, CausticSimulator]:
    """Simulators of each wavelength that shines alone, with the photons of a lattice simulator."""
    scene = simulator.scene
    alone = {
        wavelength: scene.model_copy(update={"wavelengths_m": (length,), "radiosity_W_m2": (shines,)})
        for wavelength, (length, shines) in enumerate(zip(scene.wavelengths_m, scene.radiosity_W_m2, strict=True))
        if shines > 0
    }
    return {
        wavelength: CausticSimulator(single, "lattice", n_photons=simulator.n_photons, device=simulator.device)
        for wavelength, single in alone.items()
    }


class WavelengthsInTurn:
    """Takes the place of a :class:`ReliefObjective`; the first evaluation is of all wavelengths.

    Gradients are those of one wavelength's own mean. Values are means over what was last seen of
    each wavelength, so they lag behind a little.

    Args:
        simulators: of single wavelengths, see :func:`single_wavelengths`.
        measurement: what was seen, of all wavelengths; one without pixels that count is never looked at.
        options: weights.
        blur: of the camera, see :class:`ReliefObjective`.
    """

    def __init__(
        self,
        simulators: Mapping[int, CausticSimulator],
        measurement: Measurement,
        options: RefineOptions,
        blur: torch.Tensor | None = None,
    ):
        self.measurement, self.blur = measurement, blur
        seen = [wavelength for wavelength in simulators if bool(measurement.weight[wavelength].any())]
        self.objectives = [
            ReliefObjective(
                simulators[wavelength],
                _only(measurement, wavelength),
                options,
                None if blur is None else blur[wavelength : wavelength + 1],
            )
            for wavelength in seen or simulators
        ]
        self.latest: torch.Tensor | None = None
        self.turn = 0

    def __call__(self, heights: torch.Tensor) -> EvaluationTensors:
        """At a relief above the base [m], shape [n, n], float64, on the device."""
        if self.latest is None:
            every = [objective(heights) for objective in self.objectives]
            self.latest = torch.stack([values for values, _ in every])
            gradient = torch.stack([gradient for _, gradient in every]).mean(0)
        else:
            self.latest[self.turn], gradient = self.objectives[self.turn](heights)
            self.turn = (self.turn + 1) % len(self.objectives)
        objective, residual, noise = self.latest.unbind(1)
        mean_square = [values.square().mean().sqrt() for values in (residual, noise)]
        return EvaluationTensors(torch.stack((objective.mean(), *mean_square)), gradient)


def _only(measurement: Measurement, wavelength: int) -> Measurement:
    chosen = slice(wavelength, wavelength + 1)
    noise = None if measurement.noise is None else measurement.noise[chosen]
    return Measurement(measurement.irradiance[chosen], measurement.weight[chosen], noise)
