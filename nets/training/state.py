"""Everything of a run that a checkpoint holds, in one place."""

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import torch

from nets.training.config import RunConfig
from nets.training.optimisation import WeightAverage, learning_rate
from warp_caustics.errors import CausticsError, DamagedDataError, MismatchError, is_out_of_memory

STATE_VERSION = 2


@dataclass
class EarlyStopping:
    """Stops after ``patience`` epochs without progress, not before ``min_epochs`` epochs.

    Progress is a loss strictly below the best so far; NaN and infinity never are.

    Attributes:
        patience: None never stops.
        min_epochs: least number of epochs.
        best: lowest loss so far.
        best_epoch: its epoch, from 1; 0 for none.
        epoch: epochs seen.
        waited: epochs since the best, or since the start.
    """

    patience: int | None
    min_epochs: int
    best: float = math.inf
    best_epoch: int = 0
    epoch: int = 0
    waited: int = 0

    def saw(self, loss: float) -> bool:
        """Take in the loss of one more epoch; True if it is the best so far."""
        self.epoch += 1
        is_best = math.isfinite(loss) and loss < self.best
        if is_best:
            self.best, self.best_epoch, self.waited = loss, self.epoch, 0
        else:
            self.waited += 1
        return is_best

    @property
    def should_stop(self) -> bool:
        return self.patience is not None and self.epoch >= self.min_epochs and self.waited >= self.patience

    def state(self) -> dict[str, Any]:
        """Plain values for a checkpoint."""
        return {name: value for name, value in asdict(self).items() if name not in ("patience", "min_epochs")}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from :meth:`state`."""
        self.best, self.best_epoch = float(state["best"]), int(state["best_epoch"])
        self.epoch, self.waited = int(state["epoch"]), int(state["waited"])


@dataclass
class RunState:
    """Weights, optimiser, average, counters.

    Attributes:
        config: the run.
        network: what is trained.
        optimiser: of it.
        average: of its weights.
        scaler: of the loss, for float16.
        stopping: counts epochs without progress.
        step: optimiser steps done.
        elapsed_s: training time of all commands.
        processes: how many take each step together, each with a batch of its own.
        horizon_s: length of the run in seconds where the first command's --max-time defined it.
        mean_norm: running mean of the gradients' norms, scalar tensor on the device; 0 before the first.
        loss_sum: of this process in the steps since the last report, scalar tensor on the device. Checkpoints hold
            the first process's: the first report after a resume may differ, nothing that is learned does.
        loss_count: their number.
        best_weights: averaged weights of the best validation, by name; empty before the first.
        best_step: when that was.
        validation: latest measures.
    """

    config: RunConfig
    network: torch.nn.Module
    optimiser: torch.optim.Optimizer
    average: WeightAverage
    scaler: torch.amp.GradScaler
    stopping: EarlyStopping
    mean_norm: torch.Tensor
    loss_sum: torch.Tensor
    processes: int = 1
    step: int = 0
    elapsed_s: float = 0.0
    horizon_s: float | None = None
    loss_count: int = 0
    best_weights: dict[str, torch.Tensor] = field(default_factory=dict)
    best_step: int = 0
    validation: dict[str, float] = field(default_factory=dict)

    @property
    def share(self) -> float | None:
        """Of the whole run that is done; None where it has no end."""
        training = self.config.training
        shares = []
        if training.total_steps is not None:
            shares.append(self.step / training.total_steps)
        seconds = training.total_time_s or (self.horizon_s if training.total_steps is None else None)
        if seconds is not None:
            shares.append(self.elapsed_s / seconds)
        return max(shares) if shares else None

    @property
    def rate(self) -> float:
        """Learning rate of the next step."""
        return learning_rate(self.config.training, self.step, self.share or 0.0)

    @property
    def is_finite(self) -> bool:
        """Whether all weights are; waits for the device."""
        finite = [p.isfinite().all() for p in (*self.network.parameters(), *self.average.network.parameters())]
        return bool(torch.stack(finite).all())

    def keep_best(self) -> None:
        """Remember the averaged weights as the best."""
        self.best_weights = {name: value.detach().clone() for name, value in self.average.network.state_dict().items()}
        self.best_step = self.step

    def to_dict(self) -> dict[str, Any]:
        """Tensors and plain types."""
        device = self.loss_sum.device
        return {
            "version": STATE_VERSION,
            "config": self.config.model_dump_json(),
            "network": self.network.state_dict(),
            "average": self.average.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "scaler": self.scaler.state_dict(),
            "stopping": self.stopping.state(),
            "step": self.step,
            "elapsed_s": self.elapsed_s,
            "horizon_s": self.horizon_s,
            "processes": self.processes,
            "mean_norm": self.mean_norm.detach().clone(),
            "loss_sum": self.loss_sum.detach().clone(),
            "loss_count": self.loss_count,
            "best_weights": self.best_weights,
            "best_step": self.best_step,
            "validation": self.validation,
            "rng": torch.get_rng_state(),
            "device_rng": torch.cuda.get_rng_state(device) if device.type == "cuda" else None,
        }

    def restore(self, saved: dict[str, Any]) -> None:
        """Continue from :meth:`to_dict`.

        Raises:
            MismatchError: of another run.
            DamagedDataError: entries are missing, or of other types or shapes.
        """
        try:
            check_same_run(self.config, saved)
            self._take(saved)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, RuntimeError) as error:
            if isinstance(error, CausticsError) or is_out_of_memory(error):
                raise
            what = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
            raise DamagedDataError(f"checkpoint is not whole ({what}); train again with --force") from error

    def changed_batch(self, saved: dict[str, Any]) -> str | None:
        """How many samples a step sees that another number of processes saw before; None where nothing changed."""
        now, before, size = self.processes, int(saved.get("processes", self.processes)), self.config.training.batch_size
        if now == before:
            return None
        return (
            f"this run was on {before} devices and goes on with {now}: each step sees {now * size} samples instead "
            f"of {before * size}; --devices {before} continues as before"
        )

    def _take(self, saved: dict[str, Any]) -> None:
        device = self.loss_sum.device
        self.network.load_state_dict(saved["network"])
        self.average.network.load_state_dict(saved["average"])
        self.optimiser.load_state_dict(saved["optimiser"])
        if saved["scaler"] and self.scaler.is_enabled():
            self.scaler.load_state_dict(saved["scaler"])
        self.stopping.restore(saved["stopping"])
        self.step, self.elapsed_s = int(saved["step"]), float(saved["elapsed_s"])
        self.horizon_s = saved["horizon_s"]
        self.mean_norm.copy_(saved["mean_norm"])
        self.loss_sum.copy_(saved["loss_sum"])
        self.loss_count = int(saved["loss_count"])
        self.best_weights = {name: value.to(device) for name, value in saved["best_weights"].items()}
        self.best_step = int(saved["best_step"])
        self.validation = {name: float(value) for name, value in saved["validation"].items()}
        torch.set_rng_state(saved["rng"])
        if device.type == "cuda" and saved["device_rng"] is not None:
            torch.cuda.set_rng_state(saved["device_rng"], device)


def check_same_run(config: RunConfig, saved: dict[str, Any]) -> None:
    """Refuse to continue a run as another one.

    Raises:
        MismatchError: version, kind, scene, reliefs, network, data or seed differ.
    """
    if saved.get("version") != STATE_VERSION:
        raise MismatchError(
            f"checkpoint is of version {saved.get('version')}, this program reads {STATE_VERSION}; train again"
        )
    before = RunConfig.model_validate_json(saved["config"])
    for name in ("kind", "scene", "reliefs", "network", "data"):
        if getattr(before, name) != getattr(config, name):
            raise MismatchError(
                f"{name} differs from the run to be resumed; leave the change out, or start a new run "
                "with --initial-weights"
            )
    if before.training.seed != config.training.seed:
        raise MismatchError(f"seed {config.training.seed} differs from the run's {before.training.seed}; leave it out")
    for name in ("bench", "scene_share"):
        if getattr(before.training, name) != getattr(config.training, name):
            raise MismatchError(f"training.{name} differs from the run to be resumed; leave the change out")


def finite_or_none(value: float) -> float | None:
    """The value, or None for infinity and NaN."""
    return value if math.isfinite(value) else None
