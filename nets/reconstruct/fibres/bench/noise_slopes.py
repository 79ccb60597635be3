"""How what is left of an image changes with lines, bench, light and lens, kept for more than one step."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from warp_caustics.types import FloatArray

MEMORY_SHARE = 0.2
"""Of a GPU's memory that derivatives may take; more of them lie in the main memory."""


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of deviations by N numbers.

    Attributes:
        jacobian: times root, shape [N, n_w m m], single precision.
        root: of the weight that each pixel had where they were taken, shape [n_w m m]; 0 where none counts.
        information: of the numbers, shape [N, N].
    """

    jacobian: torch.Tensor
    root: torch.Tensor
    information: FloatArray

    @classmethod
    def of(cls, rows: Iterator[torch.Tensor], size: int, weight: torch.Tensor) -> "Slopes":
        """Of so many derivatives, each shape [n_w, m, m], one after the other; the weight's shape is theirs."""
        root, pixels = weight.sqrt().flatten(), weight.numel()
        jacobian = torch.empty(size, pixels, device=_home(4 * size * pixels, weight.device))
        for place, row in zip(jacobian, rows, strict=True):
            place.copy_(row.flatten() * root)
        return cls(jacobian, root, (jacobian @ jacobian.T).double().cpu().numpy())

    def gradient(self, rest: torch.Tensor, weight: torch.Tensor) -> FloatArray:
        """Of half of the squared deviations, shape [N], by what is left and its weights elsewhere, [n_w, m, m]."""
        weighed = (rest * weight).flatten() / torch.where(self.root > 0, self.root, np.inf)
        gradient: FloatArray = (self.jacobian @ weighed.to(self.jacobian)).double().cpu().numpy()
        return gradient


def _home(needed: int, device: torch.device) -> torch.device:
    """Where so many bytes lie: on the device if it has room."""
    if device.type != "cuda":
        return device
    memory = torch.cuda.get_device_properties(device).total_memory
    return device if needed <= MEMORY_SHARE * memory else torch.device("cpu")
