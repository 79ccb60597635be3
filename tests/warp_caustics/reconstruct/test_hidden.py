"""Places of an image that something hid: told from what a relief makes dark, left out, and counted."""

import numpy as np
import pytest
import torch

from warp_caustics.reconstruct.base import CausticImage, Reconstruction, Reconstructor
from warp_caustics.reconstruct.hidden import DARK, RIM_PX
from warp_caustics.reconstruct.hidden import hidden_place as place_of
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

M = 128
SCENE = Scene(height_samples=32, image_pixels=M)
LEVEL = np.array(SCENE.radiosity_W_m2)[:, None, None]


def image_of(factor, scene=SCENE):
    noise = 0.01 * np.random.default_rng(0).standard_normal((3, M, M))
    return CausticImage(((1 + noise) * factor * LEVEL).astype(np.float32))


def corner(size):
    factor = np.ones((M, M))
    factor[:size, :size] = 0.02
    return factor


def hidden_place(image, scene):
    return place_of(image.irradiance, image.mask, scene)


class Told(Reconstructor):
    """Keeps what it was shown."""

    name = "told"

    def __init__(self, uncertainty_m):
        self.scene, self.uncertainty_m = SCENE, uncertainty_m

    def reconstruct(self, image, *, initial=None, progress=None):
        self.shown = image
        heights = np.full((32, 32), 3e-4)
        return Reconstruction("told", heights, image.irradiance, 0.0, "converged", uncertainty_m=self.uncertainty_m)


def test_a_hidden_corner_is_found_with_its_rim():
    hidden = hidden_place(image_of(corner(26)), SCENE)
    assert hidden[: 26 + 1, : 26 + 1].all() and not hidden[26 + RIM_PX + 1 :].any()


@pytest.mark.parametrize("size", [0, 5], ids=["nothing", "smaller than light is bent"])
def test_what_a_relief_may_clear_is_not_hidden(size):
    assert hidden_place(image_of(corner(size)), SCENE) is None


def test_dead_columns_are_not_hidden():
    factor = np.ones((M, M))
    factor[:, 60:62] = 0
    assert hidden_place(image_of(factor), SCENE) is None


def test_behind_a_wide_gap_light_goes_far():
    far = SCENE.model_copy(update={"screen_position_m": (0.0, 0.0, -2e-2)})
    assert hidden_place(image_of(corner(26)), far) is None


def test_what_is_dark_behind_steep_relief_is_not_hidden():
    """A roof of slope 0.4 leaves 5 mm at its feet nearly without light behind a gap of 30 mm."""
    far = SCENE.model_copy(update={"screen_position_m": (0.0, 0.0, -3e-2), "height_samples": M})
    x = (np.arange(M) + 0.5) / M * 50 - 25
    roof = np.tile(1e-3 * np.clip(4 - 0.4 * np.abs(x), 0, None), (M, 1))
    shown = CausticSimulator(far, "lattice")(torch.from_numpy(roof).float()).numpy()
    dark = (shown < DARK * LEVEL).all(axis=0)
    assert dark[M // 2].sum() > 4 and hidden_place(CausticImage(shown), far) is None


def test_masked_pixels_are_known_already():
    image = image_of(corner(26))
    mask = np.broadcast_to(corner(26) == 1, (3, M, M))
    assert hidden_place(CausticImage(image.irradiance, mask=mask), SCENE) is None


def test_a_dark_image_and_one_of_another_shape_are_left_to_the_method():
    assert hidden_place(image_of(np.zeros((M, M))), SCENE) is None
    assert hidden_place(CausticImage(np.zeros((1, M, M), np.float32)), SCENE) is None


def test_methods_are_shown_even_light_there_and_results_say_so():
    method = Told(np.full((32, 32), 1e-6))
    result = method.reconstruct(image_of(corner(26)))
    assert method.shown.irradiance.min() > 0.9 * LEVEL.min() and not method.shown.mask[:, :26, :26].any()
    assert method.shown.mask.mean() == pytest.approx(1 - result.counters["hidden"])
    (warning,) = result.warnings
    assert "taken for hidden" in warning
    # As uncertain as relief elsewhere is high, behind it and as far as light is bent.
    np.testing.assert_allclose(result.uncertainty_m[:7, :7], np.hypot(1e-6, 3e-4))
    np.testing.assert_allclose(result.uncertainty_m[12:, 12:], 1e-6)


def test_methods_without_uncertainty_state_none_and_plain_images_are_not_touched():
    method, image = Told(None), image_of(corner(26))
    assert method.reconstruct(image).uncertainty_m is None
    plain = image_of(np.ones((M, M)))
    assert method.reconstruct(plain).warnings == () and method.shown is plain
