"""What heights do in answer to another bench, to first order.

A slope s moves light by about s (n - 1) f, with f the way to the screen; what makes f longer, or bends more, is made up
for by heights that are lower in proportion. Because light meets the relief above the base, and slopes are not small, a
little of it goes as h^2. A picture that is moved or too large is that of a plate that is moved or too large: h changes
by its slope times the displacement.
"""

import torch

CHANGED = 0.1
"""Unit of changes in proportion [1]."""
MOVED_PX = 1.0
"""Of a displacement: pixels of the relief's own grid would be too much for a first order, quarters are not."""


def height_changes(heights: torch.Tensor, plate_size_m: tuple[float, float], displacement_m: float) -> torch.Tensor:
    """Changes of a relief [m], shape [5, n, n]: in proportion to h and h^2, moved along x and y, enlarged.

    Each is what a bench that is off by about a prior width asks for, so that their prior widths are 1.

    Args:
        heights: [m], shape [n, n].
        plate_size_m: along x and y [m].
        displacement_m: of the moves, and of the enlarged one at the plate's border [m].
    """
    n = heights.shape[-1]
    pitch_x, pitch_y = (size / n for size in plate_size_m)
    along_y, along_x = torch.gradient(heights, spacing=(pitch_y, pitch_x))
    at = (torch.arange(n, dtype=heights.dtype, device=heights.device) + 0.5) * (2 / n) - 1
    tallest = heights.abs().amax().clamp_min(1e-9)
    return torch.stack(
        (
            CHANGED * heights,
            CHANGED * heights**2 / tallest,
            displacement_m * along_x,
            displacement_m * along_y,
            displacement_m * (at[None, :] * along_x + at[:, None] * along_y),
        )
    )
