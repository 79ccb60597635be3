"""A descent of lines so far: its numbers, what they leave of the image, and which of them are held."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch

from nets.reconstruct.fibres.image.descent_numbers import DescentNumbers
from warp_caustics.prints.model import LineModel
from warp_caustics.types import BoolArray, FloatArray

LOSS_SCALE = 1e3
"""L-BFGS-B's tolerances are absolute, and its first step has length one."""


@dataclass
class Fitted:
    """Lines and how well they explain the image.

    Attributes:
        lines: shape [L, 6] [m].
        loss: mean Charbonnier misfit, in units of the radiosity.
        beside: amplitudes of :class:`Beside`, shape [K] [1]; empty without.
    """

    lines: torch.Tensor
    loss: float
    beside: FloatArray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Beside:
    """What may change the image beside lines, found with them: image + sum_k b_k modes_k.

    Attributes:
        modes: per standard deviation of what is believed of each, in units of the radiosity, shape [K, n_w, m, m].
        before: amplitudes at which what is believed of them is met, shape [K].
        weight: of half the square of an amplitude's distance from there, in units of the loss.
    """

    modes: torch.Tensor
    before: FloatArray
    weight: float

    def at(self, pixels: int) -> torch.Tensor:
        """Modes of an image binned to so many pixels, shape [K, n_w, pixels, pixels]."""
        factor = self.modes.shape[-1] // pixels
        return torch.nn.functional.avg_pool2d(self.modes, factor) if factor > 1 else self.modes


class Misfit(Protocol):
    """What descends: :class:`~nets.reconstruct.fibres.image.image_fit.ImageFit`."""

    model: LineModel
    report: Callable[[float], None] | None

    def with_gradient(
        self, heights_m: torch.Tensor, beside: Beside | None = None, amplitudes: FloatArray | None = None
    ) -> tuple[float, torch.Tensor, FloatArray]:
        """Misfit of a relief [m], its gradient [1/m], shape [n, n], and that by amplitudes of what is beside, [K]."""


class Descent:
    """A descent so far.

    Args:
        fit: whose.
        lines: where it starts, shape [L, 6] [m].
        with_section: the model's shape is moved, too.
        beside: what else may change the image.

    Attributes:
        best: lines so far.
        shape: of the model with these.
    """

    def __init__(self, fit: Misfit, lines: torch.Tensor, with_section: bool, beside: Beside | None):
        self.fit, self.beside = fit, beside
        self.numbers = DescentNumbers(fit.model, len(lines), with_section)
        self.best = Fitted(lines, np.inf, np.zeros(0 if beside is None else len(beside.modes)))
        self.shape = fit.model.shape
        self._gradient: FloatArray | None = None

    def at_best(self) -> tuple[FloatArray, float, FloatArray]:
        """Numbers of the best lines, shape [P + K], the scaled loss there and its gradient."""
        self.fit.model.shape = self.shape
        if self._gradient is None:
            self(self._at())
        assert self._gradient is not None  # any loss is below that of no evaluation
        return self._at(), LOSS_SCALE * self.best.loss, self._gradient

    def _at(self) -> FloatArray:
        return np.append(self.numbers.of(self.best.lines, self.shape), self.best.beside)

    def __call__(self, numbers: FloatArray) -> tuple[float, FloatArray]:
        """Scaled loss and its gradient by numbers, shape [P + K], which are brought into their ranges."""
        model, of_relief = self.fit.model, self.numbers.size
        moved, amplitudes = self.numbers.put(numbers[:of_relief]), numbers[of_relief:]
        heights, by_line = model.with_jacobian(moved)
        jacobian = self.numbers.derivatives(moved, by_line)
        loss, by_height, by_amplitude = self.fit.with_gradient(heights, self.beside, amplitudes)
        by_number = (jacobian.flatten(1) @ by_height.reshape(-1)).double().cpu().numpy()
        gradient = LOSS_SCALE * np.append(by_number, by_amplitude)
        if loss < self.best.loss:
            self.best = Fitted(moved, loss, amplitudes)
            self.shape, self._gradient = model.shape, gradient
        if self.fit.report is not None:
            self.fit.report(loss)
        return LOSS_SCALE * loss, gradient

    def is_held(self, numbers: FloatArray, gradient: FloatArray) -> BoolArray:
        """Of numbers those at an end of their range that would go on outwards, shape [P + K]."""
        of_relief = self.numbers.size
        at, by = numbers[:of_relief], gradient[:of_relief]
        low, high = self.numbers.ends(at)
        held = ((at <= low) & (by > 0)) | ((at >= high) & (by < 0))
        return np.append(held, np.zeros(len(numbers) - of_relief, bool))


def in_coordinates(
    descent: Descent,
    to_numbers: Callable[[FloatArray], FloatArray],
    back: Callable[[FloatArray], FloatArray],
    start: tuple[float, FloatArray],
    u: FloatArray,
) -> tuple[float, FloatArray]:
    """Loss and gradient in coordinates u; at 0, where a descent starts, they are known."""
    numbers = to_numbers(u)
    value, gradient = descent(numbers) if u.any() else start
    return value, back(np.where(descent.is_held(numbers, gradient), 0.0, gradient))
