"""How well people know their benches: what a network in training is told."""

from typing import Annotated

from pydantic import Field

from data_gen.bench_ranges import PositiveSpan
from nets.unrolling_config import Share
from warp_caustics.strict import Finite, Strict

Width = Annotated[Finite, Field(ge=0, le=10)]


class ToldConfig(Strict):
    """What networks are told in training; errors are standard deviations of normal ones, times the visit's ``care``."""

    base_m: Width = 3e-5
    """Error of the base's thickness [m]."""
    gap_m: Width = 3e-5
    """Of the gap between plate and screen [m]; none is told below 0."""
    index: Width = 7e-4
    """Of the glass's index."""
    dispersion: Width = 0.015
    """Of its dispersion, relative."""
    tilt_rad: Width = 2e-3
    """Of the light's direction, along x and y [rad]."""
    lamp_distance: Width = 0.03
    """Of a lamp's distance, relative."""
    lamp_angle: Width = 0.2
    """Of the angle under which the lamp is seen, relative."""
    blur: Width = 0.2
    """Of the camera's blur, relative, and a tenth of a pixel besides."""
    noise: Width = 0.3
    """Of its noise, relative."""
    care: PositiveSpan = (0.1, 4.0)
    """What the errors of a visit are multiplied by, its logarithm uniform: some people measure, others remember."""
    exact_share: Share = 0.25
    """Of the visits are told what they are told without errors."""
    unsaid_lamp_share: Share = 0.1
    """Of the visits are told the light of the run's scene, whatever lamp there is: nobody said."""
    unknown_share: Share = 0.08
    """Of the visits are not told a parameter of the bench, each of them by itself."""
    unknown_camera_share: Share = 0.5
    """Of the visits are not told the camera's blur, and as many not its noise."""
    nothing_share: Share = 0.05
    """Of the visits are told nothing at all."""

    def absolute(self) -> dict[str, float]:
        """Errors by parameter or group of :mod:`nets.told`, in its units."""
        return {"base": self.base_m, "gap": self.gap_m, "index": self.index, "light": self.tilt_rad, "blur": 0.1}

    def relative(self) -> dict[str, float]:
        """Errors relative to the parameter."""
        return {
            "dispersion": self.dispersion,
            "divergence": self.lamp_distance,
            "lamp": self.lamp_angle,
            "blur": self.blur,
            "noise": self.noise,
        }
