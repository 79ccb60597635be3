"""Every method's image: the same in every run, from photons of its own."""

import numpy as np
import pytest

from data_gen.dataset_config import PhotonConfig
from data_gen.testset import field_images
from nets.evaluation import fields
from nets.evaluation.fields import file_sources, prepare, testset_sources
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.images import write_image

FEW = PhotonConfig(n_photons=10_000, placement="stratified")


@pytest.fixture
def plate(tmp_path):
    path = tmp_path / "plate.npy"
    x = np.linspace(-1, 1, 16)
    np.save(path, 1e-4 * np.exp(-4 * (x[:, None] ** 2 + x**2)))
    return path


def test_testset_is_that_of_the_data_command(tiny_scene, tmp_path):
    """The same plates, photons and noise as data_gen.testset, to the last bit."""
    prepared = prepare(testset_sources(tiny_scene, "cpu", 2), tiny_scene, FEW, 0.01, tmp_path, "cpu")
    expected = field_images(tiny_scene, photons=FEW, fields=2)
    assert [field.name for field in prepared] == ["field_0", "field_1"]
    for field, image in zip(prepared, expected, strict=True):
        np.testing.assert_array_equal(field.image.irradiance, image)
    with pytest.raises(InputError, match="11 development fields; there are 10"):
        testset_sources(tiny_scene, "cpu", 11)


def test_noise_is_as_strong_as_asked(tiny_scene, plate, tmp_path):
    sources = file_sources([str(plate)], tiny_scene)
    (field,) = prepare(sources, tiny_scene, FEW, 0.02, tmp_path, "cpu")
    (clean,) = prepare(sources, tiny_scene, FEW, 0.0, tmp_path, "cpu")
    difference = field.image.irradiance - clean.image.irradiance
    assert difference.std() == pytest.approx(0.02, rel=0.1)
    # Methods are told what the image tells, not what is known here.
    assert field.image.noise_std is not None and (field.image.noise_std != 0.02).all()
    assert field.name == "plate" and field.folds == 0.0


def test_images_are_kept(tiny_scene, plate, tmp_path, monkeypatch):
    sources = file_sources([str(plate)], tiny_scene)
    (first,) = prepare(sources, tiny_scene, FEW, 0.01, tmp_path, "cpu")
    path = next(path for path in tmp_path.glob("*.npz"))
    with monkeypatch.context() as patch:
        patch.setattr(fields, "CausticSimulator", None)
        (again,) = prepare(sources, tiny_scene, FEW, 0.01, tmp_path, "cpu")
        assert again.content() == first.content()
        with pytest.raises(TypeError):
            prepare(sources, tiny_scene, FEW, 0.02, tmp_path, "cpu")
    path.write_bytes(path.read_bytes()[:-100])
    (mended,) = prepare(sources, tiny_scene, FEW, 0.01, tmp_path, "cpu")
    assert mended.content() == first.content()


def test_an_image_may_be_given(tiny_scene, plate, tmp_path):
    image = np.random.default_rng(0).uniform(0.5, 1.5, (3, 32, 32)).astype(np.float32)
    write_image(tmp_path / "seen.tif", image, wavelengths_m=tiny_scene.wavelengths_m)
    (source,) = file_sources([f"{plate}:{tmp_path / 'seen.tif'}"], tiny_scene)
    (field,) = prepare([source], tiny_scene, FEW, 0.01, tmp_path / "nowhere", "cpu")
    np.testing.assert_array_equal(field.image.irradiance, image)
    assert field.origin == "file"


def test_unusable_files_are_refused_before_anything_runs(tiny_scene, plate, tmp_path):
    for name, image in (("large", np.ones((3, 64, 64))), ("dark", np.zeros((3, 32, 32)))):
        write_image(tmp_path / f"{name}.tif", image.astype(np.float32), wavelengths_m=tiny_scene.wavelengths_m)
    with pytest.raises(MismatchError, match="64 x 64 pixels, the scene has 32 x 32; average blocks of 2 x 2"):
        file_sources([f"{plate}:{tmp_path / 'large.tif'}"], tiny_scene)
    with pytest.raises(InputError, match="the image is black; record it again"):
        file_sources([f"{plate}:{tmp_path / 'dark.tif'}"], tiny_scene)
    with pytest.raises(InputError, match="does not exist"):
        file_sources([str(tmp_path / "missing.npy")], tiny_scene)
    np.save(tmp_path / "fine.npy", np.zeros((20, 20)))
    with pytest.raises(MismatchError, match=r"shape \[20, 20\], the scene \[16, 16\]; resample it"):
        file_sources([str(tmp_path / "fine.npy")], tiny_scene)
    with pytest.raises(InputError, match="two fields are called 'plate'"):
        file_sources([str(plate), str(plate)], tiny_scene)
