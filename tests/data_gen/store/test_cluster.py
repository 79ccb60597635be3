"""Building with Dask."""

import builtins
import os
import signal
import socket

import pytest
from store_synthetic import factory, make_config, shard_bytes, temporaries

from data_gen.store import build_on_cluster, verify
from data_gen.store.lock import BuildLock
from data_gen.store.supervise import WorkerError
from warp_caustics.errors import DamagedDataError, InputError, MismatchError, ResourceError

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster():
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


def test_cluster_of_two_workers_one_killed(folder, reference, cluster, tmp_path):
    killed = []

    def kill_one(state):
        if state.done >= 8 and not killed:
            killed.append(next(iter(cluster.workers.values())).pid)
            os.kill(killed[0], signal.SIGKILL)

    scheduler_file = tmp_path / "scheduler.json"
    scheduler_file.write_text(distributed.scheduler.json.dumps(cluster.scheduler.identity()))
    report = build_on_cluster(folder, make_config(), factory(pause_s=0.03), str(scheduler_file), progress=kill_one)
    assert killed and report.shards_built == 10
    assert shard_bytes(folder) == shard_bytes(reference) and not temporaries(folder)
    assert (folder / "COMPLETE.json").read_bytes() == (reference / "COMPLETE.json").read_bytes()
    assert verify(folder).problems == ()


def test_resume_on_a_cluster_makes_only_what_is_missing(copied, reference, cluster, tmp_path):
    (copied / "shards" / "00003.h5").unlink()
    sampler = factory(log=str(tmp_path / "log"))
    report = build_on_cluster(copied, make_config(), sampler, cluster.scheduler_address)
    assert report.shards_built == 1 and (tmp_path / "log").read_text() == "12\n"
    assert shard_bytes(copied) == shard_bytes(reference)
    with BuildLock(copied / ".lock"), pytest.raises(MismatchError, match=f"process {os.getpid()}"):
        build_on_cluster(copied, make_config(), sampler, cluster.scheduler_address)


def test_exception_of_a_task_comes_back(folder, cluster):
    with pytest.raises(WorkerError, match="shard 4: ValueError: the glass is too thin"):
        build_on_cluster(folder, make_config(), factory(trouble="raise", at=17), cluster.scheduler_address)
    with pytest.raises(InputError, match="sample 17: heights has 1 of 64 values"):
        build_on_cluster(folder, make_config(), factory(trouble="nan", at=17), cluster.scheduler_address)


@pytest.mark.slow
def test_shard_that_kills_its_workers_is_named(folder, cluster):
    with pytest.raises(DamagedDataError, match="1 of 10 shards could not be made.*shard 4"):
        build_on_cluster(folder, make_config(), factory(trouble="kill", at=17), cluster.scheduler_address)
    assert len(shard_bytes(folder)) == 9


def test_nobody_there(folder):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{unused.getsockname()[1]}"
        with pytest.raises(ResourceError, match="no scheduler answers at 'tcp:"):
            build_on_cluster(folder, make_config(), factory(), address, timeout_s=1.0)
    with pytest.raises(InputError, match="'scheduler.jso' is neither the address"):
        build_on_cluster(folder, make_config(), factory(), "scheduler.jso")


def test_missing_package_names_the_extra(folder, monkeypatch):
    def without(name, *arguments, **options):
        if name == "distributed":
            raise ImportError(name)
        return real(name, *arguments, **options)

    real = builtins.__import__
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"nsfc\[cluster\]"):
        build_on_cluster(folder, make_config(), factory(), "tcp://127.0.0.1:1")
