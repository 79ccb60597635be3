"""By how much a capture is displaced as a whole, from the peak of its correlation with what was expected."""

import torch

from warp_caustics.reconstruct.seen_camera.image_window import taper

FARTHEST = 0.12
"""Displacement that is looked for, as part of the image."""
SMOOTH_PX = 1.0


def displacement_px(measured: torch.Tensor, expected: torch.Tensor, counts: torch.Tensor) -> tuple[float, float]:
    """Shift of ``measured`` against ``expected`` towards x and y [px], to a fraction of a pixel.

    Means are taken off and images faded out at the border; the peak is that of a parabola through its neighbours.

    Args:
        measured: shape [C, m, m].
        expected: shape [C, m, m].
        counts: which pixels are known, shape [C, m, m], bool.
    """
    m = measured.shape[-1]
    fade = taper(m, measured.device).to(measured.dtype)

    def prepared(image: torch.Tensor) -> torch.Tensor:
        mean = (image * counts).sum((1, 2), keepdim=True) / counts.sum((1, 2), keepdim=True).clamp_min(1)
        # Caustic lines are many times as bright as the rest: a root keeps one of them from deciding alone.
        flat = torch.where(counts, image - mean, 0.0)
        return flat.sign() * flat.abs().sqrt() * fade

    k = 2 * torch.pi * torch.fft.fftfreq(m, dtype=measured.dtype, device=measured.device)
    smooth = torch.exp(-((SMOOTH_PX * k) ** 2) / 2)
    transforms = [torch.fft.fft2(prepared(image)) * smooth * smooth[:, None] for image in (measured, expected)]
    correlation = torch.fft.ifft2((transforms[0] * transforms[1].conj()).sum(0)).real
    reach = max(1, int(FARTHEST * m))
    near = torch.roll(correlation, (reach, reach), (0, 1))[: 2 * reach + 1, : 2 * reach + 1]
    row, column = divmod(int(near.argmax()), 2 * reach + 1)
    return (
        column - reach + _beside(near[row], column),
        row - reach + _beside(near[:, column], row),
    )


def _beside(values: torch.Tensor, at: int) -> float:
    """Where between pixels the parabola through a peak and its neighbours is highest."""
    if not 0 < at < len(values) - 1:
        return 0.0
    left, middle, right = (float(values[at + offset]) for offset in (-1, 0, 1))
    bend = left - 2 * middle + right
    return 0.0 if bend >= 0 else max(-0.5, min(0.5, (left - right) / (2 * bend)))
