"""Images of heights in a set-up, and their derivatives with respect to all that is free in it.

The camera is differentiated exactly, by forward mode. Kernels know the light's path as numbers, not as variables, so
plate, light and screen are differentiated by differences of simulations with the same photons, in double precision:
steps move light by a thousandth of a pixel, and what rounding leaves is a billionth. Products with the derivative by
heights are those of :class:`~warp_caustics.simulator.CausticSimulator`, whose adjoint is exact.

What differences cannot tell: the derivative by the lamp's size, and by the blur of the camera, at 0. Both enter by
their squares, so it is 0, and the image tells nothing of the first order (:attr:`Parameter.is_squared`); take a nominal
value above 0.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import torch

from warp_caustics.errors import InputError
from warp_caustics.setup.differences import Difference, difference
from warp_caustics.setup.optical import optical_steps
from warp_caustics.setup.parameter import chosen
from warp_caustics.setup.set_up import SetUp
from warp_caustics.simulator import CausticSimulator


class SetUpJacobian(NamedTuple):
    """Derivatives of an image by parameters of a set-up.

    Attributes:
        names: of the parameters, P of them.
        values: [W/m^2 per unit of the parameter], shape [P, C, H, W].
        disagreement: by how much two steps of a difference differ, relative to the derivative, shape [P]; 0 where the
            derivative is exact. Much above 1e-4 the image is not smooth there: a fold that moves through pixels
            without blur.
    """

    names: tuple[str, ...]
    values: torch.Tensor
    disagreement: torch.Tensor


class SetUpModel:
    """What a set-up shows of heights, in double precision.

    Args:
        setup: with its free parameters.
        device: where to simulate.
        simulation: further arguments of :class:`~warp_caustics.simulator.CausticSimulator`, such as ``preset`` and
            ``n_photons``.
    """

    def __init__(self, setup: SetUp, *, device: str | torch.device = "cpu", **simulation: Any):
        self.setup, self.device = setup, torch.device(device)
        self._simulation = simulation
        self._simulator = self._made(setup.nominal)

    def _made(self, theta: torch.Tensor) -> CausticSimulator:
        scene = self.setup.scene(theta)
        return CausticSimulator(scene, device=self.device, dtype=torch.float64, **self._simulation)

    def on_screen(self, heights: torch.Tensor, theta: torch.Tensor | None = None) -> torch.Tensor:
        """Irradiance [W/m^2], shape [..., n_w, m, m], of heights [m], shape [..., n, n]; theta [P], None is nominal."""
        simulator = self._simulator if theta is None else self._made(theta)
        with torch.no_grad():
            return simulator(self._heights(heights))

    def image(self, heights: torch.Tensor, theta: torch.Tensor | None = None) -> torch.Tensor:
        """What the camera shows without noise [W/m^2 behind a flat plate], shape [..., C, H, W].

        Args:
            heights: [m], shape [..., n, n].
            theta: shape [P]; None is nominal.
        """
        light = self.on_screen(heights, theta)
        operator = self.setup.operator(theta, (), device=self.device)
        if operator is None:
            return light
        with torch.no_grad():
            return operator(light, self.setup.camera(theta, device=self.device))

    def jacobian(
        self, heights: torch.Tensor, names: Iterable[str] | None = None, theta: torch.Tensor | None = None
    ) -> torch.Tensor:
        """Derivatives of :meth:`image` [W/m^2 per unit], shape [P, C, H, W]; see :meth:`derivatives`."""
        return self.derivatives(heights, names, theta).values

    def derivatives(
        self, heights: torch.Tensor, names: Iterable[str] | None = None, theta: torch.Tensor | None = None
    ) -> SetUpJacobian:
        """Derivatives of :meth:`image` by free parameters, with what is known of their error.

        Args:
            heights: [m], shape [n, n].
            names: of free parameters or groups; None takes all that are free.
            theta: where, shape [P]; None is nominal.

        Raises:
            InputError: a parameter that is not free, or heights of a wrong shape.
        """
        if heights.ndim != 2:
            raise InputError(f"heights have shape {list(heights.shape)}; derivatives are of one plate, [n, n]")
        wanted = self.setup.names if names is None else chosen(names, self.setup.parameters)
        at = self.setup.nominal if theta is None else self.setup.checked(theta)
        moved, seen = optical_steps(self.setup.scene(at)), None
        columns, disagreements = [], []
        for name in wanted:
            if name in moved:
                found = self._by_light(heights, at, name, moved[name])
            else:
                seen = self.on_screen(heights, at) if seen is None else seen
                found = Difference(self._by_camera(seen, at, name), 0.0)
            columns.append(found.derivative)
            disagreements.append(found.disagreement)
        shape = self.image_shape
        values = torch.stack(columns) if columns else torch.zeros(0, *shape, dtype=torch.float64, device=self.device)
        return SetUpJacobian(wanted, values, torch.tensor(disagreements, dtype=torch.float64))

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """(C, H, W) of an image."""
        scene = self.setup.nominal_scene
        operator = self.setup.operator()
        if operator is None:
            return scene.n_wavelengths, scene.image_pixels, scene.image_pixels
        return len(operator.parameters.gain), operator.form.frame.height, operator.form.frame.width

    def by_heights(self, heights: torch.Tensor, modes: torch.Tensor, theta: torch.Tensor | None = None) -> torch.Tensor:
        """Derivatives of :meth:`image` along changes of the relief [W/m^2 per unit], shape [K, C, H, W].

        Central differences in double precision at one step: the error is of its square, below 1e-5 where smooth.

        Args:
            heights: [m], shape [n, n].
            modes: change of heights per unit, shape [K, n, n].
            theta: where, shape [P]; None is nominal.
        """
        at = self.setup.nominal if theta is None else self.setup.checked(theta)
        simulator = self._made(at)
        step_m = optical_steps(simulator.scene)["base_thickness_m"]
        middle, found = self._heights(heights), []
        for mode in self._heights(modes):
            scale = step_m / max(float(mode.abs().max()), 1e-300)
            with torch.no_grad():
                ahead, behind = simulator(torch.stack((middle + scale * mode, middle - scale * mode)))
            found.append(self._shown((ahead - behind) / (2 * scale), at))
        if not found:
            return torch.zeros(0, *self.image_shape, dtype=torch.float64, device=self.device)
        return torch.stack(found)

    def _heights(self, heights: torch.Tensor) -> torch.Tensor:
        return heights.detach().to(self.device, torch.float64)

    def _shown(self, light: torch.Tensor, at: torch.Tensor) -> torch.Tensor:
        """What the camera makes of a change of light: its linear part."""
        operator = self.setup.operator(at, (), device=self.device)
        if operator is None:
            return light
        with torch.no_grad():
            return operator.linear(light, self.setup.camera(at, device=self.device))

    def _by_light(self, heights: torch.Tensor, at: torch.Tensor, name: str, step: float) -> Difference:
        number = self.setup.names.index(name)
        parameter = self.setup.parameters[number]

        def seen(value: float) -> torch.Tensor:
            theta = at.clone()
            theta[number] = value
            return self._shown(self.on_screen(heights, theta), at)

        return difference(seen, float(at[number]), step, parameter.low, parameter.high)

    def _by_camera(self, light: torch.Tensor, at: torch.Tensor, name: str) -> torch.Tensor:
        setup, tangent = self.setup, torch.zeros_like(at)
        number = setup.names.index(name)
        tangent[number] = 1.0
        operator = setup.operator(at, (setup.parameters[number].group,), device=self.device)
        assert operator is not None

        def shown(theta: torch.Tensor) -> torch.Tensor:
            return operator(light, setup.camera(theta, device=self.device))

        result = torch.func.jvp(shown, (at.to(self.device),), (tangent.to(self.device),))
        derivative: torch.Tensor = result[1]
        return derivative
