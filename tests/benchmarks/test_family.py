"""Benches of the family that no training saw: how they are drawn, what is told of them, and how errors are counted."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import family
from nets.told import bench_values
from nets.training.keys import fresh_dataset
from nets.training.told_config import ToldConfig
from warp_caustics.errors import MismatchError


@pytest.fixture(scope="module")
def config():
    return family.family_run()


@pytest.fixture(scope="module")
def few(config):
    """Three benches in few light paths; not to be changed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(family, "PHOTONS", 20_000)
        return family.images(config, fresh_dataset(config, is_validation=True), 3, "cpu")


def test_no_training_draws_them(config):
    assert config.training.validation.seed == family.SEED != config.training.seed
    own, training = (fresh_dataset(config, is_validation=is_validation) for is_validation in (True, False))
    assert own.sample_fingerprint() != training.sample_fingerprint()


def test_benches_differ_and_so_do_their_images(config, few):
    n, m = config.scene.height_samples, config.scene.image_pixels
    assert len({scene.screen_position_m[2] for scene, _, _ in few}) == 3
    for scene, image, truth in few:
        assert image.shape == (scene.n_wavelengths, m, m) and np.isfinite(image).all() and image.max() > 0
        assert truth.shape == (n, n) and np.ptp(truth) > 1e-6
    assert not np.allclose(few[0][1], few[1][1])


def test_what_is_nearly_told_is_off_by_what_a_calliper_leaves(config, few):
    """Base, gap and index: normal, with the standard deviations of the training's own errors; nothing of losses."""
    scene, errors = few[0][0], ToldConfig()
    generator = np.random.default_rng(0)
    told = [family.nearly(scene, config.scene, generator) for _ in range(400)]
    off = np.array([bench_values(each) for each in told])[:, :3] - np.array(bench_values(scene))[:3]
    widths = np.array([errors.base_m, errors.gap_m, errors.index])
    np.testing.assert_allclose(off.std(axis=0) / widths, 1, atol=0.15)
    assert (np.abs(off.mean(axis=0)) < 4 * widths / 20).all()
    assert not any(each.fresnel for each in told)


@pytest.fixture
def run(few, monkeypatch, tmp_path, capsys):
    """Runs the program on those benches with a method that is off by a known number of its uncertainties."""
    truths = [truth for _, _, truth in few]
    calls, refused = [], []

    def make(method, told, *, device):
        assert (method, device) == ("direct", "cpu")
        if refused and told in refused:
            raise MismatchError("beyond the family")
        calls.append(told)
        truth = truths[len(calls) - 1]
        # Errors from -2 to 2 uncertainties of 5 um, evenly: half are within one, 68.3 % within 1.366.
        error = 5e-6 * np.linspace(-2, 2, truth.size).reshape(truth.shape)
        result = SimpleNamespace(
            heights_m=truth + error,
            uncertainty_m=np.full(truth.shape, 5e-6),
            settings={"network": {"file": "some.safetensors"}},
            trust=None,
        )
        return SimpleNamespace(reconstruct=lambda image: result)

    monkeypatch.setattr(family, "images", lambda *arguments: few)
    monkeypatch.setattr(family, "create", make)

    def call(told):
        calls.clear()
        path = tmp_path / "found.json"
        monkeypatch.setattr("sys.argv", ["family", "--told", told, "--json", str(path)])
        family.main()
        lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        return lines, json.loads(path.read_text()), list(calls)

    call.refused = refused
    return call


def test_errors_and_how_often_they_are_within_uncertainty(run, few):
    lines, stored, _ = run("exact")
    assert stored == {"told": "exact", "rows": lines[:-1], "mean": lines[-1]}
    for row, (_, _, truth) in zip(lines, few, strict=False):
        assert row["rmse_um"] == pytest.approx(10 / np.sqrt(3), rel=1e-3)
        assert row["flat_um"] == pytest.approx(1e6 * np.sqrt(np.mean(truth**2)))
        assert (row["within_one"], row["within_two"]) == (pytest.approx(0.5, abs=1e-3), 1.0)
    mean = lines[-1]
    assert mean["factor"] == pytest.approx(2 * 0.683, rel=1e-3)
    assert mean["median_um"] == pytest.approx(10 / np.sqrt(3), rel=1e-3)


def test_who_is_told_what(run, few, config):
    scenes = [scene for scene, _, _ in few]
    assert run("exact")[2] == scenes
    assert run("nominal")[2] == [config.scene] * 3
    nearly = run("nearly")[2]
    assert all(told != scene and told != config.scene for told, scene in zip(nearly, scenes, strict=True))
    assert run("nearly")[2] == nearly, "the same each time"
    # Told a little beyond the family: as the bench is.
    run.refused.append(nearly[1])
    assert run("nearly")[2] == [nearly[0], scenes[1], nearly[2]]
