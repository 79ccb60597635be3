"""Relief of lines and its derivatives, in millimetres, on any device."""

from dataclasses import dataclass

import torch
import warp as wp

from warp_caustics.chunked import warp_array, warp_stream
from warp_caustics.kernels.runtime import start_warp
from warp_caustics.prints.kernels import line_derivative_kernel
from warp_caustics.prints.line import Section
from warp_caustics.scene import Scene

LINE_COLUMNS = ("x0_mm", "y0_mm", "x1_mm", "y1_mm", "width_mm", "height_mm")


@dataclass(frozen=True)
class Limits:
    """What a line may be; wider than Tab. 3, so that a fit is not stopped at its edges.

    Attributes:
        reach: ends lie within so many half plates of the centre.
        width_mm: smallest and largest width [mm].
        height_mm: smallest and largest height [mm].
    """

    reach: float = 1.08
    width_mm: tuple[float, float] = (0.08, 4.5)
    height_mm: tuple[float, float] = (0.01, 2.6)


class LineModel:
    """Heights of lines on a scene's grid.

    Args:
        scene: gives plate and samples.
        profile: of a line across.
        device: where to compute.
        limits: what a line may be.
        supersampling: a sample is the mean of supersampling^2 points of its cell; 1 takes the height at its centre.
    """

    def __init__(
        self,
        scene: Scene,
        profile: Section = "cosine",
        device: str | torch.device = "cpu",
        limits: Limits | None = None,
        supersampling: int = 4,
    ):
        self.scene, self.profile, self.device = scene, profile, torch.device(device)
        self.limits, self.supersampling = limits or Limits(), supersampling
        self.n = scene.height_samples
        half = torch.tensor([500 * size for size in scene.plate_size_m]) * self.limits.reach
        (low_w, high_w), (low_h, high_h) = self.limits.width_mm, self.limits.height_mm
        self._low = torch.tensor([*(-half).tolist() * 2, low_w, low_h], dtype=torch.float64)
        self._high = torch.tensor([*half.tolist() * 2, high_w, high_h], dtype=torch.float64)

    def parts(self, lines: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Each line alone, and its derivatives.

        Args:
            lines: shape [L, 6] [mm], float64.

        Returns:
            Heights [mm], shape [L, n, n], and derivatives, shape [L, 6, n, n], float32, on the device.
        """
        start_warp()
        n, count = self.n, len(lines)
        heights = torch.empty(count, n, n, device=self.device)
        derivatives = torch.empty(count, 6, n, n, device=self.device)
        if not count:
            return heights, derivatives
        pitch_x, pitch_y = (1e3 * pitch for pitch in self.scene.sample_pitch_m)
        with warp_stream(self.device):
            wp.launch(
                line_derivative_kernel(self.profile == "quarter"),
                dim=heights.shape,
                inputs=[
                    warp_array(lines.to(self.device, torch.float32).contiguous()),
                    pitch_x,
                    pitch_y,
                    n,
                    self.supersampling,
                ],
                outputs=[warp_array(heights), warp_array(derivatives)],
                device=wp.device_from_torch(self.device),
            )
        return heights, derivatives

    def heights(self, lines: torch.Tensor) -> torch.Tensor:
        """Relief of all lines together [mm], shape [n, n], float32."""
        return self.parts(lines)[0].sum(dim=0)

    def clamped(self, lines: torch.Tensor) -> torch.Tensor:
        """Lines within the limits, shape [L, 6] [mm]."""
        return torch.minimum(torch.maximum(lines, self._low), self._high)
