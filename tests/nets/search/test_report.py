"""What a person reads."""

import optuna
import pytest
import yaml

from nets.search import report
from nets.search.objective import guarded
from nets.search.report import best_text, budget, network_text, write_outputs
from nets.search.space import suggested
from warp_caustics.io.csv_table import CsvTable


def objective(trial):
    values = suggested(trial, "denoiser")
    if trial.number == 3:
        raise ValueError("<b>broken</b>, twice")
    if trial.number == 4:
        raise optuna.TrialPruned("too large: it would have 1e9 parameters")
    for epoch in range(1, 4):
        trial.report(values["learning_rate"] + 1 / epoch, epoch)
    trial.set_user_attr("steps", 6)
    trial.set_user_attr("parameters", 1234)
    return values["learning_rate"]


@pytest.fixture(scope="module")
def study():
    optuna.logging.set_verbosity(optuna.logging.CRITICAL)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=0))
    guard = guarded(objective)

    def signed(trial):
        trial.set_user_attr("worker", "me")
        return guard(trial)

    study.optimize(signed, n_trials=12, catch=(Exception,))
    return study


def test_all_files_are_written_and_agree(study, tiny_search, tmp_path):
    write_outputs(tmp_path, study, tiny_search(), is_last=True)
    rows = CsvTable(tmp_path / "trials.csv", ()).read()
    assert [row["state"] for row in rows].count("complete") == 10 and rows[3]["state"] == "fail"
    assert rows[3]["reason"] == "ValueError: <b>broken</b>, twice"
    assert float(rows[0]["learning_rate"]) == study.trials[0].params["learning_rate"]
    best = yaml.safe_load((tmp_path / "best.yaml").read_text())
    assert best["training"]["learning_rate"] == study.best_params["learning_rate"]
    assert best["training"]["total_steps"] == 6 and best["network"]["network"]["c_init"] == study.best_params["c_init"]
    numbers = yaml.safe_load((tmp_path / "network.yaml").read_text())
    assert numbers == {"denoiser": study.best_params}
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 5 and "Importance: learning_rate" in page
    assert page.count("<tr>") > 20 and "1,234" in page and "between 0.0001 and 0.1 (log)" in page
    assert "<b>broken" not in page
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".tmp")]


def test_the_learning_rate_is_found_to_matter(study):
    from nets.search.figures import importances

    shares, picture = importances(study)
    assert max(shares, key=shares.get) == "learning_rate" and picture[:4] == b"\x89PNG"
    assert sum(shares.values()) == pytest.approx(1)


def test_the_budget_counts_each_trial_once(study):
    found = budget(study)
    assert found["finished trials"] == "12" and found["complete"] == "10"
    assert found["pruned"] == "1, 1 of them too large" and found["failed"] == "1, besides 0 that were queued again"
    assert found["epochs"] == "30" and found["workers"] == "1"


def test_a_study_without_results_has_a_page_too(work, tiny_search, tmp_path):
    study = work(lambda trial: 1.0, 0)
    write_outputs(tmp_path, study, tiny_search(), is_last=True)
    assert not (tmp_path / "best.yaml").exists()
    assert "Search for a denoiser" in (tmp_path / "report.html").read_text()
    assert len((tmp_path / "trials.csv").read_text().splitlines()) == 1


def test_pages_are_drawn_seldom_but_for_the_last(study, tiny_search, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(report, "page", lambda *arguments: drawn.append(1) or "page")
    monkeypatch.setattr(report, "_drawn", {})
    clock = [100.0]

    def later():
        clock[0] += 0.5  # drawing takes half a second
        return clock[0]

    monkeypatch.setattr(report.time, "monotonic", later)
    for _ in range(10):
        write_outputs(tmp_path, study, tiny_search())
    assert len(drawn) == 1
    write_outputs(tmp_path, study, tiny_search(), is_last=True)
    assert len(drawn) == 2


def test_texts_name_the_trial(study, tiny_search):
    best = study.best_trial
    assert best_text(best, tiny_search()).startswith(
        f"# Trial {best.number} of a search: validation loss {best.value:.9g}."
    )
    assert "--set training.fixed_samples=0" in best_text(best, tiny_search())
    assert network_text(best, tiny_search()).splitlines()[1] == "denoiser:"
