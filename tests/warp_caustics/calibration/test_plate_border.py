"""The border of a plate's picture, against simulated light."""

import numpy as np
import pytest
import torch

from warp_caustics.calibration.plate_border import border_of_picture, crossed_pixels
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

PIXELS = 64
BENCHES = {
    "parallel": {},
    "aside": {"light_tilt_rad": (0.08, -0.05)},
    "nearby": {"light_position_m": (0.004, -0.002, 0.25), "emission_half_angle_rad": 0.2},
}
GAP_M = 2e-3


def scene_of(bench, x_m, y_m):
    return Scene(
        height_samples=8, image_pixels=PIXELS, screen_position_m=(x_m, y_m, -GAP_M), wavelengths_m=(550e-9,),
        radiosity_W_m2=(1.0,), **BENCHES[bench],
    )  # fmt: skip


@pytest.mark.parametrize("bench", BENCHES)
@pytest.mark.parametrize("side", [-1, 1])
def test_border_is_where_light_ends(bench, side):
    """To 0.05 px in the middle of each edge."""
    for axis in (0, 1):
        moved = [0.0, 0.0]
        moved[axis] = side * 0.0125
        scene = scene_of(bench, *moved)
        with torch.no_grad():
            image = CausticSimulator(scene, n_photons=4_000_000)(torch.zeros(8, 8))[0].numpy()
        profile = image[PIXELS // 2 - 4 : PIXELS // 2 + 4].mean(0) if axis == 0 else image[:, 28:36].mean(1)
        size = scene.pixel_size_m[axis]
        at = border_of_picture(scene, axis)[(side + 1) // 2]
        where = (at - moved[axis]) / size + PIXELS / 2
        # As much light as a picture has that ends there, beside what is as bright just within.
        near = int(where)
        outside, inside = (slice(near - 6, near + 7), profile[near + 8 : near + 16].mean())
        if side == 1:
            inside = profile[near - 15 : near - 7].mean()
        lit = profile[outside].sum() / inside
        expected = (near + 7) - where if side == -1 else where - (near - 6)
        assert lit == pytest.approx(expected, abs=0.05)


def test_pixels_that_the_border_crosses():
    x = 0.3 * 0.05 / PIXELS
    crossed = crossed_pixels(scene_of("parallel", x, 0.0))
    expected = np.zeros((PIXELS, PIXELS), bool)
    # The window lies 0.3 px to the right: its last pixels are 70 % lit.
    expected[:, -1] = True
    np.testing.assert_array_equal(crossed, expected)
    assert not crossed_pixels(scene_of("parallel", 0.0, 0.0)).any(), "it ends where pixels do"
    both = crossed_pixels(scene_of("parallel", -2.4 * 0.05 / PIXELS, 1.2 * 0.05 / PIXELS))
    assert both[:, 2].all() and both[-2].all() and both.sum() == 2 * PIXELS - 1
