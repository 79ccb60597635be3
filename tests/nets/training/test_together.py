"""Several processes decide together when a training ends.

Here each is a thread with a clock of its own, and what they send each other is a queue: if one ends and the other goes
on, that one finds it at its next step and fails. Nothing depends on the speed of the machine.
"""

import contextlib
import queue
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

import nets.training.fit as fit_module
from nets.training.fit import AGREE_EVERY_STEPS
from nets.training.fresh import FreshSource
from nets.training.limits import Limits

ENDED = "ended"


class Process:
    """What the loop needs of Fabric: here for one of two threads."""

    world_size, device = 2, torch.device("cpu")

    def __init__(self, rank, inbox, outbox):
        self.global_rank, self.is_global_zero = rank, rank == 0
        self.inbox, self.outbox = inbox, outbox

    def swap(self, what, value=None):
        """The other's value, once it has come to the same point."""
        self.outbox.put((what, value))
        other, theirs = self.inbox.get(timeout=60)
        assert other == what, f"process {self.global_rank} is at {what!r} and waits for ever: the other is at {other!r}"
        return theirs

    def broadcast(self, value):
        theirs = self.swap("broadcast", value)
        return value if self.is_global_zero else theirs

    def all_reduce(self, value, reduce_op):
        assert reduce_op == "mean"
        return (value + self.swap("all_reduce", value)) / 2

    def setup_module(self, module):
        return module


class Batches:
    """The same validation batch for both; no step asks for one."""

    steps_per_epoch = 25

    def __init__(self, batch):
        self.batches = [batch]

    def resume(self, number):
        pass

    def validation(self, told):
        return self.batches

    def close(self):
        pass


class Clocks:
    """Times that pass at another rate in each thread."""

    def __init__(self):
        self.here = threading.local()

    def monotonic(self):
        return self.here.now_s


@pytest.fixture
def together(tiny_run, watcher, monkeypatch):
    """Runs two loops side by side; returns their results.

    Args:
        seconds: that a step takes by the clock of each.
        limits: of the command.
        signals: step at which each gets SIGTERM, or None.
        training: of the run.
    """
    clocks = Clocks()
    monkeypatch.setattr(fit_module, "time", clocks)
    monkeypatch.setattr("nets.training.limits.FINAL_SECONDS", 0.0)

    def run(seconds, limits, signals=(None, None), **training):
        config = tiny_run("direct", **{"total_steps": 10**6, "log_every_steps": 7, **training})
        source = FreshSource(config, torch.device("cpu"))
        batches = Batches(source.batch(0))
        source.close()
        boxes = queue.Queue(), queue.Queue()

        def step(loop):
            loop.fabric.swap("gradient")
            loop.state.step += 1
            rank = loop.fabric.global_rank
            clocks.here.now_s += seconds[rank]
            if signals[rank] == loop.state.step:
                loop.stop(signal.SIGTERM, lambda: None)

        def process(rank):
            clocks.here.now_s = 1000.0 * (rank + 1)
            fabric = Process(rank, boxes[rank], boxes[1 - rank])
            loop = fit_module._Loop(config, None, fabric, watcher, limits)
            with contextlib.closing(loop):
                loop.prepare(False, batches)
                try:
                    return loop.run()
                finally:
                    fabric.outbox.put((ENDED, None))

        monkeypatch.setattr(fit_module._Loop, "_step", step)
        with ThreadPoolExecutor(2) as threads:
            return [future.result() for future in [threads.submit(process, rank) for rank in (0, 1)]]

    return run


@pytest.mark.parametrize("seconds", [(0.1, 1.0), (0.1, 0.01)], ids=["second clock faster", "second clock slower"])
@pytest.mark.parametrize("total_steps", [10**6, None], ids=["limit", "length of the run"])
def test_time_is_up_for_both_at_once(together, seconds, total_steps):
    """By the clock of the first, looked at every tenth step: 20 steps take 2 s, 30 steps 3 s."""
    results = together(seconds, Limits(max_time_s=2.45), total_steps=total_steps)
    assert [result.step for result in results] == [30, 30] and AGREE_EVERY_STEPS == 10
    assert {result.stop_reason for result in results} == {"max_time" if total_steps else "finished"}
    assert [result.elapsed_s for result in results] == pytest.approx([3.0, 3.0])


@pytest.mark.parametrize(("signals", "step"), [((13, 13), 20), ((13, 21), 20), ((13, None), 20)])
def test_a_signal_ends_both_at_once(together, signals, step):
    """Launchers send it to each process, at whatever step that is."""
    results = together((0.1, 0.1), Limits(), signals)
    assert [(result.step, result.stop_reason) for result in results] == [(step, "terminated")] * 2


def test_what_one_measures_counts_for_both(together, monkeypatch):
    """Early stopping: each alone would see another error."""
    scores = {0: iter([3.0, 2.0, 2.5, 2.5]), 1: iter([1.0, 0.9, 0.8, 0.7])}
    monkeypatch.setattr(
        "nets.training.tasks.DirectTask.measures",
        lambda self, *arguments: {"val_rmse_um": next(scores[self.rank])},
    )
    results = together((0.1, 0.1), Limits(), patience=2, min_epochs=1)
    assert [(result.step, result.stop_reason, result.best) for result in results] == [(100, "early_stopping", 2.0)] * 2
