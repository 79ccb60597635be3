"""``nsfc data``: build, check and look at data sets."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console
from cli.options import config_options, device_option, integer, json_option
from warp_caustics.device import start_device
from warp_caustics.errors import DamagedDataError, InputError

if TYPE_CHECKING:
    from data_gen.dataset_config import DatasetConfig
    from data_gen.sampler import SamplerFactory
    from data_gen.store.shard import Compression


@click.group()
def data() -> None:
    """Data sets of simulated plates and caustics (section 2 of the supplement)."""


@data.command()
@click.argument("kind", type=click.Choice(["denoiser", "updater", "capture"]))
@click.argument("directory", type=click.Path())
@click.option("--n", "n_samples", type=integer, required=True, help="Number of samples.")
@click.option("--seed", type=integer, default=0, show_default=True, help="Selects reliefs and photons.")
@click.option(
    "--workers", type=integer, help="Processes. [default: one per GPU; on a CPU one, which uses all cores itself]"
)
@click.option("--scheduler", metavar="ADDRESS|FILE", help="Dask scheduler: its workers build, on any machines.")
@click.option("--denoiser", metavar="WEIGHTS", help="Network that denoises the updater's simulated images.")
@click.option("--picture", metavar="IMAGE", help="Print this picture (dark is fibre) instead of the pattern's own.")
@click.option(
    "--bench",
    metavar="NAME|FILE",
    help="Ranges from which each capture draws its bench: careful, ordinary, poor, or a YAML file with data.bench.",
)
@click.option("--compression", type=click.Choice(["gzip", "none"]), default="gzip", show_default=True)
@click.option("--repair", is_flag=True, help="Hash every shard that is there and rebuild those that are damaged.")
@click.option("--no-preflight", is_flag=True, help="Start even where the disk seems too small.")
@device_option
@config_options
@json_option
def build(
    kind: str,
    directory: str,
    n_samples: int,
    seed: int,
    workers: int | None,
    scheduler: str | None,
    denoiser: str | None,
    picture: str | None,
    bench: str | None,
    compression: "Compression",
    repair: bool,
    no_preflight: bool,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Build the data set of the denoiser, the updater, or of captures on random benches in DIRECTORY.

    The same command continues an unfinished one.
    """
    from cli.config import dataset_config, load_config
    from cli.shipped_files import bench_path

    if picture is not None:
        settings = ("reliefs.pattern=picture", *settings)
    config = load_config(config_source, settings, also=[] if bench is None else [bench_path(bench)])
    if picture is not None:
        if config.data.bench is not None and config.data.bench.prints is not None:
            raise InputError(
                f"--picture {picture} prints one thing, and the bench has {len(config.data.bench.prints)} kinds of "
                "prints; add --set data.bench.prints=null"
            )
        config = config.model_copy(update={"reliefs": _with_picture(config.reliefs, picture)})
    hashed, factory = _factory(denoiser)
    described = dataset_config(config, kind=kind, n_samples=n_samples, seed=seed, denoiser=hashed)
    console = Console(as_json)
    if scheduler is not None:
        from data_gen.store import build_on_cluster

        with console.sample_progress() as (progress, notice):
            report = build_on_cluster(
                directory, described, factory, scheduler, device=start_device(device), compression=compression,
                check="full" if repair else "fast", preflight=not no_preflight, progress=progress, notice=notice,
            )  # fmt: skip
    else:
        from data_gen.store import build as build_here

        devices = _devices(start_device(device))
        _announce(console, directory, described, factory, devices, workers)
        with console.sample_progress() as (progress, notice):
            report = build_here(
                directory, described, factory, workers=len(devices) if workers is None else workers, devices=devices,
                compression=compression, check="full" if repair else "fast", preflight=not no_preflight,
                progress=progress, notice=notice,
            )  # fmt: skip
    from data_gen.store import write_index

    write_index(directory)
    rate = report.samples_built / report.seconds if report.seconds else 0.0
    console.line(f"data set   {directory}, {n_samples} samples of the {kind}, complete")
    console.line(f"built      {report.samples_built} samples in {report.shards_built} shards, {rate:.1f} samples/s")
    console.line(f"written    {_size(report.bytes_written)}")
    console.record({"directory": directory, "fingerprint": described.fingerprint(), **report._asdict()})


@data.command()
@click.argument("directory", type=click.Path())
@click.option("--fast", is_flag=True, help="Compare sizes only instead of hashing every file.")
@json_option
def verify(directory: str, fast: bool, as_json: bool) -> int:
    """Check every file of the data set in DIRECTORY; exit code 4 names what is damaged."""
    from data_gen.store import verify as verify_store

    found = verify_store(directory, full=not fast)
    console = Console(as_json)
    console.line(f"shards     {found.shards_right} of {found.n_shards} right")
    console.line(f"complete   {'yes' if found.complete else 'no, build on with the same command'}")
    for problem in found.problems:
        console.line(f"problem    {problem}")
    console.record(
        {
            "shards_right": found.shards_right,
            "n_shards": found.n_shards,
            "complete": found.complete,
            "problems": [{"shard": p.shard, "kind": p.kind, "reason": p.reason} for p in found.problems],
        }
    )
    return DamagedDataError.exit_code if found.problems else 0


@data.command()
@click.argument("directory", type=click.Path())
@json_option
def info(directory: str, as_json: bool) -> None:
    """What the data set in DIRECTORY is, how far it is built, and what happened to its samples."""
    from dataclasses import asdict

    from data_gen.store import column_ranges
    from data_gen.store import info as info_of

    found, ranges = info_of(directory), column_ranges(directory)
    console = Console(as_json)
    state = "complete" if found.complete else "unfinished, build on with the same command"
    console.line(f"data set   {found.kind}, role {found.role}, fingerprint {found.fingerprint[:12]}")
    console.line(f"samples    {found.samples_done} of {found.n_samples} in {found.shards_done} shards, {state}")
    ratio = f", {found.raw_bytes / found.bytes:.2f} to 1" if found.bytes else ""
    console.line(f"size       {_size(found.bytes)}{ratio} ({', '.join(found.compression) or 'nothing built'})")
    for field in found.fields:
        shape = " x ".join(map(str, field.shape))
        console.line(f"field      {field.name}: {shape} {field.dtype} [{field.unit}], {field.description}")
    for column, (low, high) in ranges.items():
        unit = f" {column.unit}" if column.unit else ""
        console.line(f"column     {column.name}: {low:.4g} to {high:.4g}{unit}, {column.description}")
    for name, counter in found.counters.items():
        console.line(
            f"counter    {name.replace('_', ' ')}: mean {counter.mean:.3g}, largest {counter.max:.3g} "
            f"in sample {counter.sample_of_max}"
        )
    console.line(f"made by    nsfc {', '.join(found.code_versions) or '-'} on {', '.join(found.devices) or '-'}")
    console.record({**asdict(found), "columns": {column.name: limits for column, limits in ranges.items()}})


@data.command()
@click.argument("directory", type=click.Path())
@click.option("-o", "--output", type=click.Path(), required=True, help="Picture (.png).")
@click.option("--samples", type=integer, default=4, show_default=True, help="Number of samples to show.")
@click.option("--force", is_flag=True, help="Replace the picture if it exists.")
def preview(directory: str, output: str, samples: int, force: bool) -> None:
    """Draw the first samples of the data set in DIRECTORY; also of an unfinished one."""
    from cli.output import check_file
    from cli.sheet import draw_sheet
    from data_gen.store import CausticDataset

    check_file(output, force, _files_of(directory))
    shown = CausticDataset(directory, partial=True)
    count = draw_sheet(shown, output, samples)
    Console().line(f"picture    {output}, {count} samples")


@data.command()
@click.argument("directory", type=click.Path())
@click.option("--fields", type=integer, help="Number of fields, the first ones.  [default: all]")
@click.option(
    "--which",
    type=click.Choice(["development", "test"]),
    default="development",
    show_default=True,
    help="The ten fields that methods were tried on, or thirty that nothing was.",
)
@click.option("--force", is_flag=True, help="Replace earlier test fields.")
@device_option
@config_options
@json_option
def testset(
    directory: str,
    fields: int | None,
    which: Any,
    force: bool,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Write development or test fields to DIRECTORY: heights and noisy images from photons of their own."""
    from cli.config import load_config

    config = load_config(config_source, settings)
    started = start_device(device)
    from cli.parts_progress import parts_progress
    from cli.testset import write_testset

    console = Console(as_json)
    photons = config.data.clean.n_photons
    with parts_progress(console, "fields") as told:
        record = write_testset(
            directory, config.scene, started, fields, which, force=force, n_photons=photons, told=told
        )
    for name, rms in zip(record["fields"], record["flat_guess_rmse_um"], strict=True):
        console.line(f"field      {name}: heights and image, {rms:.1f} um from flat")
    console.record(record)


def _files_of(directory: str) -> list[Path]:
    """All files of a data set."""
    return [path for path in Path(directory).rglob("*") if path.is_file()]


def _devices(device: str) -> list[str]:
    """All GPUs where none is named."""
    if device != "cuda":
        return [device]
    import torch

    return [f"cuda:{k}" for k in range(torch.cuda.device_count())]


def _factory(denoiser: str | None) -> tuple[str | None, "SamplerFactory"]:
    """Content hash of the denoiser, and what makes the samples."""
    from data_gen.samples import make_sampler

    if denoiser is None:
        return None, make_sampler
    from functools import partial

    from nets.denoised import denoised_sampler
    from nets.weights import load_weights

    return load_weights(denoiser).info.content_hash, partial(denoised_sampler, weights=str(Path(denoiser).resolve()))


def _with_picture(reliefs: Any, path: str) -> Any:
    """The pattern with the rows of a picture file."""
    import numpy as np

    from data_gen.patterns import picture_rows
    from warp_caustics.io.images import read_image

    grey = np.asarray(read_image(path).values).mean(axis=0)
    return reliefs.model_copy(update={"rows": picture_rows(grey)})


def _announce(
    console: Console,
    directory: str,
    config: "DatasetConfig",
    factory: "SamplerFactory",
    devices: list[str],
    workers: int | None,
) -> None:
    """Say how large the data set will be and how long it takes, from one sample made here."""
    import time

    from data_gen.store import estimate

    sampler = factory(config, devices[0])
    sizes = estimate(directory, config, sampler.fields)
    console.line(
        f"size       {_size(sizes.bytes_total)} in {sizes.shards_total} shards, {_size(sizes.bytes_missing)} "
        f"to build, {_size(sizes.free_bytes)} free"
    )
    if not sizes.shards_missing:
        return
    # The first draw compiles kernels and plans memory.
    batch = range(min(config.samples_per_shard, config.n_samples) if devices[0].startswith("cuda") else 1)
    started = time.perf_counter()
    sampler.draw(batch)
    if time.perf_counter() - started < 5.0:
        started = time.perf_counter()
        sampler.draw(batch)
    per_sample = (time.perf_counter() - started) / len(batch)
    left = sizes.shards_missing * config.samples_per_shard * per_sample / len(devices)
    console.line(f"time       about {_duration(left)}, {per_sample * 1e3:.3g} ms a sample on {', '.join(devices)}")


def _size(size: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
