"""The wanted irradiance."""

import numpy as np
import pytest

from warp_caustics.design.target import grey, target_irradiance
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=32, image_pixels=64)


def ramp(rows, columns):
    return np.linspace(0.0, 1.0, columns)[None, :] * np.ones((rows, 1))


def test_light_is_neither_made_nor_lost():
    target = target_irradiance(ramp(50, 70), SCENE, floor=0.2, margin_m=4e-3)
    assert target.mean() == pytest.approx(1, abs=1e-12)


def test_black_keeps_the_floor_and_the_rest_is_proportional():
    picture = ramp(64, 64)
    target = target_irradiance(picture, SCENE, floor=0.25)
    assert target.min() == pytest.approx(0.25, abs=1e-12)
    np.testing.assert_allclose(target, 0.25 + 0.75 * picture / picture.mean())


def test_even_picture_is_an_even_target():
    np.testing.assert_allclose(target_irradiance(np.full((7, 9), 3.0), SCENE, floor=0.1, fit="stretch"), 1.0)


def test_grey_is_the_luminance_of_three_channels_and_the_mean_of_others():
    values = np.array([1.0, 2.0, 4.0]).reshape(3, 1, 1)
    assert grey(values)[0, 0] == pytest.approx(0.2126 + 2 * 0.7152 + 4 * 0.0722)
    assert grey(values[:2])[0, 0] == pytest.approx(1.5)


def test_margin_is_dark_and_symmetric():
    target = target_irradiance(np.ones((10, 10)), SCENE, margin_m=0.05 / 8)
    lit = np.argwhere(target > 0)
    assert lit.min() == 8
    assert lit.max() == 55


@pytest.mark.parametrize(("shape", "rows", "columns"), [((20, 40), 32, 64), ((40, 20), 64, 32)])
def test_padded_picture_keeps_its_shape(shape, rows, columns):
    target = target_irradiance(np.ones(shape), SCENE, fit="pad")
    lit = target > 0
    assert (lit.any(axis=1).sum(), lit.any(axis=0).sum()) == (rows, columns)


def test_cropping_keeps_the_middle():
    picture = np.zeros((64, 128))
    picture[:, 32:96] = ramp(64, 64) + 0.5
    target = target_irradiance(picture, SCENE, fit="crop")
    np.testing.assert_allclose(target, picture[:, 32:96] / picture[:, 32:96].mean())


def test_plate_that_is_not_square_takes_the_crop_of_its_shape():
    wide = SCENE.model_copy(update={"plate_size_m": (0.08, 0.04)})
    picture = np.zeros((64, 64))
    picture[16:48] = 1.0
    np.testing.assert_allclose(target_irradiance(picture, wide), 1.0)


def test_resampling_keeps_the_balance_of_light():
    rng = np.random.default_rng(3)
    picture = rng.uniform(size=(640, 640))
    picture[:, :320] *= 3
    target = target_irradiance(picture, SCENE)
    assert target[:, :30].mean() / target[:, 34:].mean() == pytest.approx(3, rel=0.02)
    assert target.std() < 0.6, "fine noise is averaged, not picked"


@pytest.mark.parametrize(
    ("picture", "options", "reason"),
    [
        (np.zeros((8, 8)), {}, "black everywhere"),
        (np.ones((1, 1)), {}, "1 x 1 pixels"),
        (np.ones((8, 8)), {"floor": 1.0}, "floor 1"),
        (np.ones((8, 8)), {"floor": float("nan")}, "floor nan"),
        (np.ones((8, 8)), {"margin_m": 0.03}, "margin 0.03"),
        (np.ones((8, 8)), {"margin_m": -1.0}, "margin -1"),
        (np.ones((8, 8)), {"fit": "zoom"}, "fit 'zoom'"),
        (np.ones((2, 4000)), {"fit": "pad"}, "--fit crop"),
    ],
)
def test_what_cannot_be_a_target_is_refused(picture, options, reason):
    with pytest.raises(InputError, match=reason):
        target_irradiance(picture, SCENE, **options)
