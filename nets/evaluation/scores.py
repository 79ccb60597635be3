"""How good a recovered relief is, in numbers."""

import numpy as np
import torch
from skimage.metrics import structural_similarity

from nets.evaluation.fields import Field
from warp_caustics.metrics import height_errors, relative_residual
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

SSIM_SIGMA = 1.5
_SSIM_WINDOW = 2 * int(3.5 * SSIM_SIGMA + 0.5) + 1

SCORES = {
    "rmse_um": "relief RMSE [um]",
    "rmse_mean_removed_um": "RMSE without the mean [um]",
    "quantile95_um": "95 % quantile of |error| [um]",
    "slope_error": "RMS slope error [1]",
    "ssim": "SSIM of the relief",
    "image_error": "image error, relative",
}
"""Key of every score, and what it is."""


class Scorer:
    """Scores of recovered reliefs of one scene.

    Images for scoring come from a lattice, which has no photon noise: of the true relief and of the one found. So the
    image error of the truth is 0, and no method gains by fitting noise.

    Args:
        scene: the set-up.
        n_photons: light paths per wavelength, more than methods use.
        device: where to simulate.
    """

    def __init__(self, scene: Scene, n_photons: int, device: str):
        self.scene = scene
        self.simulator = CausticSimulator(scene, "lattice", n_photons=n_photons, device=device)
        self._clean: dict[str, FloatArray] = {}

    def __call__(self, found_m: FloatArray, field: Field) -> dict[str, float | None]:
        """All :data:`SCORES` of a relief [m], shape [n, n]; None where one is not defined."""
        errors = height_errors(found_m, field.heights_m, self.scene.plate_size_m)
        return {
            "rmse_um": errors["rmse_um"],
            "rmse_mean_removed_um": errors["rmse_mean_removed_um"],
            "quantile95_um": errors["quantile95_um"],
            "slope_error": errors["rmse_slope"],
            "ssim": relief_ssim(found_m, field.heights_m),
            "image_error": relative_residual(self._image(found_m), self._reference(field)),
        }

    def _reference(self, field: Field) -> FloatArray:
        """The field's image without noise; an image that was given is as good as it is."""
        if field.origin == "file":
            return field.image.irradiance
        if field.name not in self._clean:
            self._clean[field.name] = self._image(field.heights_m)
        return self._clean[field.name]

    def _image(self, heights_m: FloatArray) -> FloatArray:
        heights = torch.from_numpy(heights_m.astype(np.float32)).to(self.simulator.device)
        with torch.no_grad():
            image: FloatArray = self.simulator(heights).cpu().numpy()
        return image


def relief_ssim(found_m: FloatArray, true_m: FloatArray) -> float | None:
    """Structural similarity (Wang et al. 2004) of two reliefs [m], shape [n, n].

    Gaussian weights of 1.5 samples, population covariance; the data range is that of the true relief, from its
    lowest to its highest sample. None for a flat truth, and for fewer samples than a window.
    """
    data_range = float(np.ptp(true_m))
    if data_range == 0 or min(true_m.shape) < _SSIM_WINDOW:
        return None
    similarity = structural_similarity(
        true_m.astype(np.float64),
        found_m.astype(np.float64),
        data_range=data_range,
        gaussian_weights=True,
        sigma=SSIM_SIGMA,
        use_sample_covariance=False,
    )
    return float(similarity)
