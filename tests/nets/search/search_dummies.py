"""Objectives for spawned workers."""

import multiprocessing
import os
import time

from nets.search import figures
from nets.search.space import suggested
from warp_caustics.errors import InputError


def without_pictures():
    """Pages of this process have none, which take it longer than all else; not where other tests run."""
    if multiprocessing.parent_process() is None:
        return
    for name in ("history", "curves", "slices", "parallel"):
        setattr(figures, name, lambda *trials: None)
    figures.importances = lambda study: ({}, None)


def quick(search, device, deadline):
    """Each trial takes 0.4 s and tells which process it is in."""
    without_pictures()

    def objective(trial):
        trial.set_user_attr("pid", os.getpid())
        values = suggested(trial, search.kind)
        for epoch in range(1, 5):
            time.sleep(0.1)
            trial.report(values["learning_rate"], epoch)
        return values["learning_rate"]

    return objective


def impossible(search, device, deadline):
    """No worker gets as far as a trial."""
    raise InputError("no samples; build some")


def deadly(search, device, deadline):
    """Every trial ends its process."""

    def objective(trial):
        suggested(trial, search.kind)
        os.kill(os.getpid(), 9)

    return objective
