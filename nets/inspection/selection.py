"""Which of several reliefs explains the image better, part of the plate by part.

Light leaves a plate of some millimetres less than two millimetres beside where
it came in. So two reliefs that differ in separate parts can be judged part by
part: the parts are exchanged, all is simulated once, and each part is kept
where the image around it fits better.
"""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy.ndimage
import skimage.measure
import torch

from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import measurement_at
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.exact_picture import ExactPicture
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

WIDTH = 0.05
"""Residual, relative to the radiosity, from which on the misfit grows linearly, as in ``refine``."""
REACH_M = 1.2e-3
"""Around a part the image is looked at up to this distance [m]."""
LEVELS_M = (25e-6, 100e-6)
"""Parts are where two reliefs differ by more than this [m]: small differences first, then their cores."""
SMALLEST_PART = 3
"""Cells; less is left alone."""
FEATHER = 0.7
"""Standard deviation [cells] by which the rim of an exchanged part is softened."""


class MisfitMap:
    """How badly a relief explains an image, cell by cell.

    Args:
        simulator: of the measured scene, at all pixels.
        image: what was measured.
        blur_px: standard deviation of the camera's blur [px], shape [n_w]; None for none.
    """

    def __init__(self, simulator: CausticSimulator, image: CausticImage, blur_px: FloatArray | None = None):
        scene = simulator.scene
        self._blur = None
        if blur_px is not None and np.any(blur_px):
            self._blur = blur_matrices(scene.image_pixels, blur_px, simulator.device)
        self.simulator, self.cells = simulator, scene.height_samples
        self.measurement = measurement_at(image, scene, scene.image_pixels, simulator.device, border=1)
        radiosity = torch.tensor(scene.radiosity_W_m2, device=simulator.device)[:, None, None]
        self._per_radiosity = 1 / radiosity.clamp_min(1e-30)
        cell = (np.arange(scene.image_pixels) + 0.5) * self.cells // scene.image_pixels
        self._cell = cell.astype(int)
        weight = self.measurement.weight.sum(0).cpu().numpy()
        self._weight = self._binned(weight)

    def correct_at(self, heights_m: FloatArray, camera: ChannelCamera) -> None:
        """Compare from now on as a lattice without end would, through a camera itself, about a relief [m], [n, n].

        Args:
            heights_m: of which little changes.
            camera: that took the image; its blur is the one so far.
        """
        relief = torch.tensor(heights_m, dtype=torch.float32, device=self.simulator.device)
        exact = ExactPicture(self.simulator, camera)(relief) * self._per_radiosity
        self.measurement.irradiance.sub_(exact - self._shown(relief))

    def _shown(self, heights_m: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            simulated = self.simulator(heights_m) * self._per_radiosity
            return simulated if self._blur is None else blurred(simulated, self._blur)

    def _binned(self, pixels: FloatArray) -> FloatArray:
        rows = np.zeros((self.cells, pixels.shape[1]))
        np.add.at(rows, self._cell, pixels)
        cells = np.zeros((self.cells, self.cells))
        np.add.at(cells.T, self._cell, rows.T)
        return cells

    def residual(self, heights_m: FloatArray) -> torch.Tensor:
        """Simulated minus measured, relative to the radiosity, shape [n_w, m, m]; 0 where a pixel does not count."""
        with torch.no_grad():
            found = torch.tensor(heights_m, dtype=torch.float32, device=self.simulator.device)
            return (self._shown(found) - self.measurement.irradiance) * self.measurement.weight

    def __call__(self, heights_m: FloatArray) -> FloatArray:
        """Mean misfit of the pixels over each cell [1], shape [n, n]."""
        residual = self.residual(heights_m)
        misfit = ((residual**2 + WIDTH**2).sqrt() - WIDTH).sum(0).cpu().numpy()
        means: FloatArray = self._binned(misfit) / np.maximum(self._weight, 1)
        return means


def parts(difference_m: FloatArray, level_m: float) -> npt.NDArray[np.int64]:
    """Labels of connected parts where two reliefs differ by more than a level [m], shape [n, n]; 0 is none."""
    labels: npt.NDArray[np.int64] = skimage.measure.label(np.abs(difference_m) > level_m, connectivity=2)
    sizes = np.bincount(labels.ravel())
    labels[sizes[labels] < SMALLEST_PART] = 0
    return labels


def better_parts(
    misfit: MisfitMap, heights_m: FloatArray, candidates: Sequence[FloatArray], pitch_m: float, rounds: int = 1
) -> FloatArray:
    """A relief with every part exchanged that makes the image fit better.

    Args:
        misfit: judges.
        heights_m: where to start [m], shape [n, n].
        candidates: reliefs from which parts are taken [m], each [n, n].
        pitch_m: distance of height samples [m].
        rounds: how often to go through all candidates.

    Returns:
        Relief [m], shape [n, n]; its misfit is not above that of the start.
    """
    reach = max(1, math.ceil(REACH_M / pitch_m))
    best, best_map = heights_m, misfit(heights_m)
    for _ in range(rounds):
        before = best
        for candidate in candidates:
            for level in LEVELS_M:
                labels = parts(candidate - best, level)
                if labels.any():
                    best, best_map = _exchanged(misfit, best, best_map, candidate, labels, reach)
        if best is before:
            break
    return best


def _exchanged(
    misfit: MisfitMap,
    heights_m: FloatArray,
    present: FloatArray,
    candidate_m: FloatArray,
    labels: npt.NDArray[np.int64],
    reach: int,
) -> tuple[FloatArray, FloatArray]:
    """Relief and its misfit with those parts of a candidate that help."""
    all_of_it = _with(heights_m, candidate_m, labels > 0)
    tried = misfit(all_of_it)
    gain = scipy.ndimage.maximum_filter(labels, 2 * reach + 1)
    # Where the surroundings of two parts overlap, the larger number takes them; sums over what is left still tell.
    index = np.arange(1, labels.max() + 1)
    gained = np.asarray(scipy.ndimage.sum_labels(present - tried, gain, index))
    while (gained > 0).any():
        if (gained > 0).all():
            new, new_map = all_of_it, tried
        else:
            new = _with(heights_m, candidate_m, np.isin(labels, index[gained > 0]))
            new_map = misfit(new)
        if new_map.sum() < present.sum():
            return new, new_map
        gained[gained < np.median(gained[gained > 0]) * 1.000001] = 0
    return heights_m, present


def _with(heights_m: FloatArray, candidate_m: FloatArray, where: npt.NDArray[np.bool_]) -> FloatArray:
    """Heights with those of a candidate somewhere, shape [n, n]."""
    share = scipy.ndimage.gaussian_filter(scipy.ndimage.binary_dilation(where).astype(float), FEATHER)
    mixed: FloatArray = heights_m + np.where(where, 1.0, share) * (candidate_m - heights_m)
    return mixed
