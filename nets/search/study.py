"""The trials of all workers on all machines, in a database, and what becomes of those whose worker died.

A worker tells every minute that it is alive. Trials of one that has been silent
for three are marked failed and queued again, twice at most. SQLite serves the
processes of one machine; several machines share PostgreSQL or MySQL. Optuna's
journal file is not offered: one torn last line makes it unreadable.
"""

import datetime
import importlib.util
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
import sqlalchemy
from optuna.storages import RDBStorage, RetryHeartbeatStaleTrialCallback
from optuna.trial import FrozenTrial, TrialState

from nets.search.config import MIN_EPOCHS, SearchConfig, check_same, identity
from nets.search.space import best_of_paper
from warp_caustics.errors import CausticsError, DamagedDataError, InputError, ResourceError
from warp_caustics.io.atomic import reason
from warp_caustics.io.regular import IrregularFileError, require_regular

HEARTBEAT_S, GRACE_S, RETRIES = 60, 180, 2
DATABASES = ("sqlite", "postgresql", "mysql")
DRIVERS = {"postgresql": ("psycopg", "psycopg2"), "mysql": ("pymysql", "MySQLdb")}
"""Packages that talk to a database, the better first; SQLAlchemy's own choice changes with its version."""
LOCK_WAIT_S = 60
"""How long a process waits for SQLite's lock."""
FILE = "study.db"


@dataclass(frozen=True)
class Address:
    """Where a study is.

    Attributes:
        url: of the database; may hold a password, so never shown.
        name: of the study in it.
        heartbeat_s: how often a worker tells that it is alive.
        grace_s: silence after which its trial counts as failed.
    """

    url: str
    name: str
    heartbeat_s: int = HEARTBEAT_S
    grace_s: int = GRACE_S

    @property
    def shown(self) -> str:
        """The database for people, without the password."""
        return sqlalchemy.make_url(self.url).render_as_string(hide_password=True)


@dataclass(frozen=True)
class Counts:
    """Trials by their state; one that failed and was queued again counts in ``retried`` only."""

    complete: int = 0
    pruned: int = 0
    failed: int = 0
    retried: int = 0
    running: int = 0
    waiting: int = 0

    @property
    def finished(self) -> int:
        return self.complete + self.pruned + self.failed


def address(storage: str | None, folder: Path, name: str) -> Address:
    """Where a search keeps its trials.

    Args:
        storage: URL; a SQLite file in the folder if None.
        folder: of the search.
        name: of the study.

    Raises:
        InputError: no such kind of database.
    """
    if storage is None:
        url = sqlalchemy.URL.create("sqlite", database=str(folder.absolute() / FILE))
        return Address(url.render_as_string(hide_password=False), name)
    try:
        backend = sqlalchemy.make_url(storage).get_backend_name()
    except sqlalchemy.exc.ArgumentError:
        backend = storage.partition(":")[0]
    if backend not in DATABASES or "://" not in storage:
        # Not the whole value: it may hold a password.
        raise InputError(
            f"storage of kind {backend[:40]!r} is not supported; write postgresql://..., mysql://... or sqlite:///file"
        )
    return Address(_with_driver(storage), name)


def _with_driver(storage: str) -> str:
    """The URL with the driver that is installed, where it names none."""
    url = sqlalchemy.make_url(storage)
    backend = url.drivername
    for package in DRIVERS.get(backend, ()):
        if importlib.util.find_spec(package) is not None:
            driver = {"MySQLdb": "mysqldb"}.get(package, package)
            return url.set(drivername=f"{backend}+{driver}").render_as_string(hide_password=False)
    return storage


def open_study(where: Address, search: SearchConfig, seed: int = 0) -> optuna.Study:
    """The study, begun if there is none.

    Args:
        where: it is.
        search: what it searches.
        seed: of the sampler.

    Raises:
        MismatchError: it is of another search.
        InputError: a package is missing.
        DamagedDataError: the file is no database.
        ResourceError: the database does not answer.
    """
    optuna.logging.set_verbosity(optuna.logging.CRITICAL)
    sampler = make_sampler(search, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        with _readable(where):
            study = _opened(where, search, sampler)
            stored, wanted = study.user_attrs.get("identity"), identity(search)
            # Trials are read once here, so that damage shows before anything is begun.
            study.get_trials(deepcopy=False)
            if stored is None:
                study.set_user_attr("identity", wanted)
            else:
                check_same(stored, wanted, where.name)
    return study


def queue_best_of_paper(study: optuna.Study, search: SearchConfig) -> None:
    """Let a study that is new begin with Tab. 2's best member."""
    if not study.get_trials(deepcopy=False):
        study.enqueue_trial(best_of_paper(search.kind), user_attrs={"origin": "Tab. 2"})


def make_sampler(search: SearchConfig, seed: int) -> optuna.samplers.BaseSampler:
    """What proposes the trials.

    Raises:
        InputError: a package that it needs is missing.
    """
    seed %= 2**32
    if search.sampler == "tpe":
        return optuna.samplers.TPESampler(seed=seed)
    try:
        import scipy.optimize  # noqa: F401
        import torch  # noqa: F401

        return optuna.samplers.GPSampler(seed=seed)
    except ImportError as error:
        package = error.name or "a package"
        raise InputError(f"sampler 'gp' needs {package}; pip install {package}, or use --sampler tpe") from error


def make_pruner(search: SearchConfig) -> optuna.pruners.BasePruner:
    """Hyperband over epochs; no trial ends before the fifth."""
    return optuna.pruners.HyperbandPruner(min_resource=MIN_EPOCHS, max_resource=search.max_epochs)


def count(study: optuna.Study) -> Counts:
    """How far a study is."""
    trials = study.get_trials(deepcopy=False)
    again = retried_numbers(trials)
    numbers = {state: 0 for state in TrialState}
    for trial in trials:
        numbers[trial.state] += trial.number not in again
    return Counts(
        complete=numbers[TrialState.COMPLETE],
        pruned=numbers[TrialState.PRUNED],
        failed=numbers[TrialState.FAIL],
        retried=len(again),
        running=numbers[TrialState.RUNNING],
        waiting=numbers[TrialState.WAITING],
    )


def retried_numbers(trials: list[FrozenTrial]) -> set[int]:
    """Numbers of the trials that were queued again."""
    return {number for trial in trials for number in trial.system_attrs.get("retry_history", [])}


def retry(study: optuna.Study, trial: FrozenTrial) -> None:
    """Queue a failed trial again, unless it was twice.

    Its values are kept; what it reached, and who worked on it, is not.
    """
    trial.user_attrs = {key: value for key, value in trial.user_attrs.items() if key == "origin"}
    kept = ("failed_trial", "retry_history")
    trial.system_attrs = {key: value for key, value in trial.system_attrs.items() if key in kept}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        RetryHeartbeatStaleTrialCallback(max_retry=RETRIES)(study, trial)


def abandon(study: optuna.Study, worker: str) -> int:
    """Fail the running trials of a worker that works no more, and queue them again; returns how many."""
    running = study.get_trials(states=(TrialState.RUNNING,))
    mine = [trial for trial in running if trial.user_attrs.get("worker") == worker]
    return sum(_failed(study, trial) for trial in mine)


def reap(study: optuna.Study, grace_s: float) -> int:
    """Fail trials whose worker is silent, and queue them again; returns how many.

    Optuna sees to those that gave a sign of life at least once. One whose worker
    died in the moment between beginning it and signing it is found here.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        optuna.storages.fail_stale_trials(study)
    limit = datetime.datetime.now() - datetime.timedelta(seconds=grace_s)
    running = study.get_trials(states=(TrialState.RUNNING,))
    unsigned = [
        trial
        for trial in running
        if "worker" not in trial.user_attrs and trial.datetime_start is not None and trial.datetime_start < limit
    ]
    return sum(_failed(study, trial) for trial in unsigned)


def _failed(study: optuna.Study, trial: FrozenTrial) -> bool:
    try:
        study.tell(trial.number, state=TrialState.FAIL)
    except (ValueError, RuntimeError):
        return False  # another process was first
    retry(study, trial)
    return True


def _opened(where: Address, search: SearchConfig, sampler: optuna.samplers.BaseSampler) -> optuna.Study:
    options: dict[str, Any] = {}
    if where.url.startswith("sqlite"):
        database = sqlalchemy.make_url(where.url).database
        if database and os.path.exists(database):
            try:
                require_regular(database)
            except IrregularFileError as error:
                raise InputError(f"database {where.shown}: {error.strerror}; give a file") from error
        options["connect_args"] = {"timeout": LOCK_WAIT_S}
    else:
        options["pool_pre_ping"] = True
    try:
        storage = RDBStorage(
            where.url,
            engine_kwargs=options,
            heartbeat_interval=where.heartbeat_s,
            grace_period=where.grace_s,
            heartbeat_stale_trial_callback=retry,
        )
        return optuna.create_study(
            storage=storage,
            sampler=sampler,
            pruner=make_pruner(search),
            study_name=where.name,
            direction="minimize",
            load_if_exists=True,
        )
    except ImportError as error:
        raise InputError(
            f"no Python package for {sqlalchemy.make_url(where.url).get_backend_name()!r} is installed; "
            "pip install 'psycopg[binary]' (PostgreSQL) or PyMySQL (MySQL)"
        ) from error


@contextmanager
def _readable(where: Address) -> Iterator[None]:
    """Whatever a database that was damaged makes SQLAlchemy and Optuna raise, as an error that says so."""
    try:
        yield
    except CausticsError:
        raise
    except sqlalchemy.exc.OperationalError as error:
        why = reason(error.orig or error)
        raise ResourceError(f"database {where.shown} does not answer ({why}); check it") from error
    except (
        sqlalchemy.exc.SQLAlchemyError,
        optuna.exceptions.OptunaError,
        RuntimeError,
        LookupError,
        ValueError,
        TypeError,
        AttributeError,
        AssertionError,
    ) as error:
        raise DamagedDataError(
            f"database {where.shown} cannot be read ({reason(error)}); restore it, or begin another study"
        ) from error
