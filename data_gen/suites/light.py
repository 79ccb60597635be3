"""Truth and light of a case: what was printed, and the irradiance on its screen, without a camera.

Truth is made on the CPU wherever images are simulated, so that everybody is scored against the same bits.
"""

from collections import OrderedDict

import numpy as np
import numpy.typing as npt
import torch

from data_gen.dataset_config import PhotonConfig, sample_seed
from data_gen.samples import Reliefs
from data_gen.suites.case import Case
from data_gen.suites.lens import FINENESS as LENS_FINENESS
from data_gen.suites.lens import lens_moves, through_lens
from data_gen.suites.odd_prints import printed
from data_gen.suites.picture_size import FINENESS, means_of_picture
from warp_caustics.height_field import cell_centres
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray

ImageArray = npt.NDArray[np.float32]

REMEMBERED = 8
"""Simulators kept: of one bench, with one for each wavelength and those of its flat plate."""


def true_heights(case: Case) -> FloatArray:
    """What was printed, its base's bow included [m], float64, shape [n, n]."""
    plate, scene = case.plate, case.plate.config.scene
    reliefs = Reliefs(plate.config, "cpu", plate.fingerprint)
    if case.condition.relief == "plain":
        heights = reliefs.true([plate.number])[0].double().numpy()
    else:
        strokes = [reliefs.strokes(plate.number)]
        heights = printed(case.condition.relief, strokes, scene, plate.config.reliefs, "cpu")[0]
    if plate.bow_m:
        x, y = (cell_centres(scene.height_samples, length) for length in scene.plate_size_m)
        heights = heights + 4 * plate.bow_m / max(scene.plate_size_m) ** 2 * (x[None, :] ** 2 + y[:, None] ** 2)
    return np.asarray(heights, np.float64)


class Light:
    """Irradiance of cases, from photons that no method uses.

    Args:
        device: where to simulate.
        n_photons: per wavelength, in place of the cases' own; fewer to try.
    """

    def __init__(self, device: str, n_photons: int | None = None):
        self.device, self.n_photons = device, n_photons
        self._simulators: OrderedDict[str, CausticSimulator] = OrderedDict()

    def behind_plate(self, case: Case, heights_m: FloatArray) -> ImageArray:
        """Irradiance behind a relief [W/m^2], shape [n_w, m, m]; heights [m], shape [n, n].

        Of a case with a camera as its lens shows it: displaced and blurred.
        """
        photons = case.photons
        if self.n_photons is not None:
            photons = photons.model_copy(update={"n_photons": self.n_photons})
        return self._channels(case, photons, heights_m)

    def behind_flat(self, case: Case) -> ImageArray:
        """The same without relief, without photon noise."""
        flat = np.zeros((case.scene.height_samples,) * 2)
        return self._channels(case, PhotonConfig(), flat)

    def _channels(self, case: Case, photons: PhotonConfig, heights_m: FloatArray) -> ImageArray:
        if case.condition.scaled:
            return self._other_sizes(case, photons, heights_m)
        if case.camera is not None:
            fine = [finer(scene, LENS_FINENESS) for scene in channel_scenes(case)]
            light = np.concatenate([self._shot(scene, photons, case, heights_m) for scene in fine])
            return through_lens(light, case.camera)
        images = [self._shot(scene, photons, case, heights_m) for scene in channel_scenes(case)]
        return np.concatenate(images)

    def _other_sizes(self, case: Case, photons: PhotonConfig, heights_m: FloatArray) -> ImageArray:
        """Of channels whose pictures are of another size than the window: one by one, on fine pixels."""
        found = []
        pixels, bright = case.scene.image_pixels, case.scene.radiosity_W_m2
        for channel, (scene, by) in enumerate(zip(one_by_one(case), case.condition.scaled, strict=True)):
            light = self._shot(finer(scene, FINENESS), photons, case, heights_m)[0] / bright[channel]
            found.append(bright[channel] * means_of_picture(light, pixels, 1 + by))
        return np.asarray(found, np.float32)

    def _shot(self, scene: Scene, photons: PhotonConfig, case: Case, heights_m: FloatArray) -> ImageArray:
        simulator = self._simulator(scene, photons)
        # Of random placements; a lattice has no seed. The purpose is the test fields' own.
        simulator.reseed(sample_seed(case.plate.fingerprint, "photons/test", case.plate.number))
        with torch.no_grad():
            heights = torch.tensor(heights_m, dtype=torch.float32, device=simulator.device)
            return np.asarray(simulator(heights).cpu().numpy(), np.float32)

    def _simulator(self, scene: Scene, photons: PhotonConfig) -> CausticSimulator:
        key = f"{scene.model_dump_json()}{photons.record()}"
        if key not in self._simulators:
            self._simulators[key] = CausticSimulator(scene, device=self.device, **photons.record())
            while len(self._simulators) > REMEMBERED:
                self._simulators.popitem(last=False)
        self._simulators.move_to_end(key)
        return self._simulators[key]


def finer(scene: Scene, times: int) -> Scene:
    """The same on pixels so many times as fine."""
    return scene.model_copy(update={"image_pixels": times * scene.image_pixels})


def channel_scenes(case: Case) -> list[Scene]:
    """Scenes whose images, one after another, are those of the case's wavelengths.

    One scene if all wavelengths share a screen; otherwise one for each. What lies aside comes from a screen that is
    moved sideways, so that nothing is resampled.
    """
    moves = channel_moves(case)
    return [_moved(case.scene, moves[0])] if (moves == moves[0]).all() else one_by_one(case)


def one_by_one(case: Case) -> list[Scene]:
    """A scene for each of the case's wavelengths, on a screen where that channel's picture lies."""
    scene, found = case.scene, []
    for channel, move in enumerate(channel_moves(case)):
        alone = {
            "wavelengths_m": (scene.wavelengths_m[channel],),
            "radiosity_W_m2": (scene.radiosity_W_m2[channel],),
        }
        found.append(_moved(Scene.model_validate(scene.model_dump() | alone), move))
    return found


def _moved(scene: Scene, move: FloatArray) -> Scene:
    """With the screen moved sideways [px]."""
    if not move.any():
        return scene
    x, y, z = scene.screen_position_m
    size_x, size_y = scene.pixel_size_m
    position = (x + float(move[0]) * size_x, y + float(move[1]) * size_y, z)
    return Scene.model_validate(scene.model_dump() | {"screen_position_m": position})


def channel_moves(case: Case) -> FloatArray:
    """Where the screen of each wavelength is moved to by the case's condition or camera [px], shape [n_w, 2]."""
    condition, count = case.condition, case.scene.n_wavelengths
    moves = np.zeros((count, 2)) if case.camera is None else lens_moves(case.camera, count)
    if condition.apart_px:
        angles = bench_angles(case)
        for channel in condition.moved:
            is_turned = condition.is_opposite and channel == condition.moved[-1]
            angle = angles[condition.moved[0]] + np.pi if is_turned else angles[channel]
            moves[channel] = condition.apart_px * np.cos(angle), condition.apart_px * np.sin(angle)
    return moves


def bench_angles(case: Case) -> FloatArray:
    """Towards which a plate's channels move, then towards which its light grows [rad], shape [n_w + 1]."""
    return case.plate.rng("robustness").uniform(0, 2 * np.pi, case.scene.n_wavelengths + 1)
