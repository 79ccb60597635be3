"""Starts of the updater's own making, and flat ones."""

import csv

import pytest
import torch

from data_gen.samples import UpdaterSampler
from nets.training.keys import fresh_dataset
from nets.training.sources import make_source
from nets.weights import weights_info
from warp_caustics.data_gradient import HIGHEST_RELIEF_M, possible_heights

CPU = torch.device("cpu")


def source_of(tiny_run, **shares):
    return make_source(tiny_run("updater", batch_size=2, replay={"size": 8, "fresh_per_step": 2, **shares}), CPU)


def higher(target, simulated, start, gradient):
    """A network that adds 10 um."""
    return start + 1e-5


def test_flat_starts_and_what_belongs_to_them(tiny_run):
    source, plain = source_of(tiny_run, flat_share=1.0), source_of(tiny_run)
    flat, perturbed = source.fresh.batch(3), plain.fresh.batch(3)
    assert not flat["start"].any() and perturbed["start"].any()
    for name in ("heights", "target"):
        assert torch.equal(flat[name], perturbed[name])
    level = flat["simulated"].mean(dim=(2, 3))
    assert torch.allclose(flat["simulated"][:, :, 8:-8, 8:-8], level[:, :, None, None], rtol=0.01)
    for each in (source, plain):
        each.close()


def test_samples_are_continued_from_the_networks_answers(tiny_run):
    """Ten micrometres a step from a flat plate: heights of starts tell how often a sample was continued."""
    source = source_of(tiny_run, own_share=0.7, flat_share=1.0)
    source.network = higher
    source._fill(24)
    pool = {name: values.float() for name, values in source.pool.items()}
    steps = (pool["start"] / 1e-5).flatten(1)
    assert torch.allclose(steps, steps.round(), atol=1e-4), "nothing else was added"
    depth = steps.round().mean(dim=1)
    assert depth.max() >= 2 and len(depth.unique()) >= 2
    # A continued sample is one that was there: the same relief and target, and simulated from where it starts.
    again = source.fresh.starts.sampler.at(pool["heights"], pool["start"], pool["target"], range(8))
    assert torch.allclose(again["simulated"], pool["simulated"], rtol=2e-3, atol=1e-3)
    assert torch.allclose(
        again["gradient"], pool["gradient"], rtol=0.02, atol=float(pool["gradient"].abs().max()) / 100
    )
    source.close()


def test_without_a_network_all_samples_are_new(tiny_run):
    source, plain = source_of(tiny_run, own_share=0.9), source_of(tiny_run)
    for each in (source, plain):
        each._fill(4)
    assert all(torch.equal(source.pool[name], plain.pool[name]) for name in plain.pool)
    source.close(), plain.close()


def test_the_share_is_kept(tiny_run):
    source = source_of(tiny_run, own_share=0.3, flat_share=0.6)
    draws = [source.fresh.starts.draws(k) for k in range(1000)]
    assert sum(own for own, _ in draws) == pytest.approx(300, abs=50)
    assert sum(flat for _, flat in draws) == pytest.approx(600, abs=50)
    assert draws == [source.fresh.starts.draws(k) for k in range(1000)]
    source.close()


def test_only_what_can_be_simulated_is_a_start(tiny_run):
    scene = tiny_run("updater").scene
    wild = torch.tensor([float("nan"), float("inf"), -float("inf"), -1.0, 1.0, 1e-4])
    found = possible_heights(wild, scene)
    assert found.isfinite().all() and float(found.max()) == pytest.approx(HIGHEST_RELIEF_M)
    assert float(found.min()) == pytest.approx(-0.9 * scene.base_thickness_m)
    assert float(found[-1]) == pytest.approx(1e-4)


@pytest.mark.parametrize("kind", ["direct", "updater"])
def test_shares_need_an_updater_with_a_pool(tiny_run, kind):
    replay = {"size": 8, "own_share": 0.5} if kind == "direct" else {"own_share": 0.5}
    with pytest.raises(ValueError, match="are for the updater with a pool"):
        tiny_run(kind, replay=replay)


def test_a_training_is_judged_by_its_iterates(tiny_run, train, tmp_path):
    replay = {"size": 8, "fresh_per_step": 2, "own_share": 0.5, "flat_share": 0.5}
    result = train(tiny_run("updater", replay=replay, total_steps=8), tmp_path / "run")
    assert result.objective == "val_iterated_rmse_um"
    with open(tmp_path / "run" / "metrics.csv") as file:
        values = [float(row["val_iterated_rmse_um"]) for row in csv.DictReader(file) if row["val_iterated_rmse_um"]]
    assert len(values) == 2 and result.best == pytest.approx(min(values))
    info = weights_info(tmp_path / "run" / "weights.safetensors")
    assert info.training["objective"] == "val_iterated_rmse_um"


@pytest.mark.parametrize("traced", [None, 3000], ids=["all photons", "few"])
def test_samples_of_a_step_share_few_photons_and_no_others(tiny_run, traced):
    """The second sample of step 0 is made with the first one's photons, or with its own: those of a data set."""
    noisy = {"preset": "paper", "n_photons": 9000, "traced": traced}
    source = make_source(tiny_run("updater", batch_size=2, noisy=noisy), CPU)
    together = source.batch(0)
    alone = UpdaterSampler(fresh_dataset(source.config, is_validation=False), CPU).draw_tensors([0, 1])[0]
    source.close()
    assert torch.equal(together["start"], alone["start"])
    assert torch.equal(together["simulated"][0], alone["simulated"][0])
    assert torch.equal(together["simulated"][1], alone["simulated"][1]) == (traced is None)
