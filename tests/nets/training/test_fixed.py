"""A pool that is filled once, and trainings that write nothing."""

import pytest
import torch

from nets.training.fit import fit
from nets.training.fresh import FreshSource
from nets.training.limits import Limits
from nets.training.sources import FixedSource, make_source

CPU = torch.device("cpu")


def test_the_pool_is_the_first_samples_and_batches_depend_on_their_number_only(tiny_run):
    config = tiny_run("denoiser", batch_size=3, fixed_samples=5, steps_per_epoch=2, accumulate=2)
    source = make_source(config, CPU)
    assert isinstance(source, FixedSource) and source.steps_per_epoch == 4
    late = source.batch(7)
    fresh = FreshSource(tiny_run("denoiser", batch_size=5), CPU)
    expected = fresh.batch(0)
    for name in ("noisy", "clean"):
        assert torch.equal(source.pool[name], expected[name])
    first = source.batch(0)
    assert first["noisy"].shape[0] == 3 and not torch.equal(first["noisy"], late["noisy"])
    again = make_source(config, CPU)
    assert torch.equal(again.batch(7)["clean"], late["clean"])
    chosen = [float(source.batch(step)["clean"].sum(dim=(1, 2, 3))[0]) for step in range(30)]
    assert len(set(chosen)) == 5  # all samples are used
    for each in (source, again, fresh):
        each.close()


def test_wrong_pools_are_refused(tiny_run):
    with pytest.raises(ValueError, match=r"fixed_samples 3 is smaller than a batch of 4"):
        tiny_run("denoiser", fixed_samples=3)
    with pytest.raises(ValueError, match="are both pools"):
        tiny_run("direct", fixed_samples=8, replay={"size": 8})


def test_a_training_without_a_folder_writes_nothing_and_is_the_same(
    tiny_run, train, fabric, watcher, tmp_path, monkeypatch
):
    config = tiny_run("updater", fixed_samples=4, total_steps=4, steps_per_epoch=2)
    written = train(config, tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    shared = make_source(config, CPU)
    for _ in range(2):
        result = fit(config, None, fabric, watcher, Limits(), resume=False, source=shared)
        assert (result.best, result.step, result.weights) == (written.best, 4, None)
        shared.close()  # the loop closed it already; it fills itself again
    assert sorted(tmp_path.rglob("*")) == before
    assert [progress.is_validation for progress in watcher.seen].count(True) == 4
