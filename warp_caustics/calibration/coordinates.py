"""Parameters as a descent moves them: in units of their prior widths, squares where light depends on squares.

A number v that an image depends on by its square moves as u = v^2. Of v ~ N(v0, w^2) the square has the mean v0^2 +
w^2 and
the variance 4 v0^2 w^2 + 2 w^4; it is taken for Gaussian about v0^2 with that variance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from warp_caustics.errors import InputError
from warp_caustics.setup.parameter import Parameter


@dataclass(frozen=True, eq=False)
class Coordinates:
    """P parameters and their coordinates x: 0 is what was believed before, 1 one prior width away.

    Attributes:
        parameters: P of them.
        before: what was believed, shape [P], float64.
        low: least x, shape [P].
        high: largest x, shape [P].
    """

    parameters: tuple[Parameter, ...]
    before: torch.Tensor
    low: torch.Tensor
    high: torch.Tensor
    _squared: torch.Tensor
    _centre: torch.Tensor
    _width: torch.Tensor

    @classmethod
    def of(cls, parameters: Sequence[Parameter], before: torch.Tensor) -> "Coordinates":
        """Coordinates about values.

        Args:
            parameters: P of them.
            before: values, within the ranges, shape [P].

        Raises:
            InputError: another number of values, or one that is out of its range.
        """
        if before.shape != (len(parameters),):
            raise InputError(f"{list(before.shape)} values for {len(parameters)} parameters; give one each")
        values = before.detach().to("cpu", torch.float64)
        for parameter, value in zip(parameters, values.tolist(), strict=True):
            parameter.checked(value)
        low, high, prior = (
            torch.tensor([getattr(p, name) for p in parameters], dtype=torch.float64)
            for name in ("low", "high", "prior")
        )
        squared = torch.tensor([p.is_squared for p in parameters], dtype=torch.bool)
        centre = torch.where(squared, values**2, values)
        width = torch.where(squared, (4 * values**2 * prior**2 + 2 * prior**4).sqrt(), prior)
        least = torch.where(squared, low.clamp_min(0.0) ** 2, low)
        most = torch.where(squared, high**2, high)
        return cls(tuple(parameters), values, (least - centre) / width, (most - centre) / width, squared, centre, width)

    def values(self, x: torch.Tensor) -> torch.Tensor:
        """Values of coordinates, shape [P], within the ranges."""
        moved = self._centre + self._width * torch.minimum(torch.maximum(x, self.low), self.high)
        return torch.where(self._squared, moved.clamp_min(0.0).sqrt(), moved)

    def to(self, values: torch.Tensor) -> torch.Tensor:
        """Coordinates of values, shape [P]."""
        return (torch.where(self._squared, values**2, values) - self._centre) / self._width

    @property
    def widths(self) -> torch.Tensor:
        """By how much a value, or its square, changes per unit of x, shape [P]."""
        return self._width

    def deviations(self, x: torch.Tensor, sigma: torch.Tensor) -> torch.Tensor:
        """Standard deviations of values, from those of coordinates, shape [P].

        Of a square u +- s: s / (2 sqrt u), and at most sqrt(u + s) - sqrt(u), which is what is left at 0.
        """
        change = self._width * sigma
        square = (self._centre + self._width * x).clamp_min(0.0)
        root = square.sqrt()
        near = (square + change).sqrt() - root
        return torch.where(
            self._squared, torch.where(square > change, change / (2 * root.clamp_min(1e-300)), near), change
        )

    def slopes(self, values: torch.Tensor) -> torch.Tensor:
        """Change of values per unit of x, shape [P]; of squares near 0 as :meth:`deviations` has it for a unit."""
        x = self.to(values)
        return self.deviations(x, torch.ones_like(x))
