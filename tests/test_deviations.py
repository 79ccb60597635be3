"""The page of deviations from the paper's tables names what is really so."""

import re
from pathlib import Path

from cli.config import load_config
from nets.shipped import shipped_weights
from nets.training.config import default_run
from nets.weights import weights_info

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "deviations.md").read_text(encoding="utf-8")


def test_it_is_linked_and_its_files_exist():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert "(deviations.md)" in index and "\ndeviations\n" in index
    assert "(docs/deviations.md)" in (ROOT / "README.md").read_text(encoding="utf-8")
    for name in re.findall(r"`((?:configs|nets|benchmarks)/[\w./-]+)`", PAGE):
        assert (ROOT / name).exists(), name
    for number in (1, 2, 3):
        assert f"## Table {number}" in PAGE


def test_what_ships_was_trained_as_it_says():
    """Without patience, on pools of fresh samples, with targets from a lattice and second legs of 0.0025."""
    for word in ("patience=null", "training.replay", "clean.preset=lattice", "0.0025", "own_share", "residual", "TPE"):
        assert word in PAGE, word
    found = {path.stem: weights_info(path) for path in shipped_weights()}
    trainings = {name: info.training["config"] for name, info in found.items()}
    assert all(training["patience"] is None for training in trainings.values())
    assert all(training["replay"]["size"] > 0 for training in trainings.values())
    updaters = [training for name, training in trainings.items() if name.startswith("updater")]
    assert len(updaters) == 3
    for training in updaters:
        assert training["clean"]["preset"] == "lattice" and training["learning_rate"] == 0.0025
        assert training["replay"]["own_share"] > 0
    assert found["denoiser"].architecture.is_residual
    steps = found["updater"].training["steps"]
    assert "12,000" in PAGE and steps * trainings["updater"]["replay"]["fresh_per_step"] == 12_000


def test_defaults_differ_where_it_says():
    assert load_config(None, ()).simulation.preset == "lattice"
    training = default_run("updater")["training"]
    assert (training["patience"], training["min_epochs"], training["noisy"]["preset"]) == (3, 5, "paper")
