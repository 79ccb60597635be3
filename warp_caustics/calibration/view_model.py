"""What a capture of a known plate should show, and its derivatives by the bench and by what is not known of the plate.

A capture that was divided by its flat frame shows L A(E(h)) / A(E(0)), with the camera A and light E; one without a
flat frame
A(E(h)). Each channel's brightness b is the capture's own: lamps drift. Light by the set-up is differentiated by
differences
of simulations with the same photons, wide enough that folds between two pixels do not matter; the camera by forward
mode, exactly.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch

from warp_caustics.calibration.flat_light import flat_light
from warp_caustics.camera.operator import Camera, channels, even, placed
from warp_caustics.camera.parameters import CameraParameters
from warp_caustics.setup.model import SetUpModel
from warp_caustics.setup.optical import optical_steps
from warp_caustics.setup.parameter import Parameter
from warp_caustics.setup.seen import PLACING
from warp_caustics.setup.set_up import SetUp

STEP = 50.0
"""Steps of differences, in those of derivatives: light moves by 0.05 px. Folds that cross pixels make shorter ones
jump."""
SQUARED_STEP = 0.3
"""Of numbers that count by their squares, in prior widths: light is nearly linear in the square."""
PLACE_STEP_PX = 1e-4
MOVING = {*PLACING, "turn_rad"}
"""Groups that move the picture as it is."""
TURNING = ("homography",)
TURNED_PX = 0.25
"""Displacement at the border by a turn up to which changes of light are placed as if there were none: a gather for
each takes
longer than all else, and what is shown is not concerned, only its derivatives."""
LEAST_BLUR = 0.15
"""Blur at which the derivative by its square is taken, if it is less [px]."""


class ViewModel:
    """Captures of one plate on a bench.

    Args:
        setup: the bench, with its free parameters; its camera shows the window and nothing else.
        heights: of the plate as it is told [m], shape [n, n].
        modes: changes of it [m per unit], shape [K, n, n].
        is_divided: captures were divided by a flat frame.
        device: where to simulate.
        oversampling: pixels of the set-up's scene along the side of one that is looked at. Caustics are sharper than
        pixels, and
            a picture that is moved by parts of one before it is blurred needs finer ones.
        simulation: further arguments of the simulator.
    """

    def __init__(
        self,
        setup: SetUp,
        heights: torch.Tensor,
        modes: torch.Tensor,
        is_divided: bool,
        device: str | torch.device = "cpu",
        oversampling: int = 1,
        **simulation: Any,
    ):
        self.setup, self.is_divided, self.device = setup, is_divided, torch.device(device)
        self.oversampling = oversampling
        self._model = SetUpModel(setup, device=device, **simulation)
        self._heights, self._modes = heights.to(self.device), modes.to(self.device)
        self._level = torch.tensor(setup.nominal_scene.radiosity_W_m2, dtype=torch.float64, device=self.device)

    def image(self, theta: torch.Tensor, plate: torch.Tensor) -> torch.Tensor:
        """What the capture should show at brightness 1 [W/m^2], shape [C, m, m].

        Args:
            theta: of the set-up, shape [P].
            plate: numbers of the plate, shape [K].
        """
        with torch.no_grad():
            light = self._model.on_screen(self._surface(plate), theta)
            camera = self.setup.camera(theta, device=self.device)
            operator = self._operator(theta, ())
            return self._binned(self._divided(operator(light, camera), operator, camera, self._flat(theta)))

    def derivatives(self, theta: torch.Tensor, plate: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """:meth:`image`, and its derivatives by the set-up, shape [P, C, m, m], and the plate's numbers, [K, C, m, m].

        By numbers that count by their squares the derivative is by the square.
        """
        with torch.no_grad():
            heights = self._surface(plate)
            light, flat = self._model.on_screen(heights, theta), self._flat(theta)
            camera, operator = self.setup.camera(theta, device=self.device), self._operator(theta, ())
            shown, even_shown = operator(light, camera), self._even(operator, camera, flat)
            image = self._divided(shown, operator, camera, flat)
            changes, flat_changes, numbers = self._light_changes(heights, theta)
            changes = torch.cat((changes, self._plate_changes(heights, theta)))
            moved = self._about(theta, camera, operator).linear(changes, camera) if len(changes) else changes
            if self.is_divided:
                moved = moved * (self._level[:, None, None] / even_shown)
                for k, change in enumerate(flat_changes):
                    if change is not None:
                        darker = channels(even(change, camera, operator.form), camera)
                        moved[k] -= image * darker / even_shown
        by_setup = torch.zeros(len(theta), *image.shape, dtype=torch.float64, device=self.device)
        for k, number in enumerate(numbers):
            by_setup[number] = moved[k]
        self._camera_columns(by_setup, light, flat, theta)
        return self._binned(image), self._binned(by_setup), self._binned(moved[len(numbers) :])

    def _binned(self, images: torch.Tensor) -> torch.Tensor:
        k = self.oversampling
        if k == 1:
            return images
        *lead, m, _ = images.shape
        return images.reshape(*lead, m // k, k, m // k, k).mean((-3, -1))

    def _about(self, theta: torch.Tensor, camera: CameraParameters, operator: Camera) -> Camera:
        """The camera without a small turn."""
        m = self.setup.nominal_scene.image_pixels
        is_straight = torch.equal(camera.homography.cpu(), torch.eye(3, dtype=torch.float64))
        if operator.form.turns and is_straight and abs(float(camera.turn_rad)) * m / 2 < TURNED_PX:
            operator = self._operator(theta, ("shift_x_px",))
            operator.form = replace(operator.form, turns=False)
        return operator

    def _surface(self, plate: torch.Tensor) -> torch.Tensor:
        return self._heights + torch.tensordot(plate.to(self.device), self._modes, 1) if len(plate) else self._heights

    def _operator(self, theta: torch.Tensor, groups: tuple[str, ...]) -> Camera:
        operator = self.setup.operator(theta, groups, device=self.device)
        assert operator is not None
        return operator

    def _flat(self, theta: torch.Tensor) -> torch.Tensor:
        scene = self.setup.scene(theta)
        return flat_light(scene, scene.image_pixels).to(self.device)

    def _even(self, operator: Camera, camera: CameraParameters, flat: torch.Tensor) -> torch.Tensor:
        """The flat frame: so smooth that place and blur do nothing to it."""
        ambient = (camera.ambient * operator.flat)[..., None, None]
        return channels(even(flat, camera, operator.form) + ambient, camera)

    def _divided(
        self, shown: torch.Tensor, operator: Camera, camera: CameraParameters, flat: torch.Tensor
    ) -> torch.Tensor:
        if not self.is_divided:
            return shown
        return shown * (self._level[:, None, None] / self._even(operator, camera, flat))

    def _light_changes(
        self, heights: torch.Tensor, theta: torch.Tensor
    ) -> tuple[torch.Tensor, list[torch.Tensor | None], list[int]]:
        """Change of light per unit of each number of the set-up, that of the flat frame, and their places."""
        steps = optical_steps(self.setup.scene(theta))
        changes, flat_changes, numbers = [], [], []
        for number, parameter in enumerate(self.setup.parameters):
            if parameter.name not in steps:
                continue
            ends = difference_ends(parameter, float(theta[number]), STEP * steps[parameter.name])
            change, flat_change = self._between(heights, theta, number, ends)
            changes.append(change)
            flat_changes.append(flat_change)
            numbers.append(number)
        shape = (0, self.setup.nominal_scene.n_wavelengths, *2 * (self.setup.nominal_scene.image_pixels,))
        stacked = torch.stack(changes) if changes else torch.zeros(shape, dtype=torch.float64, device=self.device)
        return stacked, flat_changes, numbers

    def _between(
        self, heights: torch.Tensor, theta: torch.Tensor, number: int, ends: tuple[float, float]
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Slope of light and of the flat frame's between two values of a parameter, or of its square."""
        behind, ahead = theta.clone(), theta.clone()
        behind[number], ahead[number] = ends
        squared = self.setup.parameters[number].is_squared
        apart = ends[1] ** 2 - ends[0] ** 2 if squared else ends[1] - ends[0]
        change = (self._model.on_screen(heights, ahead) - self._model.on_screen(heights, behind)) / apart
        if self.setup.scene(ahead).is_collimated and self.setup.scene(behind).is_collimated:
            return change, None
        return change, (self._flat(ahead) - self._flat(behind)) / apart

    def _plate_changes(self, heights: torch.Tensor, theta: torch.Tensor) -> torch.Tensor:
        changes = []
        scene = self.setup.scene(theta)
        pitch = min(scene.sample_pitch_m)
        # A change of slope turns light by (n - 1) of it, about, over the way to the screen.
        depth = scene.base_thickness_m / min(scene.glass_indices) - scene.screen_position_m[2]
        way = (min(scene.glass_indices) - 1) * depth
        step = STEP * optical_steps(scene)["base_thickness_m"]
        for mode in self._modes:
            steepest = max(float(torch.diff(mode, dim=axis).abs().max()) for axis in (0, 1)) / pitch
            scale = min(step / max(way * steepest, 1e-300), 1e-4 / max(float(mode.abs().max()), 1e-300))
            ahead, behind = (self._model.on_screen(heights + sign * scale * mode, theta) for sign in (1, -1))
            changes.append((ahead - behind) / (2 * scale))
        shape = (0, self.setup.nominal_scene.n_wavelengths, *2 * (self.setup.nominal_scene.image_pixels,))
        return torch.stack(changes) if changes else torch.zeros(shape, dtype=torch.float64, device=self.device)

    def _camera_columns(
        self, columns: torch.Tensor, light: torch.Tensor, flat: torch.Tensor, theta: torch.Tensor
    ) -> None:
        """Fill in derivatives by the camera; a picture that is in its place is not placed again for its blur."""
        names = [p.group for p in self.setup.parameters]
        exact = self.setup.camera(theta, device=self.device)
        plain = self._operator(theta, ())
        with torch.no_grad():
            picture = placed(light, exact, replace(plain.form, blurs=False))
            slopes = self._place_slopes(light, theta) if set(names) & MOVING else None
        inner = replace(plain.form, places=False, turns=False)
        for number, parameter in enumerate(self.setup.parameters):
            if parameter.part != "camera":
                continue
            if parameter.group in MOVING:
                assert slopes is not None
                with torch.no_grad():
                    operator = self._operator(theta, ())
                    operator.form = inner
                    change = operator.linear(self._displaced(parameter, slopes, theta), exact)
                    columns[number] = self._divided(change, plain, exact, flat)
                continue
            at, factor = theta.clone(), 1.0
            if parameter.is_squared:
                at[number] = max(float(at[number]), LEAST_BLUR)
                factor = 1 / (2 * float(at[number]))
            operator, source = self._operator(at, (parameter.group,)), light
            if parameter.group not in TURNING:
                operator.form = replace(operator.form, places=False, turns=False)
                source = picture
            columns[number] = factor * self._by_camera(operator, source, flat, at, number)

    def _place_slopes(self, light: torch.Tensor, theta: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Change of the picture before its blur per pixel that it is moved along x and y, shape [n_w, m, m] each.

        Central differences: splines are smooth, and in double precision 1e-8 is left.
        """
        form = replace(self._operator(theta, ("shift_x_px",)).form, blurs=False)
        camera = self.setup.camera(theta, device=self.device)
        slopes = []
        for axis in (0, 1):
            step = torch.zeros(2, dtype=torch.float64, device=self.device)
            step[axis] = PLACE_STEP_PX
            ahead, behind = (placed(light, camera._replace(shift_px=camera.shift_px + s), form) for s in (step, -step))
            slopes.append((ahead - behind) / (2 * PLACE_STEP_PX))
        return slopes[0], slopes[1]

    def _displaced(
        self, parameter: Parameter, slopes: tuple[torch.Tensor, torch.Tensor], theta: torch.Tensor
    ) -> torch.Tensor:
        """Change of the picture per unit of a number that moves it, pixel by pixel, shape [n_w, m, m].

        A picture moved by u(x, y) changes by as much as one moved by u altogether; that pixels grow with the
        magnification, too, is left out.
        """
        along_x, along_y = slopes
        m = along_x.shape[-1]
        camera = self.setup.camera(theta, device=self.device)
        middle = torch.arange(m, dtype=torch.float64, device=self.device) - (m - 1) / 2
        x, y = middle[None, :] - camera.shift_px[0], middle[:, None] - camera.shift_px[1]
        group, _, channel = parameter.name.partition(".")
        change = {
            "shift_x_px": lambda: along_x,
            "shift_y_px": lambda: along_y,
            "turn_rad": lambda: x * along_y - y * along_x,
            "magnification": lambda: (x * along_x + y * along_y) / camera.magnification,
            "colour_shift_x_px": lambda: along_x,
            "colour_shift_y_px": lambda: along_y,
            "colour_scale": lambda: middle[None, :] * along_x + middle[:, None] * along_y,
        }[group]()
        if not channel:
            return change
        own = torch.zeros_like(change)
        own[int(channel)] = change[int(channel)]
        return own

    def _by_camera(
        self, operator: Camera, light: torch.Tensor, flat: torch.Tensor, at: torch.Tensor, number: int
    ) -> torch.Tensor:
        def shown(theta: torch.Tensor) -> torch.Tensor:
            camera = self.setup.camera(theta, device=self.device)
            return self._divided(operator(light, camera), operator, camera, flat)

        tangent = torch.zeros_like(at)
        tangent[number] = 1.0
        function: Callable[..., Any] = torch.func.jvp
        derivative: torch.Tensor = function(shown, (at.to(self.device),), (tangent.to(self.device),))[1]
        return derivative


def difference_ends(parameter: Parameter, value: float, step: float) -> tuple[float, float]:
    """Two values between which the slope by a parameter, or by its square, is taken; within its range.

    Args:
        parameter: which.
        value: where.
        step: to either side; numbers that count by their squares take one of their own.
    """
    if parameter.is_squared:
        step = SQUARED_STEP * parameter.prior
    step = min(step, (parameter.high - parameter.low) / 4)
    low, high = max(value - step, parameter.low), min(value + step, parameter.high)
    return low, high
