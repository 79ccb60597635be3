"""Training from a data set on disk."""

import pytest
import torch
from torch._utils import ExceptionWrapper

from data_gen.dataset_config import DatasetConfig, PhotonConfig
from data_gen.samples import UpdaterSampler, make_sampler
from data_gen.store import build
from data_gen.store.reader import is_validation
from nets.training.files import FileSource, StepSampler, data_fingerprint, reading_processes
from nets.weights import load_weights
from warp_caustics.errors import DamagedDataError, InputError, MismatchError, ResourceError
from warp_caustics.scene import Scene

CPU = torch.device("cpu")
COUNT = 60


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "updater"
    photons = PhotonConfig(n_photons=64**2)
    config = DatasetConfig(
        kind="updater", n_samples=COUNT, samples_per_shard=20, noisy=photons, clean=photons,
        scene=Scene(height_samples=16, image_pixels=64),
    )  # fmt: skip
    build(folder, config, make_sampler, devices=["cpu"])
    return str(folder), config


def positions(sampler, steps):
    iterator = iter(sampler)
    return [next(iterator) for _ in range(steps)]


def test_every_epoch_takes_every_sample_once_in_a_new_order():
    ranks = [StepSampler(24, 2, seed=3, rank=rank, world=3) for rank in range(3)]
    assert ranks[0].steps_per_epoch == 4
    drawn = [positions(sampler, 8) for sampler in ranks]
    epochs = [[i for rank in drawn for step in rank[first : first + 4] for i in step] for first in (0, 4)]
    assert sorted(epochs[0]) == sorted(epochs[1]) == list(range(24))
    assert epochs[0] != epochs[1]


@pytest.mark.parametrize("first", [1, 4, 5, 11])
def test_a_later_start_goes_on_where_the_other_was(first):
    straight, resumed = StepSampler(24, 5, seed=1), StepSampler(24, 5, seed=1)
    resumed.first = first
    assert positions(resumed, 9) == positions(straight, first + 9)[first:]


@pytest.mark.parametrize("workers", [0, 1])
def test_batches_hold_the_samples_of_the_data_set(dataset, tiny_run, workers):
    folder, config = dataset
    run = tiny_run("updater", data=folder, data_workers=workers)
    source = FileSource(run, CPU)
    straight = [source.batch(step) for step in range(2)]
    source.resume(1)
    again = source.batch(1)
    assert all(torch.equal(again[name], straight[1][name]) for name in again)
    chosen = positions(source.sampler, 1)[0]
    source.sampler.first = 0
    chosen = positions(source.sampler, 1)[0]
    ids = [int(source.training_set.ids[k]) for k in chosen]
    assert not any(map(is_validation, ids))
    expected, _ = UpdaterSampler(config, "cpu").draw_tensors(ids)
    for name, values in expected.items():
        tolerance = 2e-3 if name in ("target", "simulated") else 1e-6  # images are stored as float16
        assert torch.allclose(straight[0][name], values, rtol=tolerance, atol=tolerance), name
        assert straight[0][name].dtype == torch.float32
    validation = source.validation()
    assert sum(len(batch["heights"]) for batch in validation) == min(4, sum(map(is_validation, range(COUNT))))
    source.close()


def failing(error):
    raise error
    yield


def as_a_worker_tells_it(error):
    """What torch makes of an error in a process of its loader."""
    try:
        raise error
    except type(error):
        told = ExceptionWrapper(where="in DataLoader worker process 0")
    try:
        told.reraise()
    except type(error) as again:
        return again


def test_damage_that_a_reading_process_finds_is_told_in_one_line(dataset, tiny_run):
    source = FileSource(tiny_run("updater", data=dataset[0], data_workers=0), CPU)
    source.resume(0)
    told = as_a_worker_tells_it(DamagedDataError("'00000.h5', sample 1: cannot be read (broken); build again"))
    assert "Traceback" in str(told)
    source.batches = failing(told)
    with pytest.raises(DamagedDataError) as caught:
        source.batch(0)
    assert str(caught.value) == "'00000.h5', sample 1: cannot be read (broken); build again"


def test_a_reading_process_that_was_killed_is_no_bug(dataset, tiny_run):
    source = FileSource(tiny_run("updater", data=dataset[0], data_workers=0), CPU)
    source.resume(0)
    source.batches = failing(RuntimeError("DataLoader worker (pid 7) is killed by signal: Killed. "))
    with pytest.raises(ResourceError, match=r"want of memory; .*--set training\.data_workers=0$"):
        source.batch(0)
    source.batches = failing(RuntimeError("something else"))
    with pytest.raises(RuntimeError, match="something else"):
        source.batch(0)


def test_half_of_the_cores_read_files(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: range(12), raising=False)
    assert [reading_processes(None, world) for world in (1, 2, 8)] == [6, 3, 2]
    assert reading_processes(0, 1) == 0 and reading_processes(20, 4) == 20
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: range(128), raising=False)
    assert reading_processes(None, 2) == 8


@pytest.mark.parametrize("kind", ["updater", "direct"])
def test_a_run_on_files_resumes_exactly(dataset, tiny_run, train, tmp_path, kind):
    run = tiny_run(kind, data=dataset[0], data_workers=0, batch_size=8, total_steps=8, log_every_steps=1)
    result = train(run, tmp_path / "straight")
    for stop in (3, 6, None):
        train(run, tmp_path / "parts", max_steps=stop, resume=stop != 3)
    states = [torch.load(tmp_path / n / "checkpoints/last.ckpt", weights_only=True) for n in ("straight", "parts")]
    assert all(torch.equal(states[0]["network"][name], value) for name, value in states[1]["network"].items())
    assert states[0]["stopping"] == states[1]["stopping"] and states[0]["stopping"]["epoch"] > 0
    assert load_weights(result.weights).info.data_fingerprint == data_fingerprint(dataset[0])


def test_a_data_set_of_another_kind_or_scene_is_refused(dataset, tiny_run):
    with pytest.raises(MismatchError, match="is for the updater, denoiser training needs"):
        FileSource(tiny_run("denoiser", data=dataset[0]), CPU)
    run = tiny_run("updater", data=dataset[0])
    other = run.model_copy(update={"scene": run.scene.model_copy(update={"base_thickness_m": 4e-3})})
    with pytest.raises(MismatchError, match="another scene"):
        FileSource(other, CPU)
    with pytest.raises(InputError, match="build more than"):
        FileSource(tiny_run("updater", data=dataset[0], batch_size=100), CPU)
