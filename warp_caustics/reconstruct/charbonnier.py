"""The Charbonnier misfit of an image and its derivative in one walk over the pixels, for a CPU.

As many operations of torch, one after the other over a whole image in float64, fetch each new megabyte from the system
and cost ten times the arithmetic.
"""

from typing import Any

import numpy as np
import torch
from torch.autograd.function import once_differentiable

PIXELS_AT_ONCE = 8192
"""Their numbers stay in the second cache."""


class CharbonnierSum(torch.autograd.Function):
    """Sum over pixels of weight (sqrt(r^2 + width^2) - width), r = image - measured; differentiable in the image."""

    @staticmethod
    def forward(
        ctx: Any, image: torch.Tensor, measured: torch.Tensor, weight: torch.Tensor, width: float
    ) -> torch.Tensor:
        """The sum, float64, shape [].

        Args:
            ctx: keeps the derivative.
            image: shape [n_w, m, m], float32, on the CPU.
            measured: likewise.
            weight: likewise.
            width: of the residual, from which on it counts linearly, above 0.
        """
        seen, there, counts = (values.detach().contiguous().numpy().ravel() for values in (image, measured, weight))
        slope = np.empty_like(seen) if ctx.needs_input_grad[0] else None
        total = 0.0
        for begin in range(0, len(seen), PIXELS_AT_ONCE):
            part = slice(begin, begin + PIXELS_AT_ONCE)
            residual = (seen[part] - there[part]).astype(np.float64)
            root = np.sqrt(residual * residual + width**2)
            total += float(np.dot(root - width, counts[part]))
            if slope is not None:
                slope[part] = residual / root * counts[part]
        if slope is not None:
            ctx.save_for_backward(torch.from_numpy(slope).view(image.shape))
        return torch.tensor(total, dtype=torch.float64)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor, None, None, None]:
        """Gradient with respect to the image."""
        (slope,) = ctx.saved_tensors
        return slope * grad.float(), None, None, None


def charbonnier_sum(
    image: torch.Tensor, measured: torch.Tensor, weight: torch.Tensor, width: float
) -> torch.Tensor | None:
    """The sum of :class:`CharbonnierSum`; None for images that it is not made for.

    Args:
        image: any shape, type and device.
        measured: likewise.
        weight: likewise.
        width: as there.
    """
    fits = all(values.dtype == torch.float32 and not values.is_cuda for values in (image, measured, weight))
    if not fits or not width > 0 or not image.shape == measured.shape == weight.shape:
        return None
    found: torch.Tensor = CharbonnierSum.apply(image, measured, weight, width)  # type: ignore[no-untyped-call]
    return found
