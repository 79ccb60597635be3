"""Between which bounds reliefs lie."""

import torch


def bounds_of(coefficients: torch.Tensor, pitch_m: tuple[float, float]) -> torch.Tensor:
    """Below the lowest height [m], and above the steepest slope [1], of every relief: shape [B, 2].

    A spline lies between its coefficients, its slope between their differences.

    Args:
        coefficients: [m], shape [B, n + 4, n + 4].
        pitch_m: of the samples along x and y.
    """
    along_x, along_y = (coefficients.diff(dim=k).abs().amax((1, 2)) for k in (2, 1))
    steepest = torch.hypot(along_x / pitch_m[0], along_y / pitch_m[1])
    return torch.stack([coefficients.amin((1, 2)), steepest], dim=1)
