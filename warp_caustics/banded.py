"""Products with matrices whose entries lie near a diagonal: block by block, linear in the length of an axis."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from warp_caustics.types import FloatArray

BLOCK_ROWS = 256
"""Rows of a block: spline filters reach 40 samples to either side, so that most of a block is not zero."""


@dataclass(frozen=True)
class Block:
    """Rows and columns of a matrix, and what stands there, shape [..., rows, columns]."""

    rows: slice
    columns: slice
    entries: torch.Tensor


@dataclass(frozen=True)
class Banded:
    """A matrix, or several with the same pattern, as blocks that hold all entries but zeros.

    Attributes:
        shape: rows and columns.
        blocks: of consecutive rows.
    """

    shape: tuple[int, int]
    blocks: tuple[Block, ...]

    def times(self, planes: torch.Tensor) -> torch.Tensor:
        """Matrix [..., R, K] @ planes [..., K, L]."""
        return torch.cat([block.entries @ planes[..., block.columns, :] for block in self.blocks], dim=-2)

    def transposed_times(self, planes: torch.Tensor) -> torch.Tensor:
        """Matrix transposed [K, R] @ planes [B, R, L]; of several, with planes [B, S, R, L], the sum over those."""
        found = planes.new_zeros(len(planes), self.shape[1], planes.shape[-1])
        for block in self.blocks:
            rows = planes[..., block.rows, :].reshape(len(planes), -1, planes.shape[-1])
            found[:, block.columns] += block.entries.flatten(0, -2).T @ rows
        return found

    def after(self, planes: torch.Tensor) -> torch.Tensor:
        """Planes [..., L, R] @ matrix [..., R, K]."""
        found = planes.new_zeros(*planes.shape[:-1], self.shape[1])
        for block in self.blocks:
            found[..., block.columns] += planes[..., block.rows] @ block.entries
        return found

    def transposed_after(self, planes: torch.Tensor) -> torch.Tensor:
        """Planes [..., L, K] @ matrix transposed [..., K, R]."""
        parts = [planes[..., block.columns] @ block.entries.transpose(-2, -1) for block in self.blocks]
        return torch.cat(parts, dim=-1)


def banded(
    rows_of: Callable[[int, int], FloatArray],
    rows: int,
    tensor: Callable[[FloatArray], torch.Tensor],
) -> Banded:
    """Blocks of a matrix that is never there as a whole.

    Args:
        rows_of: rows from the first to before the second number, shape [..., rows, columns].
        rows: how many there are.
        tensor: makes tensors of the wished type on the wished device.
    """
    blocks, columns = [], 0
    for first in range(0, rows, BLOCK_ROWS):
        last = min(first + BLOCK_ROWS, rows)
        dense = rows_of(first, last)
        columns = dense.shape[-1]
        (used,) = np.nonzero(dense.reshape(-1, columns).any(0))
        begin, end = (int(used[0]), int(used[-1]) + 1) if len(used) else (0, 1)
        blocks.append(Block(slice(first, last), slice(begin, end), tensor(dense[..., begin:end])))
    return Banded((rows, columns), tuple(blocks))
