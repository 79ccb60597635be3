"""Named choices of photon placement, number and footprint."""

import math
from dataclasses import dataclass

from warp_caustics.scene import Placement, Profile, Scene


@dataclass(frozen=True)
class Preset:
    """Photon placement, smoothing parameter s and number of photons.

    Attributes:
        placement: where photons start.
        smoothing: s.
        profile: shape of the footprint.
        n_photons: fixed number n_l, or None.
        photons_per_pixel: used where n_photons is None.
    """

    placement: Placement
    smoothing: float
    profile: Profile
    n_photons: int | None = None
    photons_per_pixel: float = 0.0

    def photons(self, scene: Scene) -> int:
        """n_l for a scene."""
        return self.n_photons or max(1, round(self.photons_per_pixel * scene.image_pixels**2))


PRESETS: dict[str, Preset] = {
    # Quadratic B-splines with knots at the lattice pitch: a flat plate is uniform whatever the pixels, and caustics
    # are blurred by half a pitch. A Gaussian lattice lets a ripple through instead, which biases weak caustics.
    "lattice": Preset("lattice", smoothing=math.sqrt(2 * math.pi), profile="spline", photons_per_pixel=4.0),
    # Tab. 1 of the supplement.
    "paper": Preset("random", smoothing=16.0, profile="gaussian", n_photons=1_000_000),
}
