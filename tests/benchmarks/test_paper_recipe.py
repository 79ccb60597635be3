"""The paper's recipe with its ablations: what each network is given, when it ends, and the table."""

import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from benchmarks.paper_recipe import VARIANTS, Learner, _restored, as_seen, run_of, table
from benchmarks.paper_samples import BATCH, Options, Pool
from warp_caustics.errors import InputError

ROOT = Path(__file__).parents[2]
OPTIONS = Options("cpu", 90_000, 8, 32, 4, False, 200_000)


@pytest.mark.parametrize("variant", VARIANTS)
def test_it_is_trained_as_printed(variant):
    run = run_of(variant, 3, OPTIONS)
    training = run.training
    assert (training.optimiser, training.learning_rate, training.schedule) == ("adam", 0.005155, "constant")
    assert training.ema_decay == 0 and training.lambda_tv == pytest.approx(9.81e-10)
    assert training.steps_per_epoch * training.batch_size == 90_000 and training.seed == 3
    assert (training.denoiser_weights is None) == (variant == "no denoiser")
    assert run.network.use_gradient == (variant != "no gradient")
    assert training.replay.own_share == 0 and not training.augmentation.symmetries


def test_each_network_is_given_what_its_ablation_leaves():
    names = ("heights", "start", "target", "noisy", "denoised", "gradient", "raw_gradient")
    batch = {name: torch.full((1,), float(number)) for number, name in enumerate(names)}
    full, raw = as_seen(batch, "full"), as_seen(batch, "no denoiser")
    assert full["simulated"] is batch["denoised"] and full["gradient"] is batch["gradient"]
    assert raw["simulated"] is batch["noisy"] and raw["gradient"] is batch["raw_gradient"]
    assert as_seen(batch, "no gradient")["simulated"] is batch["denoised"]


@pytest.mark.parametrize(
    ("losses", "is_done"),
    [([], False), ([3, 2, 1, 1.1], False), ([1, 2, 2, 2], True), ([3, 1, 2, 2, 0.9], False), ([3, 1, 2, 2, 1], True)],
)
def test_three_epochs_without_progress_are_the_end(losses, is_done):
    learner = Learner("full", 0, OPTIONS)
    learner.epochs = [{"val_loss": loss} for loss in losses]
    assert learner.is_done == is_done


def test_the_weights_of_the_best_epoch_are_kept(monkeypatch):
    learner = Learner("no gradient", 1, OPTIONS)
    assert learner.name == "no-gradient-1" and learner.best is None
    parameter = next(learner.network.parameters())
    for number, loss in enumerate((0.3, 0.2, math.nan, 0.4)):
        torch.nn.init.constant_(parameter, number)
        monkeypatch.setattr(learner, "measures", lambda _, loss=loss: {"val_loss": loss})
        learner.end_epoch([])
    assert learner.stopping.best_epoch == 2
    assert torch.equal(next(iter(learner.best.values())), torch.ones_like(parameter))
    again = Learner("no gradient", 1, OPTIONS)
    again.restore(learner.state())
    assert torch.equal(next(iter(again.best.values())), torch.ones_like(parameter)) and not again.is_done


def test_an_epoch_has_its_own_samples_and_the_next_has_the_same():
    pool = Pool(None, OPTIONS._replace(epoch=80), torch.device("cpu"))
    rounds = [pool.ids(number) for number in range(20)]
    assert sorted(sample for ids in rounds[:10] for sample in ids) == list(range(80))
    assert rounds[10:] == rounds[:10]


def test_a_pool_keeps_the_last_and_each_network_draws_its_own():
    made = []

    def samples(ids, following):
        made.append(ids)
        assert next(iter(following))[0] == ids.stop % 80
        return {"target": torch.full((8, 1), float(ids.start)), "start": torch.tensor(list(ids), dtype=torch.float32)}

    pool = Pool(samples, OPTIONS._replace(epoch=80), torch.device("cpu"))
    pool.fill(7)
    assert [ids.start for ids in made] == [24, 32, 40, 48], "those that would be replaced are not made"
    assert pool.kept["target"].dtype == torch.float16 and pool.kept["start"].dtype == torch.float32
    batch, again, other = pool.batch(5, 1), pool.batch(5, 1), pool.batch(5, 2)
    assert batch["start"].shape == (BATCH,) and set(batch["start"].tolist()) <= set(range(24, 56))
    assert torch.equal(batch["start"], again["start"]) and not torch.equal(batch["start"], other["start"])


def test_the_table_shows_the_range_over_seeds():
    held = {
        f"full-{seed}": {"variant": "full", "iterations_um": [[400.0, 200.0 + seed, 180.0], [200.0, 100.0, 80.0]]}
        for seed in (0, 20)
    }
    held["no-gradient-0"] = {"variant": "no gradient", "iterations_um": [[400.0, 160.0, 150.0]]}
    lines = table(held).splitlines()
    assert lines[2] == "| full | 2 | 150 to 160 | 130 to 130 |"
    assert lines[3] == "| no gradient | 1 | 160 | 150 |" and len(lines) == 4


def test_networks_that_learn_side_by_side_go_on_together(tmp_path):
    restored = []
    learners = [
        SimpleNamespace(
            name=name, device="cpu", restore=lambda state, name=name: restored.append((name, state["step"]))
        )
        for name in ("full-0", "no-denoiser-0")
    ]
    assert _restored(tmp_path, learners) == (0, 0.0)
    torch.save({"step": 40, "seconds": 5.0}, tmp_path / "full-0.pt")
    with pytest.raises(InputError, match="1 of 2 networks"):
        _restored(tmp_path, learners)
    torch.save({"step": 41, "seconds": 5.0}, tmp_path / "no-denoiser-0.pt")
    with pytest.raises(InputError, match=r"steps \[40, 41\]"):
        _restored(tmp_path, learners)
    assert not restored
    torch.save({"step": 40, "seconds": 5.0}, tmp_path / "no-denoiser-0.pt")
    assert _restored(tmp_path, learners) == (40, 5.0)
    assert restored == [("full-0", 40), ("no-denoiser-0", 40)]


def test_the_table_of_trainings_to_their_end():
    """Its table is that of the stored trainings, each of which ended by the rule."""
    stored = json.loads((ROOT / "benchmarks" / "paper_recipe_full.json").read_text(encoding="utf-8"))
    words = (ROOT / "docs" / "learned.md").read_text(encoding="utf-8").replace("**", "")
    assert len(stored) == 3
    for seed, of in enumerate(stored.values()):
        assert of["seed"] == seed and of["ended"] == "by three epochs without progress"
        assert of["weights_of_epoch"] == len(of["epochs"]) - 3
        errors = ", ".join(f"{epoch['val_rmse_um']:.0f}" for epoch in of["epochs"])
        reached = np.mean(of["iterations_um"], axis=0)
        best = f"{of['weights_of_epoch']}{'rd' if of['weights_of_epoch'] == 3 else 'th'}"
        cells = " | ".join(f"{reached[k]:.0f}" for k in (1, 2, 3, 5, 10))
        assert f"| {seed} | {len(errors.split())} | {errors} | {best} | {cells} |" in words
