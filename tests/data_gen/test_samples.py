"""Samples are what their configuration and number say, and nothing else."""

import numpy as np
import pydantic
import pytest
import torch

from data_gen.bench_ranges import BenchRanges
from data_gen.dataset_config import DatasetConfig, PhotonConfig
from data_gen.samples import Images, Reliefs, UpdaterSampler, make_sampler
from data_gen.testset import DEVELOPMENT_FIELDS, field_heights, field_images, fields_config
from warp_caustics import CausticSimulator, Scene
from warp_caustics.errors import InputError
from warp_caustics.scene import validation_lines

SCENE = Scene(height_samples=16, image_pixels=48)
FEW = PhotonConfig(preset="paper", n_photons=4000)
MORE = PhotonConfig(preset="paper", n_photons=64000)


def config(kind="updater", **values):
    photons = {"noisy": FEW, "clean": MORE} if kind == "denoiser" else {}
    return DatasetConfig(**{"kind": kind, "n_samples": 20, "scene": SCENE, **photons, **values})


@pytest.mark.parametrize(
    "configuration", [config("denoiser"), config(), config(noisy=FEW, clean=MORE)], ids=["denoiser", "lattice", "paper"]
)
def test_a_sample_does_not_depend_on_its_batch(configuration):
    """Alone, in a batch, in another order: the same bits; and the fields say what the arrays are."""
    sampler = make_sampler(configuration, "cpu")
    batch, alone, turned = (sampler.draw(ids) for ids in ([0, 1, 2], [1], [2, 1]))
    for field in sampler.fields:
        array = batch.arrays[field.name]
        assert array.dtype == field.dtype and array.shape == (3, *field.shape)
        np.testing.assert_array_equal(array[1], alone.arrays[field.name][0])
        np.testing.assert_array_equal(array[1], turned.arrays[field.name][1])
        assert not np.array_equal(array[0], array[1])
    for counter in batch.counters.values():
        assert counter.shape == (3,) and np.isfinite(counter).all()


def test_defaults_are_the_papers_for_the_denoiser_and_a_lattice_for_the_updater():
    denoiser = DatasetConfig(kind="denoiser", n_samples=1)
    assert (denoiser.noisy.n_photons, denoiser.clean.n_photons) == (1_000_000, 16_000_000)
    assert DatasetConfig(kind="updater", n_samples=1).noisy.preset == "lattice"


def test_noise_of_noisy_and_clean_image_is_independent():
    """Common photons would correlate the two residuals; their correlation is below five standard errors."""
    configuration = config("denoiser", clean=FEW)
    reliefs = Reliefs(configuration, "cpu")
    heights = reliefs.true([3])
    # Twenty-five times the photons with the same footprints: sigma is proportional to s / sqrt(n_l).
    many = CausticSimulator(SCENE, "paper", n_photons=100_000, smoothing=80.0, placement="stratified")
    exact = many(heights).numpy()
    sampler = make_sampler(configuration, "cpu")
    arrays = sampler.draw([3]).arrays
    # Footprints overlap, so neighbouring pixels are alike; every sixth is nearly independent.
    noisy, clean = ((arrays[name].astype(np.float64) - exact)[..., ::6, ::6].ravel() for name in ("noisy", "clean"))
    assert abs(np.corrcoef(noisy, clean)[0, 1]) < 5 / np.sqrt(noisy.size / 3)
    assert np.std(noisy) > 0.005
    # The control: the same photons correlate fully.
    same = make_sampler(configuration, "cpu").draw([3]).arrays["noisy"].astype(np.float64)
    assert np.corrcoef(noisy, (same - exact)[..., ::6, ::6].ravel())[0, 1] > 0.99


def test_gradient_is_that_of_the_data_term():
    """Directional finite difference of 1/2 sum_w mean_pixels (S(h) - I)^2 in float64."""
    sampler = make_sampler(config(), "cpu")
    sample = {name: torch.from_numpy(array) for name, array in sampler.draw([4]).arrays.items()}
    simulator = CausticSimulator(SCENE, dtype=torch.float64)
    start, target = sample["start"].double(), sampler.target(sample["heights"], [4]).double()
    direction = torch.randn(start.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 1e-9

    def energy(heights):
        return float(((simulator(heights) - target) ** 2).mean(dim=(2, 3)).sum()) / 2

    expected = (energy(start + direction) - energy(start - direction)) / 2
    assert float((sample["gradient"].double() * direction).sum()) == pytest.approx(expected, rel=2e-3)


def test_denoiser_replaces_the_simulated_image_and_its_residual():
    hashed = config(denoiser="a" * 64)
    raw, perfect = make_sampler(config(), "cpu"), make_sampler(hashed, "cpu", denoiser=lambda images: images)
    # Another fingerprint gives other samples, so only the fields are compared.
    assert "denoised" in next(f.description for f in perfect.fields if f.name == "simulated")
    assert "denoised" not in next(f.description for f in raw.fields if f.name == "simulated")
    black = make_sampler(hashed, "cpu", denoiser=torch.zeros_like).draw([0]).arrays
    assert black["simulated"].max() == 0.0
    assert not np.allclose(black["gradient"], perfect.draw([0]).arrays["gradient"])
    for configuration, denoiser in ((config(), torch.zeros_like), (hashed, None)):
        with pytest.raises(InputError, match="denoiser"):
            make_sampler(configuration, "cpu", denoiser)


def test_longer_data_sets_begin_with_the_shorter_one():
    short, long = config(n_samples=2), config(n_samples=2000, samples_per_shard=7)
    assert short.fingerprint() != long.fingerprint()
    first, second = (make_sampler(c, "cpu").draw([1]).arrays["heights"] for c in (short, long))
    np.testing.assert_array_equal(first, second)
    assert [len(long.shard_ids(k)) for k in (0, long.n_shards - 1)] == [7, 2000 - 7 * 285]


def test_roles_and_seeds_give_other_reliefs():
    first = make_sampler(config(), "cpu").draw([0]).arrays["heights"]
    for other in (config(seed=1), config(role="test")):
        assert not np.allclose(first, make_sampler(other, "cpu").draw([0]).arrays["heights"])


def test_images_of_reseeded_photons_equal_those_of_a_new_simulator():
    """Reseeding in place is only a shortcut."""
    heights = Reliefs(config(), "cpu").true([0])
    images = Images(SCENE, FEW, "f" * 64, "noisy", "cpu")
    images(heights, [5])
    again, fresh = images(heights, [9]), Images(SCENE, FEW, "f" * 64, "noisy", "cpu")(heights, [9])
    assert torch.equal(again, fresh)


def test_development_fields_are_fixed():
    """Ten fields with the flat guess about 400 um off; the same plates whatever the scene's resolution."""
    fine, coarse = field_heights(), field_heights(Scene(height_samples=64))
    assert fine.shape == (DEVELOPMENT_FIELDS, 128, 128)
    # Narrow lines are averaged over 4 x 4 points of a cell in both.
    pooled = fine.reshape(DEVELOPMENT_FIELDS, 64, 2, 64, 2).mean(axis=(2, 4))
    assert np.sqrt(((pooled - coarse) ** 2).mean()) < 0.01 * np.sqrt((coarse**2).mean())
    rms = np.sqrt((fine.astype(np.float64) ** 2).mean(axis=(1, 2)))
    np.testing.assert_allclose(rms[:3] * 1e6, [189.00, 720.59, 288.60], atol=0.02)
    assert fields_config().role == "test"


def test_test_images_are_reproducible_and_noisy():
    photons = PhotonConfig(n_photons=90000, placement="stratified")
    clean, noisy, again = (field_images(SCENE, noise_std=s, photons=photons) for s in (0.0, 0.01, 0.01))
    np.testing.assert_array_equal(noisy, again)
    assert np.std(noisy - clean) == pytest.approx(0.01, rel=0.02)


def test_a_wrong_number_of_samples_is_told_alone():
    """What would have followed from it is no error of its own."""
    with pytest.raises(pydantic.ValidationError) as caught:
        DatasetConfig(kind="updater", n_samples=-1)
    (line,) = validation_lines(caught.value)
    assert line.startswith("n_samples: ") and "PydanticUndefined" not in line


def test_thinned_samples_are_their_own_unless_photons_are_shared():
    photons = PhotonConfig(preset="paper", n_photons=20_000, traced=6_000)
    own, shared = (
        UpdaterSampler(config(noisy=photons), "cpu", shares_photons=is_shared) for is_shared in (False, True)
    )
    alone, together = own.draw_tensors([3])[0]["simulated"], own.draw_tensors([2, 3])[0]["simulated"]
    assert torch.equal(alone[0], together[1])
    first, both = shared.draw_tensors([2])[0]["simulated"], shared.draw_tensors([2, 3])[0]["simulated"]
    assert torch.equal(first[0], both[0])
    assert not torch.equal(alone[0], both[1])


def test_traced_is_for_random_photons_of_the_paper_and_not_for_captures():
    with pytest.raises(pydantic.ValidationError, match="traced stands for random photons"):
        PhotonConfig(traced=1000)
    with pytest.raises(pydantic.ValidationError, match="not for captures"):
        DatasetConfig(kind="capture", n_samples=2, bench=BenchRanges(), clean=PhotonConfig(preset="paper", traced=1000))


def test_configurations_without_it_keep_their_fingerprint():
    """Of data sets that were built before."""
    plain = DatasetConfig(kind="updater", n_samples=8)
    assert "traced" not in plain.canonical()["noisy"]
    thinned = PhotonConfig(preset="paper", traced=1000)
    assert plain.fingerprint() != DatasetConfig(kind="updater", n_samples=8, noisy=thinned).fingerprint()


@pytest.mark.parametrize("photons", [FEW, PhotonConfig(), PhotonConfig(preset="paper", n_photons=20_000, traced=6_000)])
def test_gradients_for_several_denoisers_are_those_of_each_alone(photons):
    """Also where a caller has switched gradients off."""
    sampler = UpdaterSampler(config(noisy=photons), "cpu", shares_photons=True)
    ids = [0, 1, 2]
    heights, (start, _) = sampler.reliefs.true(ids), sampler.reliefs.perturbed(ids)
    target = sampler.target(heights, ids)
    denoisers = (None, torch.zeros_like, lambda images: images.roll(1, -1))
    with torch.no_grad():
        together = sampler.simulated.with_gradients(start, target, ids, denoisers)
    for denoiser, pair in zip(denoisers, together, strict=True):
        for ours, alone in zip(pair, sampler.simulated.with_gradient(start, target, ids, denoiser), strict=True):
            torch.testing.assert_close(ours, alone, rtol=1e-4, atol=1e-6 * float(alone.abs().max()))
    assert not torch.equal(together[0][1], together[1][1])
