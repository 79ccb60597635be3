"""Training end to end, seconds on a CPU."""

import math

import pytest
import torch

import nets.training.fit as fit_module
from nets.symmetries import transformed
from nets.training.devices import Stopwatch
from nets.training.fresh import FreshSource
from nets.training.losses import psnr_db, relief_loss, total_variation, update_loss
from nets.training.optimisation import WeightAverage, clip_gradients, learning_rate
from nets.training.origin import commit
from nets.training.record import read_metrics, write_sample
from nets.training.task import Sample
from nets.training.tasks import make_task
from nets.training.unrolling import UnrolledTask, unrolled_steps
from nets.unrolling_config import UnrollingConfig
from nets.weights import load_weights
from warp_caustics.errors import InputError, MismatchError

CPU = torch.device("cpu")
KINDS = ("denoiser", "updater", "direct", "unrolled")
OFF = {"symmetries": False}


@pytest.mark.parametrize("kind", KINDS)
def test_three_steps_of_each_kind(kind, tiny_run, train, tmp_path, watcher):
    config = tiny_run(kind, total_steps=3, steps_per_epoch=2, log_every_steps=1)
    result = train(config, tmp_path / "run", watcher=watcher)
    assert (result.stop_reason, result.step) == ("finished", 3)
    rows = read_metrics(tmp_path / "run")
    losses = [float(row["loss"]) for row in rows if row["loss"]]
    assert len(losses) == 3 and all(map(math.isfinite, losses))
    measured = [row for row in rows if row["is_best"]]
    assert [row["step"] for row in measured] == ["2", "3"]  # an epoch, and the end of the run
    assert all(math.isfinite(float(row["val_psnr_db" if kind == "denoiser" else "val_rmse_um"])) for row in measured)
    loaded = load_weights(result.weights, scene=config.scene)
    assert loaded.info.architecture == config.network
    assert watcher.seen[-1].is_validation and watcher.seen[-1].share == 1.0
    assert not watcher.warnings


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_learns_four_plates_by_heart(kind, tiny_run):
    config = tiny_run(
        kind, augmentation=OFF, camera=None, unrolling={"last_steps": 2, "start": {"flat": 1, "perturbed": 0}}
    )
    torch.manual_seed(0)
    from nets.architecture import build

    network, source = build(config.network, config.scene), FreshSource(config, CPU)
    batch, task = source.batch(0), make_task(config, CPU, 0, Stopwatch(CPU))
    source.close()
    optimiser = torch.optim.Adam(network.parameters(), 1e-2)
    losses = []
    for _ in range(30):
        optimiser.zero_grad()
        loss = task.loss(network, batch, 0, 1.0)
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < {"updater": 0.9}.get(kind, 0.75) * losses[0], losses


def test_the_run_folder_and_its_pictures(tiny_run, train, tmp_path):
    train(tiny_run("direct", total_steps=2, steps_per_epoch=2), tmp_path / "run", pictures=True)
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == {"checkpoints", "metrics.csv", "pictures", "weights.safetensors"}
    (picture,) = (tmp_path / "run" / "pictures").iterdir()
    assert picture.name == "step-00000002.png" and picture.stat().st_size > 5000


def test_a_picture_shows_the_difference(tmp_path, tiny_run):
    truth = torch.zeros(16, 16)
    scene = tiny_run("direct").scene
    same = write_sample(tmp_path / "a.png", Sample(torch.ones(3, 64, 64), truth, truth, True), scene, "x")
    wrong = write_sample(tmp_path / "b.png", Sample(torch.ones(3, 64, 64), truth, truth + 1e-4, True), scene, "x")
    # 100 um too high everywhere is the red end of the colour bar.
    red = [int((abs(pixels.astype(int) - (103, 0, 31)).sum(axis=2) < 6).sum()) for pixels in (same, wrong)]
    assert red[0] < 1000 < 10_000 < red[1], red


def test_exported_weights_are_those_of_the_best_epoch(tiny_run, train, tmp_path, monkeypatch):
    scores = iter([3.0, 1.0, 2.0])
    monkeypatch.setattr("nets.training.tasks.DirectTask.measures", lambda *arguments: {"val_rmse_um": next(scores)})
    result = train(tiny_run("direct", ema_decay=0.5), tmp_path / "run")
    info = load_weights(result.weights).info
    assert result.best == 1.0 and info.training["steps"] == 8 and info.training["best"] == 1.0
    last = torch.load(tmp_path / "run/checkpoints/last.ckpt", weights_only=True)
    exported, averaged = load_weights(result.weights).module.state_dict(), last["average"]
    assert all(torch.equal(exported[name], value) for name, value in last["best_weights"].items())
    assert any(not torch.equal(exported[name], value) for name, value in averaged.items())


def test_early_stopping_ends_the_run(tiny_run, train, tmp_path, monkeypatch):
    scores = iter([3.0, 1.0, 2.0, math.nan, 2.0, 0.0])
    monkeypatch.setattr("nets.training.tasks.DirectTask.measures", lambda *arguments: {"val_rmse_um": next(scores)})
    config = tiny_run("direct", patience=3, total_steps=100, steps_per_epoch=1)
    result = train(config, tmp_path / "run")
    assert (result.stop_reason, result.step, result.best) == ("early_stopping", 5, 1.0)


class Clock:
    now_s = 1000.0

    def monotonic(self):
        return self.now_s


@pytest.fixture
def clock(monkeypatch):
    """Time of which every step takes a tenth of a second: no test depends on the speed of its machine."""
    clock, step = Clock(), fit_module._Loop._step

    def slow_step(loop):
        step(loop)
        clock.now_s += 0.1

    monkeypatch.setattr(fit_module, "time", clock)
    monkeypatch.setattr(fit_module._Loop, "_step", slow_step)
    return clock


def test_a_deadline_ends_the_command_and_defines_the_run(tiny_run, train, tmp_path, monkeypatch, clock):
    monkeypatch.setattr("nets.training.limits.FINAL_SECONDS", 0.0)
    config = tiny_run("direct", total_steps=None, schedule="cosine", log_every_steps=1)
    result = train(config, tmp_path / "run", deadline=clock.now_s + 3)
    assert result.stop_reason == "finished" and 29 <= result.step <= 31
    rates = [float(row["learning_rate"]) for row in read_metrics(tmp_path / "run") if row["learning_rate"]]
    assert rates == sorted(rates, reverse=True) and rates[-1] < 0.3 * rates[0]


def test_a_deadline_leaves_a_run_of_given_length_unfinished(tiny_run, train, tmp_path, monkeypatch, clock):
    monkeypatch.setattr("nets.training.limits.FINAL_SECONDS", 0.0)
    config = tiny_run("direct", total_steps=10**6)
    result = train(config, tmp_path / "run", deadline=clock.now_s + 2)
    assert result.stop_reason == "max_time" and 19 <= result.step <= 21


def test_the_time_of_a_command_counts_from_its_first_step(tiny_run, train, tmp_path, monkeypatch, clock):
    """On a busy machine the preparation took longer than the time that was given, and no step was made."""
    monkeypatch.setattr("nets.training.limits.FINAL_SECONDS", 0.0)
    prepare = fit_module._Loop.prepare

    def slow(loop, *arguments):
        prepare(loop, *arguments)
        clock.now_s += 1000

    monkeypatch.setattr(fit_module._Loop, "prepare", slow)
    config = tiny_run("direct", total_steps=10**6)
    result = train(config, tmp_path / "run", max_time_s=2)
    assert result.stop_reason == "max_time" and 19 <= result.step <= 21


def test_one_step_is_made_however_short_the_time(tiny_run, train, tmp_path, clock):
    for total_steps in (10**6, None):
        result = train(tiny_run("direct", total_steps=total_steps), tmp_path / f"run{total_steps}", max_time_s=1e-3)
        assert result.step >= 1 and result.weights is not None


def test_no_weights_and_no_checkpoint_without_a_step(tiny_run, train, tmp_path, clock):
    folder = tmp_path / "run"
    result = train(tiny_run("direct", total_steps=10**6), folder, deadline=clock.now_s - 1)
    assert (result.step, result.weights, result.stop_reason) == (0, None, "max_time")
    assert not (folder / "weights.safetensors").exists() and not list(folder.glob("checkpoints/*"))


def test_a_loss_that_is_no_number_is_an_error(tiny_run, train, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "nets.training.tasks.DirectTask.loss",
        lambda self, model, batch, *arguments: model(batch["image"]).sum() * math.nan,
    )
    with pytest.raises(InputError, match="loss is nan at step 2; lower training.learning_rate"):
        train(tiny_run("direct"), tmp_path / "run")
    assert not (tmp_path / "run/checkpoints/last.ckpt").exists()


def test_starting_from_weights(tiny_run, train, tmp_path):
    first = train(tiny_run("direct", total_steps=4), tmp_path / "first")
    config = tiny_run("direct", total_steps=1, learning_rate=1e-9)
    second = train(config.model_copy(update={"initial_weights": first.weights}), tmp_path / "second")
    before, after = (load_weights(result.weights).module.state_dict() for result in (first, second))
    assert all(torch.allclose(before[name], value, atol=1e-6) for name, value in after.items())
    infos = [load_weights(result.weights).info for result in (first, second)]
    assert "initial_weights" not in infos[0].training
    assert infos[1].training["initial_weights"] == infos[0].content_hash
    assert infos[0].training["reliefs"]["line_count"] == [2, 30], "ranges of its reliefs"
    made = infos[0].training["origin"]
    assert made["licence"] == "MIT" and made["device"] and made["devices"] == 1 and made["date"].startswith("2")
    assert made["commit"] == commit()
    third = train(config.model_copy(update={"initial_weights": second.weights}), tmp_path / "third-leg")
    legs = load_weights(third.weights).info.training["legs_before"]
    assert [leg["content_hash"] for leg in legs] == [info.content_hash for info in infos]
    assert [leg["config"]["learning_rate"] for leg in legs] == [
        info.training["config"]["learning_rate"] for info in infos
    ]
    assert all(leg["origin"] and leg["steps"] and leg["data_fingerprint"] for leg in legs)
    other = tiny_run("direct", network={"encoding": {"log_floor": 0.05}})
    with pytest.raises(MismatchError, match="another architecture"):
        train(other.model_copy(update={"initial_weights": first.weights}), tmp_path / "third")


def test_unrolled_from_a_direct_network(tiny_run, train, tmp_path):
    first = train(tiny_run("direct", total_steps=4), tmp_path / "direct")
    unrolling = {"direct_weights": first.weights, "start": {"flat": 0.0, "perturbed": 0.0, "direct": 1.0}}
    config = tiny_run("unrolled", total_steps=1, unrolling=unrolling, validation={"count": 4, "noise": 0.0})
    task = UnrolledTask(config, CPU, 0, Stopwatch(CPU))
    batch = FreshSource(config, CPU).batch(0)
    expected = load_weights(first.weights).module(batch["image"])
    assert torch.equal(task._start(batch, batch["image"], 0), expected)
    warm = config.model_copy(update={"initial_weights": first.weights})
    warmed = train(warm, tmp_path / "warm")
    assert warmed.step == 1
    record = load_weights(warmed.weights).info.training
    assert record["config"]["unrolling"]["direct_weights"] == "weights.safetensors", "without its folder"


def test_shares_of_the_starts(tiny_run):
    config = tiny_run("unrolled", unrolling={"start": {"flat": 0.25, "perturbed": 0.75, "direct": 0.0}})
    task = UnrolledTask(config, CPU, 0, Stopwatch(CPU))
    batch = {"start": torch.ones(400, 16, 16)}
    share = float(task._start(batch, torch.zeros(400, 3, 64, 64), 0).mean())
    assert abs(share - 0.75) < 0.07


@pytest.mark.parametrize("through", [False, True])
def test_steps_are_cut_off_from_each_other_unless_asked(tiny_run, through):
    """What the first step does changes the second step's loss; only with through_steps it learns from that."""
    config = tiny_run(
        "unrolled", slope_weight=0.0, network={"hidden_channels": 0}, augmentation=OFF, camera=None,
        unrolling={"first_steps": 2, "last_steps": 2, "through_steps": through, "start": {"flat": 1, "perturbed": 0}},
    )  # fmt: skip
    task, source = UnrolledTask(config, CPU, 0, Stopwatch(CPU)), FreshSource(config, CPU)
    batch = source.batch(0)
    source.close()
    first = torch.zeros(4, 16, 16, requires_grad=True)

    def model(target, simulated, heights, gradient, hidden, number):
        from nets.unrolled_net import Update

        return Update(heights + first, None) if number == 0 else Update(2 * heights, None)

    task.loss(model, batch, 0, 1.0).backward()
    n = first.numel()
    sign = -torch.sign(batch["heights"])  # of first - truth at first = 0; bowed plates lie on both sides of it
    one = sign * 1e3 / n / 2.5
    # The second step weighs 1.5 and doubles what it is given.
    assert torch.allclose(first.grad, one * (1 + 2 * 1.5) if through else one, rtol=1e-4)


@pytest.mark.parametrize(
    ("progress", "steps"), [(0.0, 1), (0.12, 1), (0.13, 2), (0.26, 3), (0.49, 4), (0.5, 4), (1, 4)]
)
def test_the_number_of_steps_grows(progress, steps):
    assert unrolled_steps(UnrollingConfig(), progress) == steps


def test_a_gradient_that_leaps_is_cut_to_what_is_usual(tiny_run):
    """Four times the running mean; the mean follows slowly, and numbers that are none leave it alone."""
    training = tiny_run("direct", clip_norm=1.0, clip_spikes=4.0).training
    network, mean = torch.nn.Linear(3, 1, bias=False), torch.zeros(())

    def clipped(norm):
        network.weight.grad = torch.tensor([[norm, 0.0, 0.0]])
        clip_gradients(network, training, mean)
        return float(network.weight.grad.norm())

    assert [clipped(0.01) for _ in range(3)] == pytest.approx([0.01] * 3)
    assert clipped(0.9) == pytest.approx(0.04, rel=1e-3) and float(mean) == pytest.approx(0.01 * 1.06, rel=1e-3)
    assert clipped(float("inf")) != clipped(0.01) and float(mean) < 0.011
    for _ in range(500):
        clipped(0.5)
    assert clipped(0.5) == pytest.approx(0.5) and clipped(3.0) == pytest.approx(1.0), "clip_norm holds besides"
    plain = training.model_copy(update={"clip_norm": None, "clip_spikes": None})
    network.weight.grad = torch.full((1, 3), 7.0)
    clip_gradients(network, plain, mean)
    assert (network.weight.grad == 7.0).all()


def test_learning_rate_over_a_run(tiny_run):
    training = tiny_run("direct", schedule="cosine", warmup_steps=10, learning_rate=1.0, final_rate=0.1).training
    assert learning_rate(training, 0, 0.0) == 0.1
    assert learning_rate(training, 9, 0.0) == 1.0
    assert math.isclose(learning_rate(training, 100, 0.5), 0.55)
    assert math.isclose(learning_rate(training, 100, 1.0), 0.1)
    assert math.isclose(learning_rate(training, 100, 1.7), 0.1)
    assert learning_rate(tiny_run("denoiser").training, 10**6, 1.0) == 0.00151


def test_weight_average():
    network = torch.nn.Linear(1, 1, bias=False)
    network.weight.data.fill_(0.0)
    average = WeightAverage(network, 0.5)
    network.weight.data.fill_(1.0)
    average.update(0)  # decay min(0.5, 1 / 10)
    assert math.isclose(average.network.weight.item(), 0.9, rel_tol=1e-6)
    network.weight.data.fill_(0.0)
    average.update(100)
    assert math.isclose(average.network.weight.item(), 0.45, rel_tol=1e-6)
    assert network.weight.item() == 0.0 and not average.network.weight.requires_grad


def test_losses_in_closed_form():
    truth = torch.zeros(2, 4, 4)
    ramp = torch.arange(4.0).expand(2, 4, 4) * 1e-3  # 1 mm per sample along x
    assert math.isclose(relief_loss(ramp, truth, (2e-3, 1e-3), 0.1), 1.5 + 0.1 * 0.25, rel_tol=1e-6)
    assert math.isclose(total_variation(ramp), 12.0, rel_tol=1e-6)
    assert math.isclose(update_loss(ramp, truth, "squared", 0.01), 3.5 + 0.12, rel_tol=1e-6)
    assert math.isclose(update_loss(ramp, truth, "absolute", 0.0), 1.5, rel_tol=1e-6)
    image = torch.full((1, 2, 4, 4), 0.1)
    assert torch.allclose(psnr_db(image, torch.zeros_like(image), 1.0), torch.full((1, 2), 20.0))


def test_symmetries_turn_a_whole_batch_of_training(tiny_run):
    config = tiny_run("updater", augmentation={"symmetries": True})
    task = make_task(config, CPU, 0, Stopwatch(CPU))
    source = FreshSource(config, CPU)
    batch = source.batch(0)
    source.close()
    turned = task.turned(batch, 3)
    matches = [
        [
            all(torch.allclose(transformed(v[i : i + 1], s), turned[n][i : i + 1]) for n, v in batch.items())
            for s in (torch.tensor([[k & 1], [k >> 1 & 1], [k >> 2 & 1]], dtype=torch.bool) for k in range(8))
        ]
        for i in range(4)
    ]
    assert all(sum(row) == 1 for row in matches)
    assert len({row.index(True) for row in matches}) > 1


def test_what_it_does_is_told_from_the_first_moment(tiny_run, train, tmp_path, watcher):
    """Validation samples before the first step, every step, and how much is left."""
    train(tiny_run("direct"), tmp_path / "run", watcher=watcher)
    whats = [what for what, _, _ in watcher.stages]
    assert whats[0] == "making validation samples" and watcher.stages[0][1:] == (0, 4)
    assert whats.index("first step") < whats.index("validating")
    assert [step for step, _, _ in watcher.ticks] == list(range(1, 13))
    shares = [share for _, share, _ in watcher.ticks]
    assert shares == sorted(shares) and shares[-1] == 1 and watcher.ticks[-1][2] == 0
    assert all(left >= 0 for _, _, left in watcher.ticks)


def test_the_nearest_end_tells_what_is_left():
    from nets.training.progress import ahead

    assert ahead(10.0, []) == (None, None)
    assert ahead(10.0, [(0, 5, 20), (100, 110, 120)]) == (0.5, 10.0)
    assert ahead(3.0, [(0, 30, 20)]) == (1.0, 0.0)
