"""Work in several processes: all of it is done, each sees one GPU, and what goes wrong is told."""

import os

import pytest

from nets.evaluation.processes import VISIBLE, check_jobs, gpus_for, in_processes
from warp_caustics.errors import InputError, ResourceError


def nothing():
    pass


def seen(item):
    return item, os.environ.get(VISIBLE)


def killed(item):
    os._exit(9)


def test_all_is_done_and_gpus_are_taken_in_turn():
    done = dict(in_processes(range(12), seen, nothing, 3, ("5", "7")))
    assert {item: result[0] for item, result in done.items()} == {item: item for item in range(12)}
    assert {result[1] for result in done.values()} <= {"5", "7"}


def test_without_gpus_processes_see_what_this_one_does(monkeypatch):
    monkeypatch.setenv(VISIBLE, "3")
    assert {result[1] for _, result in in_processes(range(3), seen, nothing, 2)} == {"3"}


def test_a_process_that_is_killed():
    with pytest.raises(ResourceError, match="a process was killed, perhaps for lack of memory; continue with fewer"):
        list(in_processes(range(2), killed, nothing, 2))


@pytest.mark.parametrize("jobs", [0, -1, 65])
def test_numbers_that_nobody_means(jobs):
    with pytest.raises(InputError, match=f"{jobs} jobs; give 1 to 64"):
        check_jobs(jobs)


def test_which_gpus(monkeypatch):
    monkeypatch.setattr("torch.cuda.device_count", lambda: 2)
    monkeypatch.delenv(VISIBLE, raising=False)
    assert gpus_for("cuda") == gpus_for("auto") == ["0", "1"]
    assert gpus_for("cuda:1") == gpus_for("cpu") == []
    monkeypatch.setenv(VISIBLE, "GPU-ab, 4")
    assert gpus_for("cuda") == ["GPU-ab", "4"]
    monkeypatch.setenv(VISIBLE, "")
    assert gpus_for("cuda") == []
