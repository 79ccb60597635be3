"""Samples a second of plates on benches at random, and what of it the host takes: on any device.

python -m benchmarks.random_bench --device cuda --bench ordinary [--processes 3]

With ``--processes`` so many work at once, as with ``nsfc data build --workers``: strokes are drawn on the host, one
core each, while the others keep a GPU busy.
"""

import argparse
import json
import multiprocessing
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
import yaml

from data_gen.bench_ranges import BenchRanges
from data_gen.dataset_config import DatasetConfig, PhotonConfig
from data_gen.samples import CaptureSampler
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

ROOT = Path(__file__).parents[1]


def host_ms(call: Callable[[], Any], calls: int) -> float:
    """Processor time of one of several calls that only the host works on [ms]."""
    call()
    started = time.process_time()
    call()
    return 1e3 * (time.process_time() - started) / calls


def seconds(call: Callable[[], Any], device: str, repeats: int) -> float:
    """Mean time of a call, after one that compiles and plans."""

    def wait() -> None:
        if device.startswith("cuda"):
            torch.cuda.synchronize(device)

    call()
    wait()
    started = time.perf_counter()
    for _ in range(repeats):
        call()
    wait()
    return (time.perf_counter() - started) / repeats


def sampler_of(bench: str, device: str, pixels: int, samples: int, photons: int) -> CaptureSampler:
    """Samples of the benches of a configuration."""
    ranges = yaml.safe_load((ROOT / "configs" / "benches" / f"{bench}.yaml").read_text(encoding="utf-8"))
    config = DatasetConfig(
        kind="capture",
        n_samples=10**6,
        scene=Scene(height_samples=samples, image_pixels=pixels),
        clean=PhotonConfig(n_photons=photons),
        bench=BenchRanges.model_validate(ranges["data"]["bench"]),
    )
    return CaptureSampler(config, device)


def made(sampler: CaptureSampler, ids: range) -> torch.Tensor:
    """Images of fresh samples."""
    return sampler.benches.images(sampler.reliefs.true(ids), sampler.benches.draw(ids))


def work(rank: int, ready: Any, counts: Any, seconds_each: float, batch: int, options: dict[str, Any]) -> None:
    """One of several processes: samples for some seconds, from when all are ready."""
    torch.set_num_threads(1)
    sampler, device = sampler_of(**options), options["device"]
    first = 100_000 * rank
    made(sampler, range(first, first + batch))
    ready.wait()
    started, done = time.perf_counter(), 0
    while time.perf_counter() - started < seconds_each:
        done += batch
        made(sampler, range(first + done, first + done + batch))
        if device.startswith("cuda"):
            torch.cuda.synchronize(device)
    counts[rank] = done / (time.perf_counter() - started)


def together(processes: int, seconds_each: float, batch: int, options: dict[str, Any]) -> float:
    """Samples a second of several processes at once."""
    context = multiprocessing.get_context("spawn")
    ready, counts = context.Barrier(processes), context.Array("d", processes)
    started = [
        context.Process(target=work, args=(rank, ready, counts, seconds_each, batch, options))
        for rank in range(processes)
    ]
    for process in started:
        process.start()
    for process in started:
        process.join()
    return sum(float(counts[rank]) for rank in range(processes))


def measured(
    bench: str, device: str, pixels: int, samples: int, batch: int, photons: int, repeats: int
) -> dict[str, Any]:
    """Milliseconds a sample of each part, and samples a second of all."""
    sampler = sampler_of(bench, device, pixels, samples, photons)
    benches, reliefs = sampler.benches, sampler.reliefs
    ids = range(batch)
    drawn = benches.draw(ids)
    heights, scenes = reliefs.true(ids), benches.scenes(drawn)
    light = benches.light(heights, drawn)
    flats = benches._flats(scenes, drawn)
    one = scenes[0]
    engine = benches.screens.simulator.engine
    next_ids = iter(range(batch, 10**6, batch))

    def fresh() -> None:
        first = next(next_ids)
        made(sampler, range(first, first + batch))

    parts = {
        "strokes and print": lambda: reliefs.true(ids),
        "light on screens": lambda: benches.light(heights, drawn),
        "light behind flat plates": lambda: benches._flats(scenes, drawn),
        "cameras": lambda: (
            [
                benches.cameras.photos(light[k : k + 1], None if flats is None else flats[k : k + 1], drawn[k : k + 1])
                for k in range(batch)
            ]
            if device == "cpu"
            else benches.cameras.photos(light, flats, drawn)
        ),
    }
    times = {name: 1e3 * seconds(call, device, repeats) / batch for name, call in parts.items()}
    host = {
        "draw benches": host_ms(lambda: benches.draw(ids), batch),
        "draw strokes": host_ms(lambda: [reliefs.kinds[benches.kinds.number(k)].strokes(k) for k in ids], batch),
        "scenes": host_ms(lambda: benches.scenes(drawn), batch),
        "an engine for a scene": host_ms(lambda: [engine.on([scene]) for scene in scenes], batch),
        "a simulator for a scene instead": host_ms(
            lambda: [CausticSimulator(one, device=device, n_photons=photons) for _ in range(3)], 3
        ),
    }
    whole = seconds(fresh, device, repeats) / batch
    name = torch.cuda.get_device_name(device) if device.startswith("cuda") else "cpu"
    return {
        "bench": bench, "device": name, "pixels": pixels, "batch": batch, "photons": photons,
        "ms_per_sample": {key: round(value, 3) for key, value in times.items()},
        "host_ms_per_sample": {key: round(value, 3) for key, value in host.items()},
        "samples_per_s": round(1 / whole, 2),
    }  # fmt: skip


def main() -> None:
    """Print one record a bench."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--bench", nargs="+", default=["careful", "ordinary", "poor"])
    parser.add_argument("--pixels", type=int, default=512)
    parser.add_argument("--samples", type=int, default=128)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--photons", type=int, default=462_400)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--processes", type=int, default=1)
    options = vars(parser.parse_args())
    processes, names = options.pop("processes"), options.pop("bench")
    for bench in names:
        if processes == 1:
            print(json.dumps(measured(bench, **options)), flush=True)
            continue
        sizes = {name: options[name] for name in ("device", "pixels", "samples", "photons")}
        rate = together(processes, 2.0 * options["repeats"], options["batch"], {"bench": bench, **sizes})
        print(json.dumps({"bench": bench, "processes": processes, "samples_per_s": round(rate, 2)}), flush=True)


if __name__ == "__main__":
    main()
