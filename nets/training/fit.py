"""The training loop.

A step: batch (simulated, from the pool or from files), loss, gradient, clip,
optimiser, average. Nothing in it waits for the GPU; figures are read every
``log_every_steps``. Whatever happens, the run can be continued from its last
checkpoint, and then does what it would have done (on the CPU: bit for bit; on
a GPU sums differ in the last digits, unless they are to repeat: ``warp_caustics/determinism.py``).
"""

import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import torch

from nets.architecture import build
from nets.training.batch import Batch, Source
from nets.training.bench_source import BenchSource
from nets.training.checkpoint import has_checkpoint, newest_checkpoint, remove_unfinished, save_best, save_checkpoint
from nets.training.config import RunConfig
from nets.training.devices import Stopwatch, autocast
from nets.training.keys import step_seed
from nets.training.limits import Limits
from nets.training.optimisation import WeightAverage, clip_gradients, make_optimiser
from nets.training.origin import origin
from nets.training.progress import DivergedError, Observer, StopReason, TrainingProgress, TrainingResult, ahead
from nets.training.record import RunRecord, write_sample
from nets.training.sources import ReplaySource, check_pool, make_source
from nets.training.state import EarlyStopping, RunState, finite_or_none
from nets.training.tasks import make_task
from nets.training.weights import export_weights, load_initial_weights
from warp_caustics.determinism import settle_gpu
from warp_caustics.signals import Restore, answered

AGREE_EVERY_STEPS = 10
"""How often several processes agree on time and on whether to stop."""


def fit(
    config: RunConfig,
    folder: Path | None,
    fabric: Any,
    observer: Observer,
    limits: Limits,
    *,
    resume: bool,
    source: Source | None = None,
) -> TrainingResult:
    """Train until the run is finished or a limit is reached.

    Args:
        config: the run.
        folder: for everything that is written; exists. None writes nothing.
        fabric: what :func:`nets.training.devices.launched` gives, in 32-bit precision (mixed precision is this
            function's work: Fabric would round images and heights on their way into the network).
        observer: watches.
        limits: of this command.
        resume: continue from the newest checkpoint in the folder; from the beginning where there is none yet.
        source: of the batches, in place of the run's own.

    Raises:
        DivergedError: loss or weights are no numbers.
        ResourceError: the pool of samples does not fit into the GPU.
        MismatchError: the checkpoint is of another run.
        DamagedDataError: no checkpoint can be read.
    """
    loop = _Loop(config, folder, fabric, observer, limits)
    loop.prepare(resume, source)
    try:
        # The step is finished and a checkpoint written; a second signal ends the program at once.
        with answered(loop.stop, signal.SIGINT, signal.SIGTERM):
            return loop.run()
    finally:
        loop.close()


class _Loop:
    def __init__(self, config: RunConfig, folder: Path | None, fabric: Any, observer: Observer, limits: Limits):
        self.config, self.training, self.folder = config, config.training, folder or Path()
        self.fabric, self.observer, self.limits = fabric, observer, limits
        self.device: torch.device = fabric.device
        self.world, self.is_first = int(fabric.world_size), bool(fabric.is_global_zero)
        self.is_writing = self.is_first and folder is not None
        self.checkpoints, self.pictures = self.folder / "checkpoints", self.folder / "pictures"
        self.signal: int | None = None
        self.validation: list[Batch] = []
        self.saved_best_step = 0
        self.drawing = ThreadPoolExecutor(max_workers=1, thread_name_prefix="pictures")
        self.record: RunRecord | None = None

    # -- before and after -------------------------------------------------------------------------------------

    def prepare(self, resume: bool, source: Source | None) -> None:
        """Network, source, state; a checkpoint's content where one is continued."""
        training, device = self.training, self.device
        torch.backends.cudnn.benchmark = True
        settle_gpu()  # nothing is tried out where results are to repeat
        # Convolutions only: the simulator's matrix products need all digits.
        torch.backends.cudnn.allow_tf32 = True
        torch.manual_seed(step_seed(training.seed, "weights", 0))
        network = build(self.config.network, self.config.scene)
        resume = resume and has_checkpoint(self.checkpoints)
        if self.config.initial_weights is not None and not resume:
            starts_flat = training.unrolling.start.direct == 0
            load_initial_weights(self.config.initial_weights, network, self.config.scene, starts_flat=starts_flat)
        network = network.to(device)
        if training.channels_last:
            network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.state = RunState(
            self.config,
            network,
            make_optimiser(network, training, device),
            WeightAverage(network, training.ema_decay),
            torch.amp.GradScaler(device.type, enabled=training.precision == "16"),
            EarlyStopping(training.patience, training.min_epochs),
            torch.zeros((), device=device),
            torch.zeros((), device=device),
            self.world,
        )
        if resume:
            self._restore()
        compiled: Any = torch.compile(network) if training.compile else network
        self.module = self.fabric.setup_module(compiled)
        self.source = source or make_source(self.config, device, int(self.fabric.global_rank), self.world)
        self.watch = Stopwatch(device)
        self.task = make_task(self.config, device, int(self.fabric.global_rank), self.watch)
        if isinstance(self.source, ReplaySource | BenchSource):
            self.source.network = self._average_model
        if isinstance(self.source, ReplaySource):
            taken = check_pool(self.source)
            if self.is_first:
                self.observer.note(taken)
        if self.is_first and training.replay.size:
            self.observer.stage("filling the pool of samples", 0, 0)
        self.source.resume(self.state.step * training.accumulate)
        self.validation = self.source.validation(self._told)
        self.steps_per_epoch = max(1, self.source.steps_per_epoch // training.accumulate)
        if self.is_writing:
            for path in (self.checkpoints, self.pictures):
                path.mkdir(exist_ok=True)
            remove_unfinished(self.checkpoints)
            self.record = RunRecord(self.folder, self.state.step)
            if self.record.warning:
                self.observer.warn(self.record.warning)

    def _restore(self) -> None:
        saved, warning = newest_checkpoint(self.checkpoints)
        self.state.restore(saved)
        if not self.is_first:
            return
        if warning is not None:
            self.observer.warn(warning)
        changed = self.state.changed_batch(saved)
        if changed is not None:
            self.observer.warn(changed)

    def _told(self, done: int, total: int) -> None:
        if self.is_first:
            self.observer.stage("making validation samples", done, total)

    def stop(self, number: int, restore: Restore) -> None:
        """A signal asks for the end."""
        self.signal = number
        restore()

    def close(self) -> None:
        self.source.close()
        self.drawing.shutdown(wait=True)
        if self.record is not None:
            self.record.close()

    # -- the loop ---------------------------------------------------------------------------------------------

    def run(self) -> TrainingResult:
        state, first_step = self.state, self.state.step
        limits = self.limits = self.limits.counted_from(time.monotonic())
        if state.share is None and limits.deadline is not None and limits.max_steps is None:
            # One clock for all processes: rates and the last step follow from it.
            state.horizon_s = self.fabric.broadcast(state.elapsed_s + max(1.0, limits.left_s(time.monotonic())))
        self.before_s, self.start = state.elapsed_s, time.monotonic()
        self.saved_at = self.start
        self.watch.read()
        self.done_at_reading = state.step
        self.first_step, self.first_share = first_step, state.share or 0.0
        if self.is_first:
            self.observer.stage("first step", 0, 0)
        while (reason := self._stop_reason()) is None:
            self._step()
            if self.is_first:
                self.observer.tick(state.step, *self._ahead())
            if state.step % self.training.log_every_steps == 0:
                self._report()
            if state.step % self.steps_per_epoch == 0:
                self._validate()
            if self._checkpoint_is_due():
                self._save()
        if state.step == first_step:
            if self.is_first:
                self.observer.note(
                    f"nothing to do, the run is at its end ({reason}); --total-steps or --total-time extend it"
                )
        elif reason == "finished" and state.step % self.steps_per_epoch != 0:
            self._validate()
        # Without a step there is nothing to go on from, and weights would be random numbers.
        weights = None
        if state.step > 0:
            self._save()
            weights = self._export() if self.is_writing else None
        best = finite_or_none(state.stopping.best)
        return TrainingResult(
            reason, state.step, state.elapsed_s, best, self.task.objective, dict(state.validation), weights
        )

    def _ahead(self) -> tuple[float | None, float | None]:
        state, limits, spent_s = self.state, self.limits, time.monotonic() - self.start
        run = (self.first_share, state.share, 1.0) if state.share is not None else None
        steps = (self.first_step, state.step, limits.max_steps) if limits.max_steps is not None else None
        clock = (self.start, self.start + spent_s, limits.deadline) if limits.deadline is not None else None
        return ahead(spent_s, [way for way in (run, steps, clock) if way is not None])

    def _step(self) -> None:
        state, training = self.state, self.training
        rate, share = state.rate, state.share
        for group in state.optimiser.param_groups:
            group["lr"] = rate
        for part in range(training.accumulate):
            number = state.step * training.accumulate + part
            with self.watch.part():
                batch = self.source.batch(number)
            is_last = part == training.accumulate - 1
            with self.fabric.no_backward_sync(self.module, enabled=not is_last):
                loss = self.task.loss(self._model, batch, number, 1.0 if share is None else share) / training.accumulate
                self.fabric.backward(state.scaler.scale(loss))
            state.loss_sum += loss.detach()
        state.scaler.unscale_(state.optimiser)
        clip_gradients(state.network, training, state.mean_norm)
        state.scaler.step(state.optimiser)
        state.scaler.update()
        state.optimiser.zero_grad(set_to_none=True)
        state.average.update(state.step)
        state.step += 1
        state.loss_count += 1

    def _model(self, *args: Any, **options: Any) -> Any:
        with autocast(self.training.precision, self.device):
            return self.module(*args, **options)

    def _average_model(self, *args: Any, **options: Any) -> Any:
        with autocast(self.training.precision, self.device):
            return self.state.average.network(*args, **options)

    def _stop_reason(self) -> StopReason | None:
        state, limits = self.state, self.limits
        now = time.monotonic()
        if self.world == 1:
            state.elapsed_s = self.before_s + now - self.start
            is_late, number = limits.is_late(now, state.step > self.first_step), self.signal
        else:
            is_late, number = False, None
            if state.step % AGREE_EVERY_STEPS == 0:
                is_late = limits.is_late(now, state.step > self.first_step)
                told = (self.before_s + now - self.start, is_late, self.signal)
                state.elapsed_s, is_late, number = self.fabric.broadcast(told)
        if number is not None:
            return "terminated" if number == signal.SIGTERM else "interrupted"
        if state.share is not None and state.share >= 1:
            return "finished"
        if state.stopping.should_stop:
            return "early_stopping"
        if limits.max_steps is not None and state.step >= limits.max_steps:
            return "max_steps"
        return "max_time" if is_late else None

    # -- now and then -----------------------------------------------------------------------------------------

    def _report(self) -> None:
        state = self.state
        # The only place in the loop that waits for the device. Each process has seen a part of every batch.
        loss = float(self.fabric.all_reduce(state.loss_sum, reduce_op="mean")) / max(1, state.loss_count)
        state.loss_sum.zero_()
        state.loss_count = 0
        seconds, share = self.watch.read()
        steps, self.done_at_reading = state.step - self.done_at_reading, state.step
        samples = steps * self.training.batch_size * self.training.accumulate * self.world / seconds
        if not torch.isfinite(torch.tensor(loss)):
            raise DivergedError(
                f"loss is {loss} at step {state.step}; lower training.learning_rate "
                f"(now {self.training.learning_rate:g}) and resume from the last checkpoint"
            )
        self.latest = TrainingProgress(
            state.step, state.share, state.elapsed_s, loss, samples, share, state.rate, dict(state.validation)
        )
        self._write(
            {
                "loss": loss,
                "learning_rate": state.rate,
                "samples_per_s": samples,
                "simulator_share": share,
            }
        )
        if self.is_first:
            self.observer.show(self.latest)

    def _validate(self) -> None:
        state = self.state
        if self.is_first:
            self.observer.stage("validating", 0, 0)
        with torch.no_grad():
            measures = self.fabric.broadcast(self.task.measures(self._average_model, self.validation))
            sample = self.task.sample(self._average_model, self.validation[0]).on_cpu() if self.is_writing else None
        state.validation = measures
        is_best = state.stopping.saw(measures[self.task.objective])
        if is_best:
            state.keep_best()
        self._write({**measures, "is_best": int(is_best)})
        if self.is_writing:
            figures = ", ".join(f"{name} {value:.4g}" for name, value in measures.items())
            self.drawing.submit(self._picture, state.step, sample, f"step {state.step}: {figures}")
        if self.is_first:
            self.observer.show(
                TrainingProgress(
                    state.step, state.share, state.elapsed_s, float("nan"), 0.0, 0.0, state.rate, measures, True
                )
            )
        # Validation is no training: it counts in no figure of speed.
        self.watch.read()
        self.done_at_reading = state.step

    def _picture(self, step: int, sample: Any, caption: str) -> None:
        pixels = write_sample(self.pictures / f"step-{step:08d}.png", sample, self.config.scene, caption)
        if self.record is not None:
            self.record.picture(step, pixels)

    def _write(self, values: dict[str, Any]) -> None:
        if self.record is not None:
            state = self.state
            common = {"epoch": state.stopping.epoch, "elapsed_s": state.elapsed_s}
            self.record.write(state.step, {**common, **values})

    def _checkpoint_is_due(self) -> bool:
        by_steps = self.training.checkpoint_steps
        if by_steps is not None and self.state.step % by_steps == 0:
            return True
        return time.monotonic() - self.saved_at > 60 * self.training.checkpoint_minutes

    def _save(self) -> None:
        state = self.state
        self.saved_at = time.monotonic()
        if not self.is_first:
            return
        if not state.is_finite:
            raise DivergedError(
                f"weights are not finite at step {state.step}; lower training.learning_rate "
                f"(now {self.training.learning_rate:g}) and resume from the last checkpoint"
            )
        if not self.is_writing:
            return
        save_checkpoint(self.checkpoints, state.to_dict())
        if state.best_step != self.saved_best_step:
            best = {"weights": state.best_weights, "step": state.best_step, "config": self.config.model_dump_json()}
            save_best(self.checkpoints, best)
            self.saved_best_step = state.best_step

    def _export(self) -> str | None:
        state = self.state
        if state.best_weights:
            state.average.network.load_state_dict(state.best_weights)
        training = {
            "kind": self.config.kind,
            "steps": state.best_step or state.step,
            "batch": self.training.batch_size * self.training.accumulate * self.world,
            "elapsed_s": round(state.elapsed_s, 1),
            "objective": self.task.objective,
            "best": finite_or_none(state.stopping.best),
            "origin": origin(str(self.device), self.world),
        }
        return export_weights(self.folder / "weights.safetensors", state.average.network, self.config, training)
