"""Workers that are killed."""

import os
import random
import signal
import threading
import time

import pytest
from optuna.trial import TrialState

from nets.search.processes import Plan, run_workers, sampler_seed
from nets.search.study import RETRIES, count, open_study, retried_numbers
from nets.search.worker import Goal
from warp_caustics.errors import ResourceError

KILLS = 2


def test_workers_are_killed_and_the_search_ends_as_if_not(where, tiny_search, tmp_path, dummies):
    """Two workers, eight trials; a random worker with a trial is killed twice."""
    search = tiny_search()
    study = open_study(where, search)
    killed, ended = [], threading.Event()

    def kill():
        chance = random.Random(0)
        while len(killed) < KILLS and not ended.is_set():
            time.sleep(0.1)
            running = [t for t in study.get_trials(states=(TrialState.RUNNING,)) if "pid" in t.user_attrs]
            victims = [t.user_attrs["pid"] for t in running if t.user_attrs["pid"] not in killed]
            if victims:
                killed.append(chance.choice(victims))
                os.kill(killed[-1], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        plan = Plan(where, search, Goal(8), tmp_path, make_objective=dummies.quick)
        run_workers(plan, ["cpu"] * 2, lambda study: None)
    finally:
        ended.set()
        killer.join()
    trials = open_study(where, search).trials
    assert len(killed) == KILLS
    assert [trial.number for trial in trials] == list(range(len(trials)))
    assert all(trial.state.is_finished() for trial in trials)
    again = retried_numbers(trials)
    assert len(again) == KILLS == sum(trial.state == TrialState.FAIL for trial in trials)
    assert max(len(trial.system_attrs.get("retry_history", [])) for trial in trials) <= RETRIES
    counts = count(study)
    assert (counts.finished, counts.running, counts.waiting) == (8, 0, 0)
    workers = {trial.user_attrs["worker"]: trial.user_attrs["sampler_seed"] for trial in trials}
    assert len(workers) >= 3 and len(set(workers.values())) == len(workers)
    for name in ("trials.csv", "best.yaml", "report.html"):
        assert (tmp_path / name).stat().st_size > 100


@pytest.mark.slow
def test_a_trial_that_kills_every_worker_is_given_up(where, tiny_search, tmp_path, dummies):
    plan = Plan(where, tiny_search(), Goal(1), tmp_path, make_objective=dummies.deadly)
    run_workers(plan, ["cpu"], lambda study: None)
    trials = open_study(where, tiny_search()).trials
    assert [trial.state for trial in trials] == [TrialState.FAIL] * (1 + RETRIES)


def test_workers_that_cannot_start_end_the_search(where, tiny_search, tmp_path, dummies):
    plan = Plan(where, tiny_search(), Goal(7), tmp_path, make_objective=dummies.impossible)
    with pytest.raises(ResourceError, match="all 1 workers ended, 7 trials are left; the first problem: no samples"):
        run_workers(plan, ["cpu"], lambda study: None)


def test_seeds_differ_by_place_time_and_study():
    seeds = {sampler_seed(seed, slot, trials) for seed in (0, 1) for slot in range(4) for trials in range(4)}
    assert len(seeds) == 32 and max(seeds) < 2**32
