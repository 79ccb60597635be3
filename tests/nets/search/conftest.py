"""A search of 16 heights and 64 pixels, and objectives that take no time."""

import sys
from pathlib import Path

import pytest

from nets.search.config import SearchConfig
from nets.search.study import Address, address, open_study
from nets.search.worker import Goal, Worker
from nets.training.config import default_run
from tests.memory_folder import memory_folder


def _tiny_search(kind="denoiser", *, scene=None, max_epochs=9, sampler="tpe", trial_time_s=None, data=None, **training):
    tree = default_run(kind)
    tree["scene"] |= {"height_samples": 16, "image_pixels": 64, **(scene or {})}
    tree["data"] = data
    tree["training"] |= {"batch_size": 2, "fixed_samples": 4, "steps_per_epoch": 2, **training}
    return SearchConfig.model_validate(
        {"run": tree, "max_epochs": max_epochs, "sampler": sampler, "trial_time_s": trial_time_s}
    )


@pytest.fixture
def tiny_search():
    return _tiny_search


@pytest.fixture
def tmp_path(tmp_path):
    """SQLite waits for the disk some hundred times in a small search."""
    with memory_folder(tmp_path) as folder:
        yield folder


@pytest.fixture
def where(tmp_path) -> Address:
    return address(None, tmp_path, "study")


@pytest.fixture
def dummies(monkeypatch):
    """Module of objectives that a spawned process can import."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    import search_dummies

    yield search_dummies
    sys.modules.pop("search_dummies")


@pytest.fixture
def work(where, tmp_path):
    """Runs trials in this process; returns the study."""

    def call(objective, n_trials, *, search=None, deadline=None, name="me", seed=0):
        study = open_study(where, search or _tiny_search(), seed)
        goal = Goal(n_trials, deadline)
        options = {"folder": tmp_path, "grace_s": 180, "after_trial": lambda study: None}
        Worker(study, objective, goal, name=name, seed=seed, **options).run()
        return study

    return call
