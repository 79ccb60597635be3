"""Agreement with an independent renderer (tests/data/README.md)."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from warp_caustics import CausticSimulator, Scene
from warp_caustics.photons import Chunk

DATA = Path(__file__).parents[1] / "data"
SCENE = Scene(exit_medium="glass")


def load_heights(case):
    return torch.from_numpy(np.load(DATA / f"{case}_trace.npz")["heights_m"])


def blurred_error(image, reference):
    """Relative RMSE after a Gaussian of 1 px on both, 12 border pixels left out."""
    a, b = (np.stack([gaussian_filter(c.astype(float), 1)[12:-12, 12:-12] for c in x]) for x in (image, reference))
    return np.linalg.norm(a - b) / np.linalg.norm(b)


@pytest.mark.parametrize("case", ["a_flat", "b_wedge", "c_cosine", "d_gauss", "f_lines"])
def test_paths_land_where_the_other_renderer_says(case):
    """Height, slopes and screen position of 1089 paths at three wavelengths, to 1e-12 m."""
    trace = np.load(DATA / f"{case}_trace.npz")
    simulator = CausticSimulator(SCENE, placement="random", n_photons=trace["x"].size, dtype=torch.float64)
    engine = simulator.engine
    positions = torch.from_numpy(np.stack([trace["x"].ravel(), trace["y"].ravel()], axis=1))
    coefficients = engine.coefficients(load_heights(case)[None])
    maps = engine.maps(coefficients, Chunk(0, len(positions)), positions)
    landings, _, _, fates = engine.land(maps, positions)
    assert not fates.any()
    np.testing.assert_allclose(maps[0, 0] + SCENE.base_thickness_m, trace["z"].ravel(), atol=1e-12)
    np.testing.assert_allclose(maps[0, 1], trace["slope_x"].ravel(), atol=1e-9)
    np.testing.assert_allclose(maps[0, 2], trace["slope_y"].ravel(), atol=1e-9)
    metres = landings[0].numpy() * SCENE.pixel_size_m[0] - SCENE.plate_size_m[0] / 2
    np.testing.assert_allclose(metres[:, 0], trace["X"].reshape(3, -1), atol=1e-12)
    np.testing.assert_allclose(metres[:, 1], trace["Y"].reshape(3, -1), atol=1e-12)


@pytest.mark.parametrize(("case", "limit"), [("c_cosine", 0.002), ("d_gauss", 0.002), ("f_lines", 0.006)])
def test_image_matches_the_other_renderer(case, limit):
    """The lattice preset at its default number of photons; 2 % is what was asked for."""
    simulator = CausticSimulator(SCENE)
    image = simulator(load_heights(case).float())
    assert blurred_error(image.numpy(), np.load(DATA / f"{case}_image.npz")["image"]) < limit


def test_flat_plate_is_uniform():
    """A flat plate lets exactly L_i through, up to the border at two photons per pixel side."""
    image = CausticSimulator(SCENE)(torch.full((128, 128), 0.5e-3))
    torch.testing.assert_close(image, torch.ones(3, 512, 512), atol=1e-4, rtol=0)
