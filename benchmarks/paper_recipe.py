"""The paper's updater trained as printed, its ablations beside it, several seeds of each: one table.

    python -m benchmarks.paper_recipe train -o FOLDER [--device cuda] [--networks full-0 no-gradient-2] [--within 1500]
    python -m benchmarks.paper_recipe judge -o FOLDER [--device cuda] --json benchmarks/paper_recipes.json
    python -m benchmarks.paper_recipe table --json benchmarks/paper_recipes.json

Single steps from perturbed reliefs, Tab. 2's networks, Adam at Tab. 2's rate to the end, 90,000 samples an epoch, an
end after three epochs without progress (sections 2.1 and 2.2). All networks of a process learn side by side from the
same pool, because a sample takes longer to simulate than to learn from; each draws its own batches of it. A second
`train` goes on where the first ended; networks of two GPUs have two folders. `judge` makes ten iterations from flat on
the ten development fields, with the weights of the best epoch.

What differs from the print: images that are seen are a lattice's, simulated ones have few photons with the noise of
Tab. 1's 1e6 (docs/data.md), networks compute in bfloat16, and gradients are cut at a length of 1.
"""

import argparse
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.learned import Fields, iterations
from benchmarks.paper_samples import BATCH, Options, Pool, Samples
from nets.architecture import build
from nets.shipped import FOLDER as SHIPPED
from nets.training.batch import Batch
from nets.training.config import RunConfig, default_run
from nets.training.devices import autocast
from nets.training.keys import step_seed
from nets.training.optimisation import clip_gradients, make_optimiser
from nets.training.state import EarlyStopping
from nets.training.tasks import UpdaterTask
from nets.training.weights import export_weights
from warp_caustics.errors import InputError

DENOISER = SHIPPED / "denoiser.safetensors"
EPOCH_SAMPLES = 90_000
"""Nine tenths of 100,000; the other tenth would judge."""
PATIENCE = 3
RECORD_STEPS = 200
SAVED_STEPS = 1000
"""Between states that are written, for a training that ends without a word."""
VARIANTS = {
    "full": ("paper-updater", True),
    "no denoiser": ("paper-updater", False),
    "no gradient": ("paper-updater-no-gradient", True),
}
"""Network, and whether simulated images are denoised."""
NETWORKS = {f"{variant}-{seed}".replace(" ", "-"): (variant, seed) for seed in range(3) for variant in VARIANTS}
"""Variant and seed of each network by its name."""


def run_of(variant: str, seed: int, options: Options) -> RunConfig:
    """The training of one network."""
    preset, is_denoised = VARIANTS[variant]
    tree = default_run("updater", preset)
    denoiser = str(DENOISER) if is_denoised else None
    tree["training"] |= {
        "seed": seed,
        "batch_size": BATCH,
        "clip_norm": 1.0,
        "precision": "bf16" if options.device.startswith("cuda") else "32",
        "steps_per_epoch": max(1, options.epoch // BATCH),
        "compile": options.compile,
        "denoiser_weights": denoiser,
        "noisy": tree["training"]["noisy"] | {"traced": options.traced},
        "clean": {"preset": "lattice"},
    }
    return RunConfig.model_validate(tree)


def as_seen(batch: Batch, variant: str) -> Batch:
    """A batch as the networks of a variant are given it."""
    is_denoised = VARIANTS[variant][1]
    shown = {name: batch[name] for name in ("heights", "start", "target")}
    names = ("denoised", "gradient") if is_denoised else ("noisy", "raw_gradient")
    return shown | {"simulated": batch[names[0]], "gradient": batch[names[1]]}


class Learner:
    """One network, its optimiser and how it did."""

    def __init__(self, variant: str, seed: int, options: Options):
        self.variant, self.seed = variant, seed
        self.name = next(name for name, of in NETWORKS.items() if of == (variant, seed))
        self.config = run_of(variant, seed, options)
        self.device = torch.device(options.device)
        torch.manual_seed(step_seed(seed, "weights", 0))
        self.network = build(self.config.network, self.config.scene).to(self.device)
        self.network = self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimiser = make_optimiser(self.network, self.config.training, self.device)
        self.task = UpdaterTask(self.config, self.device)
        self.called: Any = torch.compile(self.network) if options.compile else self.network
        self.losses: list[float] = []
        self.epochs: list[dict[str, float]] = []
        self.best: dict[str, torch.Tensor] | None = None
        self._sum, self._count = torch.zeros((), device=self.device), 0
        self._norm = torch.zeros((), device=self.device)

    @property
    def stopping(self) -> EarlyStopping:
        """What its epochs say of going on."""
        stopping = EarlyStopping(PATIENCE, 0)
        for epoch in self.epochs:
            stopping.saw(epoch["val_loss"])
        return stopping

    @property
    def is_done(self) -> bool:
        """Whether it went so many epochs without progress."""
        return self.stopping.should_stop

    def model(self, *args: Any) -> Any:
        """The network as it learns."""
        with autocast(self.config.training.precision, self.device):
            return self.called(*args)

    @torch.no_grad()
    def measures(self, batches: list[Batch]) -> dict[str, float]:
        """How well it does on validation batches."""

        def judged(*args: Any) -> Any:
            with autocast(self.config.training.precision, self.device):
                return self.network(*args)

        return self.task.measures(judged, [as_seen(batch, self.variant) for batch in batches])

    def end_epoch(self, batches: list[Batch]) -> None:
        """Judge, and keep the weights if they are the best."""
        self.epochs.append(self.measures(batches))
        if self.stopping.best_epoch == len(self.epochs):
            self.best = {name: values.clone() for name, values in self.network.state_dict().items()}

    def learn(self, batch: Batch, step: int) -> None:
        """One step of Adam."""
        loss = self.task.loss(self.model, as_seen(batch, self.variant), step, 0.0)
        loss.backward()
        clip_gradients(self.network, self.config.training, self._norm)
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)
        self._sum += loss.detach()
        self._count += 1
        if (step + 1) % RECORD_STEPS == 0:
            self.losses.append(round(float(self._sum) / self._count, 5))
            self._sum.zero_()
            self._count = 0

    def state(self) -> dict[str, Any]:
        return {
            "network": self.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "losses": self.losses,
            "epochs": self.epochs,
            "best": self.best,
        }

    def restore(self, state: dict[str, Any]) -> None:
        self.network.load_state_dict(state["network"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.losses, self.epochs = list(state["losses"]), list(state["epochs"])
        self.best = state["best"]


def train(folder: Path, networks: Sequence[str], options: Options, within_s: float, epochs: int) -> None:
    """Train, or go on, and write states, weights and the record of each network."""
    started = time.monotonic()
    device = torch.device(options.device)
    torch.backends.cudnn.benchmark = torch.backends.cudnn.allow_tf32 = True
    torch._dynamo.config.recompile_limit = 4 * len(networks)
    folder.mkdir(parents=True, exist_ok=True)
    learners = [Learner(*NETWORKS[name], options) for name in networks]
    step, before = _restored(folder, learners)
    config = run_of("full", 0, options)
    pool = Pool(Samples(config, device), options, device)
    judging = Samples(config, device, is_validation=True)
    batches = [judging(range(k, min(k + BATCH, options.validation))) for k in range(0, options.validation, BATCH)]
    pool.fill(step + pool.slots // 4)
    steps_per_epoch = config.training.steps_per_epoch
    print(f"{len(learners)} networks from step {step}, {time.monotonic() - started:.0f} s to prepare", flush=True)
    begun = time.monotonic()
    while step < epochs * steps_per_epoch and time.monotonic() - started < within_s:
        if all(learner.is_done for learner in learners):
            break
        pool.fill(step + 1 + pool.slots // 4)
        for learner in learners:
            if not learner.is_done:
                learner.learn(pool.batch(step, step_seed(learner.seed, learner.variant, 0)), step)
        step += 1
        if step % steps_per_epoch == 0:
            for learner in learners:
                if not learner.is_done:
                    learner.end_epoch(batches)
        if step % RECORD_STEPS == 0:
            losses = " ".join(f"{learner.losses[-1]:.3f}" for learner in learners if learner.losses)
            print(f"step {step}, {time.monotonic() - begun:.0f} s, loss {losses}", flush=True)
        if step % SAVED_STEPS == 0:
            _save(folder, learners, step, before + time.monotonic() - begun)
    for samples in (pool.samples, judging):
        samples.strokes.close()
    seconds = before + time.monotonic() - begun
    _save(folder, learners, step, seconds)
    _write(folder, learners, step, seconds, options, batches)


def _save(folder: Path, learners: Sequence[Learner], step: int, seconds: float) -> None:
    """States from which all go on; a second of them is whole before the first is replaced."""
    for learner in learners:
        torch.save(learner.state() | {"step": step, "seconds": seconds}, folder / f"{learner.name}.pt.new")
    for learner in learners:
        (folder / f"{learner.name}.pt.new").replace(folder / f"{learner.name}.pt")


def _restored(folder: Path, learners: Sequence[Learner]) -> tuple[int, float]:
    """Step and seconds that the states in a folder are of; 0 where there is none.

    Raises:
        InputError: states of some of the networks, or of different steps: they learn side by side.
    """
    states = {
        learner.name: torch.load(path, map_location=learner.device, weights_only=False)
        for learner in learners
        if (path := folder / f"{learner.name}.pt").exists()
    }
    if not states:
        return 0, 0.0
    steps = sorted({state["step"] for state in states.values()})
    if len(states) < len(learners) or len(steps) > 1:
        raise InputError(
            f"{folder} has states of {len(states)} of {len(learners)} networks, of steps {steps}; networks that learn "
            "side by side go on together: choose the same --networks, or another folder"
        )
    for learner in learners:
        learner.restore(states[learner.name])
    return steps[0], states[learners[0].name]["seconds"]


def _write(
    folder: Path, learners: Sequence[Learner], step: int, seconds: float, options: Options, batches: list[Batch]
) -> None:
    for learner in learners:
        at_end = learner.measures(batches)
        if learner.best is not None:
            learner.network.load_state_dict(learner.best)
        if torch.isfinite(torch.cat([p.detach().flatten() for p in learner.network.parameters()])).all():
            told = {"kind": "updater", "steps": step, "batch": BATCH}
            export_weights(folder / f"{learner.name}.safetensors", learner.network, learner.config, told)
        steps = len(learner.epochs) * learner.config.training.steps_per_epoch if learner.is_done else step
        record = {
            "variant": learner.variant,
            "seed": learner.seed,
            "steps": steps,
            "visits": steps * BATCH,
            "different_samples": min(steps * options.fresh, options.epoch),
            "side_by_side": len(learners),
            "seconds": round(seconds, 1),
            "device": torch.cuda.get_device_name(learner.device) if learner.device.type == "cuda" else "cpu",
            "ended": "by three epochs without progress" if learner.is_done else "by time",
            "weights_of_epoch": learner.stopping.best_epoch or None,
            "at_end": {name: round(value, 5) for name, value in at_end.items() if math.isfinite(value)},
            "epochs": [{name: round(value, 5) for name, value in epoch.items()} for epoch in learner.epochs],
            "loss_median": round(float(np.median(learner.losses)), 4) if learner.losses else None,
            "loss_largest": max(learner.losses, default=None),
        }
        (folder / f"{learner.name}.json").write_text(json.dumps(record, indent=1) + "\n")
        print(f"{learner.name:16} step {steps} " + ", ".join(f"{k} {v:.4g}" for k, v in at_end.items()), flush=True)


def judge(folder: Path, device: str, fields: int, count: int, out: Path) -> None:
    """Ten iterations from flat on the development fields, with each network of a folder; kept in a JSON file."""
    held = json.loads(out.read_text()) if out.exists() else {}
    shown = Fields(fields, None, device)
    denoiser = str(DENOISER)
    for path in sorted(folder.glob("*.json")):
        record, weights = json.loads(path.read_text()), path.with_suffix(".safetensors")
        if "variant" not in record or not weights.exists():
            continue
        chosen: dict[str, Any] = {"weights": str(weights)}
        if record["variant"] == "no denoiser":
            chosen["denoise"] = False
        else:
            chosen["denoiser_weights"] = denoiser
        if record["variant"] == "no gradient":
            chosen["use_gradient"] = False
        ((_, errors),) = iterations(shown, {path.stem: chosen}, count)
        held[path.stem] = record | {"iterations_um": np.round(errors, 2).tolist()}
        out.write_text(json.dumps(held, indent=1) + "\n")
        print(f"{path.stem:16}" + "".join(f"{error:7.1f}" for error in errors.mean(0)), flush=True)


def table(held: dict[str, Any]) -> str:
    """Mean error [um] at each iteration, mean over seeds and their range; a row a variant."""
    count = max(len(each["iterations_um"][0]) for each in held.values())
    lines = [
        "| trained as printed | seeds | " + " | ".join(str(k) for k in range(1, count)) + " |",
        "|---|---|" + "---|" * (count - 1),
    ]
    for variant in VARIANTS:
        rows = [np.mean(each["iterations_um"], axis=0) for each in held.values() if each["variant"] == variant]
        if not rows:
            continue
        low, high = np.min(rows, axis=0), np.max(rows, axis=0)
        cells = [f"{a:.0f} to {b:.0f}" if len(rows) > 1 else f"{a:.0f}" for a, b in zip(low, high, strict=True)]
        lines.append(f"| {variant} | {len(rows)} | " + " | ".join(cells[1:]) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("train", "judge", "table"))
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--networks", nargs="+", choices=tuple(NETWORKS), default=list(NETWORKS))
    parser.add_argument("--within", type=float, default=1e9, help="seconds, preparation and all")
    parser.add_argument("--epochs", type=int, default=10**6)
    parser.add_argument("--epoch-samples", type=int, default=EPOCH_SAMPLES)
    parser.add_argument("--fresh-per-step", type=int, default=8)
    parser.add_argument("--pool", type=int, default=2048)
    parser.add_argument("--validation", type=int, default=128)
    parser.add_argument("--traced", type=int, default=200_000)
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--fields", type=int, default=10)
    parser.add_argument("--iterations", type=int, default=10)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    if given.output is None and given.what != "table":
        parser.error("give the folder of the networks, -o FOLDER")
    if given.json is None and given.what != "train":
        parser.error("give the file of the figures, --json FILE")
    if given.what == "table":
        print(table(json.loads(given.json.read_text())))
    elif given.what == "judge":
        judge(given.output, given.device, given.fields, given.iterations, given.json)
    else:
        options = Options(
            given.device,
            given.epoch_samples,
            given.fresh_per_step,
            given.pool,
            given.validation,
            given.compile,
            given.traced,
        )
        train(given.output, given.networks, options, given.within, given.epochs)


if __name__ == "__main__":
    main()
