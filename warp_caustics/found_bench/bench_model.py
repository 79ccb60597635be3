"""What a bench shows of heights in one image, and how that changes with its numbers and with the heights.

As :mod:`warp_caustics.calibration.view_model` has it for plates that are known, but in single precision and in the
pixels of a refinement, since both are asked many times while heights are found:

    y = b ((E(h; theta) L_0 / L(theta)) + A) / (1 + A),

E in units of the radiosity, L(theta) the light of a flat plate on the bench of theta, L_0 on the told one: a capture is
divided by the flat frame of its own bench, and what was told is multiplied to it; A stray light, in the flat frame as
well; b the brightness of each channel. Of light that converges the picture is smaller
(:mod:`~warp_caustics.found_bench.picture_size`).
"""

import copy
import dataclasses
from collections.abc import Mapping
from typing import Self

import torch

from warp_caustics.calibration.flat_light import flat_light
from warp_caustics.calibration.view_model import difference_ends
from warp_caustics.found_bench.bench_numbers import AMBIENT, VERGENCE, BenchNumbers
from warp_caustics.found_bench.picture_size import brought_back, enlarged
from warp_caustics.reconstruct.pyramid import in_units_of_radiosity
from warp_caustics.resampling import blurred
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import optical_steps
from warp_caustics.simulator import CausticSimulator

STEP = 25.0
"""Steps of differences, in those of :func:`optical_steps`, to either side: light moves by 0.05 px between their ends.
Caustics are sharp: differences to one side err by what is left to second order, which looks as another blur does, so
that slants went the wrong way: by +0.8 mrad, believed to 0.4, where the true one was -3.5 away."""
HEIGHT_STEP = 0.01
"""Of a change of heights in the direction that a derivative is taken in, in units of that change: for changes of
a tenth or a pixel well within what is linear, and far above rounding."""


class BenchModel:
    """Images of heights on benches near a told one.

    Args:
        numbers: what is told, and what of it moves.
        pixels: of images along a side.
        device: where to simulate.
        blur: of the camera at these pixels, matrices of shape [n_w, m, m]; None for none.
    """

    def __init__(
        self, numbers: BenchNumbers, pixels: int, device: torch.device | str, blur: torch.Tensor | None = None
    ):
        self.numbers, self.pixels, self.device, self._blur = numbers, pixels, torch.device(device), blur
        self._flat = self._level(numbers.scene)
        self._lamps = dataclasses.replace(numbers, is_picture=False)
        """Small differences of size are simulated as those of a lamp, whatever they are of."""
        self._parameters = {p.name: p for p in numbers.parameters}
        self._as_of = 0.0
        """Vergence that the size of the picture looks like from which images here were brought back."""

    def in_size_of(self, values: Mapping[str, float]) -> Self:
        """The same for images that were brought back from the size of another bench's picture.

        A picture that is resampled is softer, by as much as its pixels lie between the old ones: what is off in size
        is told from that only where none of what is simulated is resampled. So images are brought back, once.

        Args:
            values: of that bench's numbers, by name.
        """
        model = copy.copy(self)
        vergence = values.get(VERGENCE, 0.0)
        model._as_of = vergence if self.numbers.is_picture else min(vergence, 0.0)
        return model

    def image(self, heights: torch.Tensor, values: Mapping[str, float]) -> torch.Tensor:
        """y at b = 1, shape [..., n_w, m, m], in the size of :meth:`in_size_of`.

        Args:
            heights: [m], shape [..., n, n], float32.
            values: of numbers, by name.

        Raises:
            InputError: values that make no bench.
        """
        values, size = self._brought_back(values)
        scene = self._lamps.scene_of(values)
        simulator = CausticSimulator(in_units_of_radiosity(scene, self.pixels), "lattice", device=self.device)
        with torch.no_grad():
            light = simulator(heights.to(self.device)) * (self._flat / self._level(scene))
            light = enlarged(light, size)
            if self._blur is not None:
                light = blurred(light, self._blur)
        stray = values.get(AMBIENT, self.numbers.before[AMBIENT])
        return (light + stray) / (1 + stray)

    def by_numbers(self, heights: torch.Tensor, values: Mapping[str, float], image: torch.Tensor) -> torch.Tensor:
        """Derivatives of the image by the numbers that are looked for [1 / unit], shape [P, n_w, m, m].

        Differences between both sides, or of three points where one side is out of range or is no lamp's.

        Args:
            heights: [m], shape [n, n].
            values: where.
            image: there.
        """
        steps = optical_steps(in_units_of_radiosity(self._lamps.scene_of(self._brought_back(values)[0]), self.pixels))
        columns = []
        for parameter in self.numbers.parameters:
            name, at = parameter.name, values[parameter.name]
            if name == AMBIENT:
                columns.append((1 - image) / (1 + at))
                continue
            low, high = difference_ends(parameter, at, STEP * steps[name])
            if name == VERGENCE:
                low = max(low, self._as_of)  # below that a picture is resampled, not simulated
            columns.append(self._slope(heights, values, image, name, low - at, high - at))
        return torch.stack(columns) if columns else image.new_zeros(0, *image.shape)

    def by_heights(
        self, heights: torch.Tensor, values: Mapping[str, float], image: torch.Tensor, changes: torch.Tensor
    ) -> torch.Tensor:
        """Derivatives of the image along changes of the heights, shape [K, n_w, m, m].

        Args:
            heights: [m], shape [n, n].
            values: where.
            image: there.
            changes: per unit, shape [K, n, n].
        """
        return (self.image(heights + HEIGHT_STEP * changes, values) - image) / HEIGHT_STEP

    def _slope(
        self,
        heights: torch.Tensor,
        values: Mapping[str, float],
        image: torch.Tensor,
        name: str,
        down: float,
        up: float,
    ) -> torch.Tensor:
        """Derivative of the image by one number, between steps down and up; of three points on the side with room.

        Not extrapolated as that of :mod:`warp_caustics.setup.differences`, which takes twice the images.
        """

        def seen(step: float) -> torch.Tensor:
            return self.image(heights, {**values, name: values[name] + step})

        near, far = sorted((down, up), key=abs)
        if abs(near) < abs(far) / 2:
            return (4 * seen(far) - 3 * image - seen(2 * far)) / (2 * far)
        return (seen(near) - seen(-near)) / (2 * near)

    def _brought_back(self, values: Mapping[str, float]) -> tuple[Mapping[str, float], float]:
        """Values of the bench that is simulated, and how much larger than its picture is what is looked at."""
        vergence = values.get(VERGENCE, 0.0)
        if vergence >= 0 and not self._as_of:
            return values, 1.0
        vergence, size = brought_back(self.numbers.scene, vergence, self._as_of)
        return {**values, VERGENCE: vergence}, size

    def _level(self, scene: Scene) -> torch.Tensor:
        """Light of a flat plate in units of the radiosity, shape [n_w, m, m]; 1 for parallel light."""
        level = flat_light(in_units_of_radiosity(scene, self.pixels), self.pixels, self.device, torch.float32)
        return level.clamp_min(1e-3)
