"""Small, fast and misbehaving samplers. A module of its own, because spawned workers import it.

It must load neither torch nor Warp, which would be most of what each of some hundred workers does.
"""

import functools
import os
import signal
import time
from pathlib import Path

import numpy as np

from data_gen.bench_ranges import BenchRanges
from data_gen.benches.columns import PRINT_NAMES, bench_columns
from data_gen.benches.draw import draw_benches
from data_gen.dataset_config import DatasetConfig, sample_generator
from data_gen.sampler import Field, SampleBatch

FIELDS = (
    Field("image", (3, 8, 8), "float16", "W/m^2", "a picture"),
    Field("heights", (8, 8), "float32", "m", "a relief"),
)


class SyntheticSampler:
    """Noise. Misbehaves in one of several ways at one sample.

    Args:
        config: of the data set.
        pause_s: per sample.
        trouble: name of what to do at a sample.
        at: the sample.
        once: path of a file whose absence is needed for trouble, and which is made before it.
        log: path of a file that gets one line per drawn shard.
    """

    fields = FIELDS

    def __init__(self, config, pause_s=0.0, trouble="", at=-1, once=None, log=None):
        self.fingerprint = config.sample_fingerprint()
        self.pause_s, self.trouble, self.at, self.once, self.log = pause_s, trouble, at, once, log

    def draw(self, ids):
        if self.log:
            descriptor = os.open(self.log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
            os.write(descriptor, f"{ids[0]}\n".encode())
            os.close(descriptor)
        arrays = {field.name: np.empty((len(ids), *field.shape), field.dtype) for field in self.fields}
        for row, sample in enumerate(ids):
            if sample == self.at and self.trouble:
                self.make_trouble(arrays, row)
            else:
                self.fill(arrays, row, sample)
            if self.pause_s:
                time.sleep(self.pause_s)
        counters = {"lost": np.asarray(ids, float) / 2, "clamped": np.zeros(len(ids))}
        if self.trouble == "counter" and self.at in ids:
            counters["lost"][0] = np.nan
        return SampleBatch(tuple(ids), arrays, counters)

    def fill(self, arrays, row, sample):
        random = sample_generator(self.fingerprint, "synthetic", sample)
        for field in self.fields:
            arrays[field.name][row] = random.standard_normal(field.shape)

    def make_trouble(self, arrays, row):
        self.fill(arrays, row, self.at)
        if self.once:
            try:
                os.close(os.open(self.once, os.O_CREAT | os.O_EXCL))
            except FileExistsError:
                return
        if self.trouble in TROUBLES:
            TROUBLES[self.trouble]()
        elif self.trouble == "nan":
            arrays["heights"][row, 1, 2] = np.nan
        elif self.trouble == "clipped":
            arrays["image"][row, 0, 0, 0] = 65504
        elif self.trouble == "random":
            arrays["heights"][row] = np.random.default_rng().standard_normal((8, 8))


class SyntheticCaptures(SyntheticSampler):
    """The same with benches as captures have them: rows of named numbers, drawn as the real ones are but for prints."""

    def __init__(self, config, **options):
        super().__init__(config, **options)
        self.config = config
        columns = bench_columns(config.scene.n_wavelengths)
        self.fields = (*FIELDS, Field("bench", (len(columns),), "float64", "", "a bench", columns))

    def fill(self, arrays, row, sample):
        super().fill({field.name: arrays[field.name] for field in self.fields}, row, sample)
        random = sample_generator(self.fingerprint, "prints", sample)
        printed = {name: random.random(1) for name in PRINT_NAMES}
        arrays["bench"][row] = draw_benches(self.config, self.fingerprint, [sample], printed).values[0]


def raise_value_error():
    raise ValueError("the glass is too thin")


def raise_memory_error():
    raise MemoryError


TROUBLES = {
    "kill": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "segfault": lambda: os.kill(os.getpid(), signal.SIGSEGV),
    "exit": lambda: os._exit(7),
    "stop": lambda: os.kill(os.getpid(), signal.SIGSTOP),
    "sleep": lambda: time.sleep(3600),
    "raise": raise_value_error,
    "memory": raise_memory_error,
}


def make_sampler(config, device, **options):
    return (SyntheticCaptures if config.kind == "capture" else SyntheticSampler)(config, **options)


def failing_factory(config, device):
    raise RuntimeError("no such device here")


def dying_factory(config, device):
    os._exit(9)


class MeetingSampler(SyntheticSampler):
    """Draws nothing before samplers of all devices are as far: however late a busy machine starts a process.

    Args:
        config: of the data set.
        device: of this sampler.
        folder: where samplers leave word, one file a device.
        devices: all of them.
    """

    def __init__(self, config, device, folder, devices):
        super().__init__(config)
        self.own = Path(folder, device)
        self.others = [Path(folder, name) for name in devices]

    def meet(self):
        self.own.touch()
        end = time.monotonic() + 120
        while not all(path.exists() for path in self.others):
            if time.monotonic() > end:
                raise TimeoutError(f"{self.own.name} alone for 120 s")
            time.sleep(0.01)

    def draw(self, ids):
        self.meet()
        return super().draw(ids)


class DifferingSampler(MeetingSampler):
    """Announces other fields on every device but the first; the first keeps drawing until it is ended."""

    def __init__(self, config, device, folder, devices):
        super().__init__(config, device, folder, devices)
        if device != devices[0]:
            self.fields = FIELDS[:1]
            self.own.touch()

    def draw(self, ids):
        self.meet()
        time.sleep(120)
        return super().draw(ids)


def factory(**options):
    return functools.partial(make_sampler, **options)


def meeting_factory(kind, folder, devices):
    return functools.partial(kind, folder=str(folder), devices=devices)


def make_config(n_samples=40, samples_per_shard=4, seed=1, **options):
    settings = {"kind": "denoiser", **options}
    return DatasetConfig(n_samples=n_samples, samples_per_shard=samples_per_shard, seed=seed, **settings)


def captures(n_samples=40, samples_per_shard=4, seed=1):
    """A data set whose samples have benches of their own."""
    ranges = BenchRanges(set_up={"gap_offset_m": (0, 1e-4)}, camera={"psf_px": (0, 1)})
    return make_config(n_samples, samples_per_shard, seed, kind="capture", bench=ranges)


def shard_bytes(folder):
    """Content of all shard files by name."""
    return {path.name: path.read_bytes() for path in sorted(Path(folder, "shards").glob("*.h5"))}


def temporaries(folder):
    return [path for path in Path(folder).rglob(".tmp-*")]


def main():
    """``python -m store_synthetic FOLDER WORKERS N PER_SHARD PAUSE_S [captures]``: build and print one line per shard."""
    import sys

    from data_gen.store import build

    folder, workers, n_samples, per_shard, pause_s = sys.argv[1:6]
    configuration = captures if "captures" in sys.argv[6:] else make_config
    build(
        folder,
        configuration(int(n_samples), int(per_shard)),
        factory(pause_s=float(pause_s)),
        workers=int(workers),
        progress=lambda state: print(state.done, flush=True),
    )


if __name__ == "__main__":
    main()


def everything(folder):
    """Content of each file of a data set by its path, without that of the lock."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }
