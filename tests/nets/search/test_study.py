"""The database of trials: whose it is, what is queued again, what is refused."""

import builtins
import datetime

import optuna
import pytest
from optuna.trial import TrialState

from nets.config import RANGES, Range
from nets.search import study as study_module
from nets.search.config import SearchConfig, trial_run
from nets.search.space import best_of_paper
from nets.search.study import RETRIES, abandon, address, count, make_pruner, open_study, queue_best_of_paper, reap
from nets.training.config import default_run
from warp_caustics.errors import DamagedDataError, InputError, MismatchError, ResourceError


def begun(study, worker=None):
    trial = study.ask()
    trial.suggest_float("x", 0, 1)
    if worker is not None:
        trial.set_user_attr("worker", worker)
    return trial


def test_the_same_search_is_loaded_and_another_one_refused(where, tiny_search, monkeypatch):
    open_study(where, tiny_search()).ask()
    assert len(open_study(where, tiny_search(sampler="gp", trial_time_s=3.0)).trials) == 1
    others = [
        (tiny_search("updater"), r"kind 'denoiser' there, 'updater' here"),
        (tiny_search(scene={"image_pixels": 32}), r"scene\.image_pixels 64 there, 32 here"),
        (tiny_search(steps_per_epoch=3), r"training\.steps_per_epoch 2 there, 3 here"),
        (tiny_search(max_epochs=10), r"max_epochs 9 there, 10 here"),
        (tiny_search(seed=5, batch_size=3, fixed_samples=7, accumulate=2), r"here and 1 more; repeat its command"),
    ]
    for other, message in others:
        with pytest.raises(MismatchError, match=message):
            open_study(where, other)
    monkeypatch.setitem(RANGES, "c_init", Range(1, 31))
    with pytest.raises(MismatchError, match=r"ranges\.c_init 'between 1 and 32' there, 'between 1 and 31' here"):
        open_study(where, tiny_search())


def test_values_of_a_trial_become_its_run(tiny_search):
    run = trial_run(tiny_search("updater"), best_of_paper("updater"), 30)
    assert (run.training.learning_rate, run.training.lambda_tv, run.training.total_steps) == (0.005155, 9.81e-10, 30)
    assert run.network.network.k_dec == 4 and run.scene.image_pixels == 64
    run = trial_run(tiny_search(), {**best_of_paper("denoiser"), "c_init": 7, "learning_rate": 0.05}, 1)
    assert (run.network.network.c_init, run.training.learning_rate, run.training.lambda_tv) == (7, 0.05, 0.0)


def test_searches_that_make_no_sense():
    with pytest.raises(ValueError, match="a direct network has no numbers of Tab. 2"):
        SearchConfig(run=default_run("direct"))
    with pytest.raises(ValueError, match="greater than or equal to 5"):
        SearchConfig(run=default_run("denoiser"), max_epochs=4)
    with pytest.raises(ValueError, match="initial_weights fit one network only"):
        SearchConfig(run={**default_run("denoiser"), "initial_weights": "w"})


@pytest.mark.parametrize("url", ["journal:///x", "postgres", "mongodb://me:secret@host/x", "/tmp/file.log", ""])
def test_other_databases_are_refused(tmp_path, url):
    with pytest.raises(InputError, match="is not supported; write postgresql") as caught:
        address(url, tmp_path, "s")
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("url", "installed", "driver"),
    [
        ("postgresql://me:secret@host/x", {"psycopg", "psycopg2"}, "postgresql+psycopg"),
        ("postgresql://me:secret@host/x", {"psycopg2"}, "postgresql+psycopg2"),
        ("postgresql+asyncpg://me:secret@host/x", {"psycopg"}, "postgresql+asyncpg"),
        ("postgresql://me:secret@host/x", set(), "postgresql"),
        ("mysql://me:secret@host/x", {"MySQLdb"}, "mysql+mysqldb"),
    ],
)
def test_the_driver_that_is_installed_is_taken(tmp_path, monkeypatch, url, installed, driver):
    """SQLAlchemy 2.1 takes psycopg where 2.0 took psycopg2; either will do."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name if name in installed else None)
    where = address(url, tmp_path, "s")
    assert where.url == url.replace(url.partition(":")[0], driver)


def test_passwords_are_not_shown(tmp_path):
    assert "secret" not in address("postgresql://me:secret@host/x", tmp_path, "s").shown


def test_a_missing_driver_a_broken_file_and_a_missing_folder(tmp_path, where, tiny_search, monkeypatch):
    imported = builtins.__import__

    def without(name, *arguments, **options):
        is_relative = len(arguments) > 3 and arguments[3] > 0  # SQLAlchemy has a module of that name
        if name.startswith("psycopg") and not is_relative:
            raise ImportError(name)
        return imported(name, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(builtins, "__import__", without)
        with pytest.raises(InputError, match="no Python package for 'postgresql' is installed; pip install"):
            open_study(address("postgresql://me:secret@localhost/x", tmp_path, "s"), tiny_search())
    (tmp_path / "study.db").write_bytes(b"no database at all " * 100)
    with pytest.raises(DamagedDataError, match="cannot be read"):
        open_study(where, tiny_search())
    with pytest.raises(ResourceError, match="does not answer"):
        open_study(address(f"sqlite:///{tmp_path}/none/x.db", tmp_path, "s"), tiny_search())


def test_gp_says_what_it_needs(where, tiny_search, monkeypatch):
    imported = builtins.__import__

    def without(name, *arguments, **options):
        if name.startswith("scipy"):
            raise ImportError(f"No module named {name!r}", name="scipy")
        return imported(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match="sampler 'gp' needs scipy; pip install scipy, or use --sampler tpe"):
        open_study(where, tiny_search(sampler="gp"))


def test_gp_proposes(where, tiny_search, work):
    study = work(lambda trial: trial.suggest_float("x", 0, 1), 12, search=tiny_search(sampler="gp"))
    assert isinstance(study.sampler, optuna.samplers.GPSampler) and count(study).complete == 12


def test_a_trial_is_queued_again_twice(where, tiny_search):
    study = open_study(where, tiny_search())
    values = []
    for attempt in range(RETRIES + 1):
        trial = begun(study, "a")
        trial.report(1.0, 1)
        trial.storage.set_trial_system_attr(trial._trial_id, "completed_rung_0", 0.5)
        values.append(trial.params["x"])
        assert abandon(study, "b") == 0 and abandon(study, "a") == 1 and abandon(study, "a") == 0
        assert count(study).waiting == (attempt < RETRIES)
    assert len(set(values)) == 1
    counts = count(study)
    assert (counts.failed, counts.retried, counts.finished) == (1, 2, 1)
    assert [trial.number for trial in study.trials] == [0, 1, 2]
    # What the dead one had reached is no result of the next, or Hyperband would count it twice.
    assert "completed_rung_0" not in study.trials[2].system_attrs or study.trials[2].state == TrialState.FAIL


def test_a_queued_trial_starts_anew(where, tiny_search):
    study = open_study(where, tiny_search())
    trial = begun(study, "a")
    trial.report(1.0, 1)
    study._storage.set_trial_system_attr(trial._trial_id, "completed_rung_0", 0.5)
    abandon(study, "a")
    waiting = study.trials[1]
    assert waiting.state == TrialState.WAITING and waiting.params == trial.params
    assert waiting.user_attrs == {} and waiting.intermediate_values == {}
    assert waiting.system_attrs == {"failed_trial": 0, "retry_history": [0]}


def test_silent_workers_are_found(tmp_path, where, tiny_search, monkeypatch):
    study = open_study(where, tiny_search())
    begun(study)  # died before it could sign: Optuna would let it run for ever
    assert reap(study, 100.0) == 0

    real = datetime.datetime

    class Later(datetime.datetime):
        @classmethod
        def now(cls, tz=None):
            return real.now(tz) + datetime.timedelta(seconds=101)

    monkeypatch.setattr(study_module.datetime, "datetime", Later)
    begun(study, "signed")
    assert reap(study, 100.0) == 1
    assert [trial.state.name for trial in study.trials] == ["FAIL", "RUNNING", "WAITING"]


def test_no_trial_is_pruned_before_its_fifth_epoch(where, tiny_search):
    search = tiny_search(max_epochs=45)
    pruner = make_pruner(search)
    study = optuna.create_study(pruner=pruner, sampler=optuna.samplers.RandomSampler(0))
    ends = []
    for number in range(30):
        trial = study.ask()
        for epoch in range(1, 46):
            trial.report(float(number), epoch)
            if epoch == 45 or trial.should_prune():
                break
        ends.append(epoch)
        study.tell(trial, float(number) if epoch == 45 else None, state=None if epoch == 45 else TrialState.PRUNED)
    assert min(ends) == 5 and ends[0] == 45 and len(set(ends)) > 2


def test_the_papers_best_comes_first(where, tiny_search):
    search = tiny_search()
    study = open_study(where, search)
    queue_best_of_paper(study, search)
    queue_best_of_paper(study, search)
    assert len(study.trials) == 1
    from nets.search.space import suggested

    assert suggested(study.ask(), "denoiser") == best_of_paper("denoiser")
