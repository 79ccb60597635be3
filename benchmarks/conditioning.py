"""How a network is best told of its bench: by FiLM, by maps, by its picture alone, or not at all.

    python -m benchmarks.conditioning [--device cuda ...] [--variants film maps picture] [--time-each 240] [--json FILE]
    python -m benchmarks.conditioning --read benchmarks/conditioning.json

Each variant is trained on the family of ``configs/family.yaml``, from the same shipped weights that know one scene,
with the same samples, seeds and rates for the same time, each in a process of its own; several share a GPU, or take
one of ``--device`` each. ``nothing`` is told nothing in training either: its picture is moved by what the scene says.
Then each is judged on the same benches, which no training sees, with what is told as the training errs and keeps
silent, exactly, and not at all, and on the scene itself. ``start`` is what all begin with.

``--within`` shortens the trainings alike so that all is done within so many seconds; what else there is to do it knows
from ``start``, which comes first, alone, and so brings the kernels.
"""

import argparse
import json
import multiprocessing
import os
import re
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

ROOT = Path(__file__).parents[1]
SEED = 23
"""Of samples and of what is told; no training of shipped weights has it."""
JUDGED_SEED = 660_127
"""Of the benches and prints that judge."""
VARIANTS = ("film", "maps", "picture", "nothing")
START = "start"
LOOKS = {
    "exact": "told exactly",
    "told": "told with errors",
    "unknown": "nothing told",
    "default": "on the scene",
    "perfect": "perfect camera",
}
"""Of :meth:`nets.training.told_task.ToldTask.looks`, as they are printed."""
WARM_UP = 50
FORGETTING = 0.99
"""The average of the weights: a training of minutes is some hundred steps, and longer averages lag behind."""
LEAST_S = 20.0
"""A training below is none."""
GRACE_S = 20.0
"""After ``--within``, before what still runs is ended: the others' figures shall not be lost with it."""
NEVER = 10**9


class Options(NamedTuple):
    """Of all variants alike."""

    time_s: float | None
    """Of each training; None for ``steps``."""
    steps: int | None
    batch: int
    pool: int
    """Samples kept; see ``training.replay``."""
    fresh: int
    """New ones in each step."""
    benches: int
    """That judge."""
    rate: float
    compile: bool
    weights: str | None
    """That all start from; None for fresh ones."""


def run_of(variant: str, options: Options) -> Any:
    """The training of a variant, a :class:`nets.training.config.RunConfig`."""
    from nets.training.config import RunConfig, default_run

    tree = default_run("direct")
    family = yaml.safe_load((ROOT / "configs" / "family.yaml").read_text(encoding="utf-8"))
    # The first look alone: the second is one more simulation a sample, and the same for all.
    tree["network"] |= {"feedback": False, "told_by": variant if variant in VARIANTS[:3] else "picture"}
    tree["network"]["backbone"] |= family["network"]["backbone"]
    tree["training"] |= family["training"] | {
        "seed": SEED,
        "batch_size": options.batch,
        "total_time_s": options.time_s,
        "total_steps": options.steps,
        "learning_rate": options.rate,
        "warmup_steps": WARM_UP if options.time_s else 0,
        "ema_decay": FORGETTING,
        "compile": options.compile,
        "replay": {"size": options.pool, "fresh_per_step": options.fresh},
        # Judged once, at the end, on other benches than these.
        "steps_per_epoch": NEVER,
        "validation": {"count": 2},
        "checkpoint_minutes": 1e5,
        "log_every_steps": 50,
    }
    if variant == "nothing":
        tree["training"]["told"] = {"nothing_share": 1.0}
    return RunConfig.model_validate(tree | {"initial_weights": options.weights})


class Printing:
    """Tells of a training in lines; a :class:`nets.training.progress.Observer`."""

    def __init__(self, name: str):
        self.name = name

    def stage(self, what: str, done: int, total: int) -> None:
        if not done:
            print(f"{self.name}: {what}", flush=True)

    def tick(self, step: int, share: float | None, left_s: float | None) -> None:
        pass

    def show(self, progress: Any) -> None:
        if not progress.is_validation:
            print(
                f"{self.name}: step {progress.step}, {progress.elapsed_s:.0f} s, loss {progress.loss:.4f}, "
                f"{progress.samples_per_s:.0f}/s, {progress.simulator_share:.0%} of it simulating",
                flush=True,
            )

    def note(self, text: str) -> None:
        print(f"{self.name}: {text}", flush=True)

    def warn(self, text: str) -> None:
        print(f"{self.name}: {text}", flush=True)


def judged(network: Any, config: Any, benches: int, device: Any) -> dict[str, list[float]]:
    """Error of each bench in each way to look [um].

    Args:
        network: on the device.
        config: of its training.
        benches: how many, always the first of the same.
        device: where.
    """
    import torch

    from nets.training.bench_source import BenchSource
    from nets.training.devices import autocast
    from nets.training.losses import relief_rmse_um
    from nets.training.told_task import ToldTask

    # Whatever the training was told, all are judged by the same, in batches of one size: cameras are drawn by batch.
    changes = {"validation": {"count": benches, "seed": JUDGED_SEED}, "told": {}, "batch_size": min(benches, 32)}
    tree = config.model_dump(mode="json")
    config = type(config).model_validate(tree | {"training": tree["training"] | changes})
    task, source = ToldTask(config, device), BenchSource(config, device)
    batches = source.validation()
    source.close()

    def model(*given: Any) -> Any:
        with autocast(config.training.precision, device):
            return network(*given)

    found: dict[str, list[float]] = {name: [] for name in LOOKS}
    with torch.no_grad():
        for number, batch in enumerate(batches):
            for name, seen in task.looks(batch, number).items():
                errors = relief_rmse_um(seen.answered(model).float(), batch["heights"])
                found[name] += [round(error, 2) for error in errors.tolist()]
    return found


def trained(variant: str, config: Any, device: str) -> tuple[Any, dict[str, Any]]:
    """A network and what its training was; :data:`START` is not trained."""
    from nets.architecture import build
    from nets.training.devices import launched
    from nets.training.fit import fit
    from nets.training.limits import Limits
    from nets.training.weights import load_initial_weights
    from nets.weights import load_weights

    fabric = launched(device, 1)
    if variant == START:
        network = build(config.network, config.scene)
        if config.initial_weights is not None:
            load_initial_weights(config.initial_weights, network, config.scene, starts_flat=False)
        return network.to(fabric.device).eval(), {"steps": 0, "seconds": 0.0}
    with tempfile.TemporaryDirectory() as folder:
        result = fit(config, Path(folder), fabric, Printing(variant), Limits(), resume=False)
        if result.weights is None:
            raise SystemExit(f"{variant} made no step in its time; raise --time-each")
        network = load_weights(result.weights, map_location=fabric.device).module
    return network, {"steps": result.step, "seconds": round(result.elapsed_s, 1)}


def work(variant: str, options: Options, device: str, found: Path) -> None:
    """One variant, from its start to its figures in a file."""
    import torch

    torch.set_num_threads(1)
    config = run_of(variant, options)
    network, row = trained(variant, config, device)
    place = next(network.parameters()).device
    if place.type == "cuda":
        row["memory_GiB"] = round(torch.cuda.max_memory_allocated(place) / 2**30, 1)
    row["parameters"] = sum(parameter.numel() for parameter in network.parameters())
    row["rmse_um"] = judged(network, config, options.benches, place)
    found.write_text(json.dumps(row), encoding="utf-8")
    print(f"{variant}: done", flush=True)


def together(
    variants: Sequence[str], options: Options, devices: Sequence[str], at_once: int, until: float | None = None
) -> dict[str, Any]:
    """Rows of variants, some at once, each on the next device; one that fails is left out, and said.

    Args:
        variants: to train.
        options: of all.
        devices: where.
        at_once: how many processes at a time.
        until: ``time.monotonic()`` at which those that still run are ended; None waits for all.
    """
    context, rows, waiting = multiprocessing.get_context("spawn"), {}, list(enumerate(variants))
    with tempfile.TemporaryDirectory() as folder:
        running: dict[str, Any] = {}
        while waiting or running:
            while waiting and len(running) < at_once:
                number, variant = waiting.pop(0)
                arguments = (variant, options, devices[number % len(devices)], Path(folder) / f"{variant}.json")
                running[variant] = context.Process(target=work, args=arguments)
                running[variant].start()
            time.sleep(0.2)
            if until is not None and time.monotonic() > until:
                waiting.clear()
                for process in running.values():
                    process.kill()
                    process.join()
            for variant in [name for name, process in running.items() if not process.is_alive()]:
                process, file = running.pop(variant), Path(folder) / f"{variant}.json"
                process.join()
                if file.exists():
                    rows[variant] = json.loads(file.read_text(encoding="utf-8"))
                else:
                    print(f"{variant}: ended with {process.exitcode}, and has no figures", flush=True)
    return {variant: rows[variant] for variant in variants if variant in rows}


def time_left(within_s: float, spent_s: float, other_s: float, wanted_s: float) -> float:
    """Of each training, so that all end in time [s].

    Args:
        within_s: for everything.
        spent_s: of it.
        other_s: what start and judging of one variant took, alone.
        wanted_s: longest.
    """
    # Several that start and judge at once hold each other up.
    left = within_s - spent_s - 1.5 * other_s - 20.0
    if left < LEAST_S:
        raise SystemExit(f"{left:.0f} s are left for each training, the least is {LEAST_S:.0f}; raise --within")
    return min(wanted_s, left)


def versus(row: dict[str, Any], other: dict[str, Any], look: str) -> tuple[float, float]:
    """Mean difference of two variants on the same benches and its standard error [um]."""
    difference = np.subtract(row["rmse_um"][look], other["rmse_um"][look])
    return float(difference.mean()), float(difference.std(ddof=1) / np.sqrt(len(difference)))


def table(stored: dict[str, Any]) -> list[str]:
    """Lines of a table in Markdown: mean errors [um], then differences from the first variant that was trained."""
    rows = stored["variants"]
    lines = [f"| told by | steps | {' | '.join(LOOKS.values())} |", f"|{'---|' * (len(LOOKS) + 2)}"]
    for name, row in rows.items():
        means = [f"{np.mean(row['rmse_um'][look]):.1f}" for look in LOOKS]
        lines.append(f"| {name} | {row['steps']} | {' | '.join(means)} |")
    first, *others = [name for name in rows if name != START] or [START]
    for name in others:
        cells = [f"{mean:+.1f} +- {error:.1f}" for mean, error in (versus(rows[name], rows[first], k) for k in LOOKS)]
        lines.append(f"| {name} less {first} | | {' | '.join(cells)} |")
    return lines


def main(arguments: list[str] | None = None) -> None:
    """Train, judge, write, print."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("--device", nargs="+", default=["cpu"], help="one, or several that variants take in turn")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS[:3]))
    parser.add_argument("--time-each", type=float, default=240.0, help="seconds of training")
    parser.add_argument("--steps", type=int, help="train so many steps in place of a time")
    parser.add_argument("--within", type=float, help="seconds for everything; trainings are shortened to it")
    parser.add_argument("--at-once", type=int, help="processes at a time; all without")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--pool", type=int, default=4096)
    parser.add_argument("--fresh", type=int, default=8, help="new samples in each step")
    parser.add_argument("--benches", type=int, default=128, help="that judge")
    parser.add_argument("--rate", type=float, default=7e-4)
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--weights", default=str(ROOT / "nets" / "trained" / "direct.safetensors"))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--read", type=Path, help="print the table of a file")
    given = parser.parse_args(arguments)
    if given.read:
        print("\n".join(table(json.loads(given.read.read_text(encoding="utf-8")))))
        return
    began = time.monotonic()
    # Every process has its share of the cores by itself: drawing samples and starting kernels take one.
    os.environ["OMP_NUM_THREADS"] = "1"
    options = Options(
        None if given.steps else given.time_each,
        given.steps, given.batch, given.pool, given.fresh, given.benches, given.rate, given.compile, given.weights,
    )  # fmt: skip
    rows = together([START], options, given.device, 1)
    other_s = time.monotonic() - began
    if given.within and options.time_s:
        options = options._replace(time_s=time_left(given.within, other_s, other_s, options.time_s))
    length = f"{options.steps} steps" if options.time_s is None else f"{options.time_s:.0f} s"
    print(f"{START}: {other_s:.0f} s; each training {length}", flush=True)
    at_once = given.at_once or len(given.variants)
    until = None if given.within is None else began + given.within + GRACE_S
    rows |= together(given.variants, options, given.device, at_once, until)
    stored = record(rows, options, given.device, at_once)
    if given.json:
        given.json.write_text(_joined(json.dumps(stored, indent=1)) + "\n", encoding="utf-8")
    print(f"all: {time.monotonic() - began:.0f} s")
    print("\n".join(table(stored)))


def record(rows: dict[str, Any], options: Options, devices: Sequence[str], at_once: int) -> dict[str, Any]:
    """What is stored."""
    import torch

    from nets.weights import weights_info
    from warp_caustics.device import device_name

    settings = options._asdict() | {"seed": SEED, "judged_seed": JUDGED_SEED}
    if options.weights is not None:
        settings["weights"] = weights_info(options.weights).content_hash[:8]
    return {
        "about": "relief RMSE of each bench [um]; python -m benchmarks.conditioning",
        "device": device_name(devices[0]),
        "devices": len(devices),
        "at_once": at_once,
        "torch": torch.__version__,
        "settings": settings,
        "variants": rows,
    }


def _joined(text: str) -> str:
    """JSON with a list of numbers on one line."""
    return re.sub(r"\[([-\d\s.,]*)\]", lambda found: f"[{' '.join(found[1].split())}]", text)


if __name__ == "__main__":
    main()
