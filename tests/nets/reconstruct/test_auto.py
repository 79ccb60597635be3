"""What auto chooses, and that it says so."""

import shutil

import numpy as np
import pytest

from data_gen.samples import Reliefs
from data_gen.testset import fields_config
from nets.reconstruct.auto import choose
from nets.reconstruct.methods import create
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.fold_fraction import fold_fraction
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.folds import has_folds
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator


@pytest.mark.parametrize(
    ("has_start", "folds", "refusal", "plan"),
    [
        (False, True, None, "fibres"),
        (False, True, "another scene", "transport+refine"),
        (False, False, None, "refine"),
        (False, False, "another scene", "refine"),
        (True, True, None, "refine"),
        (True, True, "another scene", "refine"),
        (True, False, None, "refine"),
    ],
)
def test_table(has_start, folds, refusal, plan):
    choice = choose(has_start, folds, refusal)
    assert choice.plan == plan
    assert (refusal is not None and plan != "refine") == ("another scene" in choice.why)


def test_within_a_time_limit_a_cpu_does_not_look_for_lines():
    assert choose(False, True, None, is_timed=True).plan == "direct"
    assert choose(False, True, None, "cuda", is_timed=True).plan == "fibres"


def test_folds_are_seen(scene, image):
    assert has_folds(image, scene)
    assert not has_folds(CausticImage(np.ones_like(image.irradiance)), scene)
    for exposure in (0.2, 3.0):  # of a lamp that is not what it was
        assert has_folds(CausticImage(exposure * image.irradiance), scene)
        assert not has_folds(CausticImage(exposure * np.ones_like(image.irradiance)), scene)
    dim = scene.model_copy(update={"radiosity_W_m2": (0.5, 0.5, 0.5)})
    assert has_folds(CausticImage(0.5 * image.irradiance), dim)


def test_a_network_where_one_is_shipped(saved, shipped, scene, image, heights):
    """Of two shipped networks the one for this scene is taken."""
    other = Scene(height_samples=16, image_pixels=128)
    for number, known in enumerate((other, scene)):
        shutil.move(saved("direct", scene=known), shipped / f"{number}.safetensors")
    method = create("auto", scene, max_iterations=2)
    assert method.choose(image).plan == "fibres"
    result = method.reconstruct(image)
    assert result.method == "fibres" and result.settings["network"]["file"] == "1.safetensors"
    assert result.settings["auto"]["why"].startswith("a trained network knows this scene")
    result = method.reconstruct(image, initial=heights)
    assert result.method == "refine" and "start is given" in result.settings["auto"]["why"]


def test_transport_or_flat_where_none_is(shipped, scene, image):
    result = create("auto", scene, max_iterations=2).reconstruct(image)
    assert result.method == "refine"
    assert result.settings["auto"]["plan"] == "transport+refine"
    assert ("initial" in result.settings) == ("refine starts there" in result.settings["auto"]["why"])
    assert "none comes with this software" in result.settings["auto"]["why"]


def test_options(shipped, saved, scene, image):
    with pytest.raises(InputError, match="auto.max_iteration: unknown key"):
        create("auto", scene, max_iteration=2)
    # An option of refine alone is a wish for refine.
    assert create("auto", scene, total_variation=0.1).choose(image).plan == "transport+refine"
    path = saved("direct", scene=Scene(height_samples=16, image_pixels=64, base_thickness_m=5e-3))
    with pytest.raises(MismatchError, match="another scene"):
        create("auto", scene, weights=path).reconstruct(image)


def test_two_thin_lines_are_folds_enough():
    """Field 9: its two lines fold 0.4 % of the plate; taken for a weak relief they ended 3.9 mm wrong."""
    full = Scene()
    config = fields_config(full)
    (relief,) = Reliefs(config, "cpu", config.sample_fingerprint()).true([9])
    assert 0.001 < fold_fraction(relief.double().numpy(), full) < 0.01
    image = CausticSimulator(full, n_photons=512**2)(relief).numpy()
    assert has_folds(CausticImage(image), full)
