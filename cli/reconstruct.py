"""``nsfc reconstruct``: from one caustic image to the printed heights."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.capture_options import capture_options, capture_settings, file_records
from cli.console import Console
from cli.options import config_options, device_option, integer, json_option, number, start_device

if TYPE_CHECKING:
    from cli.config import Config
    from warp_caustics.capture.radiometric import Capture
    from warp_caustics.capture.settings import CaptureSettings
    from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor
    from warp_caustics.scene import Scene
    from warp_caustics.types import FloatArray

EXIT_INTERRUPTED = 130

TRANSPORT = "transport"
"""Value of --initial that is no file; a file of that name is ./transport."""


@click.command()
@click.argument("images", metavar="IMAGE...", nargs=-1, required=True, type=click.Path())
@click.option(
    "-o", "--output", type=click.Path(), required=True, help="Folder for the result; made complete or not at all."
)
@click.option(
    "--method", help="auto, direct, fibres, nsfc, nsfc-unrolled, refine, transport, hcccd or sfc. [default: auto]"
)
@capture_options
@click.option(
    "--initial",
    metavar="FILE|transport",
    help="Height map to start from, or transport: what that method finds. [default: the method's choice]",
)
@click.option("--reference", type=click.Path(), help="True height map; errors are reported against it.")
@click.option("--max-iterations", type=integer, help="Iterations per stage, at most.")
@click.option("--max-time", type=number, metavar="SECONDS", help="Stop after so many seconds.")
@click.option("--seed", type=integer, help="For methods that draw random numbers, as nsfc does.")
@click.option("--force", is_flag=True, help="Replace an earlier result.")
@device_option
@config_options
@json_option
def reconstruct(
    images: tuple[str, ...],
    output: str,
    method: str | None,
    capture: Mapping[str, Any],
    initial: str | None,
    reference: str | None,
    max_iterations: int | None,
    max_time: float | None,
    force: bool,
    seed: int | None,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> int:
    """Recover the height field behind IMAGE, one caustic (.tif, .png, .exr, .npy, .npz or .h5).

    Of several images, a folder or a pattern, each result goes to OUTPUT/name-of-the-image as soon as it is done.
    Ctrl-C ends the iteration early; the best result so far is still written.
    """
    from cli.batch import image_list, run_batch
    from cli.config import load_config
    from cli.results import check_target

    console = Console(as_json)
    found = image_list(images)
    target = check_target(output, force) if isinstance(found, str) else None
    config = load_config(
        config_source,
        settings,
        {
            "simulation.seed": seed,
            "reconstruction.method": method,
            "reconstruction.options.max_iterations": max_iterations,
            "reconstruction.options.max_time_s": max_time,
        },
    )
    start = None if initial == TRANSPORT else initial
    files = {"initial": start, "reference": reference}
    capture_settings(capture)  # what is wrong with it is wrong for every image
    job = Job(
        config=config,
        files={kind: path for kind, path in files.items() if path is not None},
        capture=capture,
        from_transport=initial == TRANSPORT,
        device=device,
        force=force,
        console=console,
    )
    if target is None:
        return run_batch(job, found, output)
    assert isinstance(found, str)
    outcome = job.run(found, target, output)
    console.record(outcome.record)
    if outcome.is_interrupted:
        click.echo(f"interrupted; the best result so far is in {output}", err=True)
        return EXIT_INTERRUPTED
    return 0


@dataclass(frozen=True)
class Outcome:
    """What became of one image."""

    result: "Reconstruction"
    record: Mapping[str, Any]

    @property
    def is_interrupted(self) -> bool:
        return self.result.stop_reason == "interrupted"


@dataclass(eq=False)
class Job:
    """A reconstruction but for its image; the method is made once, with the first.

    Attributes:
        config: scene, method and options.
        files: paths by role: initial, reference.
        capture: options on how to read an image, see :mod:`cli.capture_options`.
        from_transport: start where that method ends.
        device: value of --device.
        force: replace earlier results.
        console: where to report.
    """

    config: "Config"
    files: Mapping[str, str]
    capture: Mapping[str, Any]
    from_transport: bool
    device: str
    force: bool
    console: Console
    _method: "tuple[Reconstructor, str] | None" = None

    def run(self, image: str, target: Path, output: str) -> Outcome:
        """Reconstruct one image and write its result.

        Args:
            image: path.
            target: folder that :func:`cli.results.check_target` returned.
            output: the same as a person wrote it.
        """
        from cli.results import result_folder, result_record, summary, write_results

        console, config = self.console, self.config
        settings = capture_settings(self.capture, image)
        inputs = read_inputs({"image": image, **self.files}, config.scene, settings)
        for warning in inputs.capture.warnings:
            console.warn(warning)
        method, device = self.method()
        with result_folder(target, self.force) as folder:
            self._announce(method, inputs)
            with console.progress() as progress:
                if self.from_transport:
                    result, inputs = reconstruct_from_transport(method, inputs, config.scene, device, progress)
                else:
                    result = method.reconstruct(inputs.caustic, initial=inputs.initial, progress=progress)
            record = result_record(result, inputs, config)
            write_results(folder, result, inputs, config, record)
        for warning in result.warnings:
            console.warn(warning)
        for line in summary(output, result, record):
            console.line(line)
        return Outcome(result, record)

    def method(self) -> "tuple[Reconstructor, str]":
        """The method, made at the first call, and its device."""
        if self._method is None:
            device = start_device(self.device)
            self._method = make_method(self.config, device), device
        return self._method

    def _announce(self, method: "Reconstructor", inputs: "Inputs") -> None:
        """Say what ``auto`` will do."""
        choose = getattr(method, "choose", None)
        if choose is not None and not self.from_transport:
            choice = choose(inputs.caustic, inputs.initial)
            self.console.line(f"auto       {choice.plan}: {choice.why}")


@dataclass(frozen=True, eq=False)
class Inputs:
    """All that was read.

    Attributes:
        capture: calibrated image.
        initial: relief to start from [m], shape [n, n].
        reference: true relief [m], shape [n, n].
        files: path and sha256 of each file, by its role.
    """

    capture: "Capture"
    initial: "FloatArray | None"
    reference: "FloatArray | None"
    files: Mapping[str, Mapping[str, str]]

    @property
    def caustic(self) -> "CausticImage":
        """The image as methods take it."""
        import numpy as np

        from warp_caustics.reconstruct.base import CausticImage

        noise = self.capture.noise_std
        is_known = bool(np.isfinite(noise).all())
        return CausticImage(self.capture.irradiance, noise if is_known else None, self.capture.mask)


def read_inputs(files: Mapping[str, str], scene: "Scene", settings: "CaptureSettings | None" = None) -> Inputs:
    """Read and check everything a reconstruction needs, before any of it is computed.

    Args:
        files: paths by role: image, and where given initial, reference.
        scene: what they must fit.
        settings: how to read and calibrate the image.
    """
    from warp_caustics.capture.read import read_capture
    from warp_caustics.capture.settings import CaptureSettings, capture_files

    settings = settings or CaptureSettings()
    every_file = {**capture_files(files["image"], settings), **files}
    return Inputs(
        capture=read_capture(files["image"], scene, settings),
        initial=_read_relief(files, "initial", scene),
        reference=_read_relief(files, "reference", scene),
        files=file_records(every_file),
    )


def _read_relief(files: Mapping[str, str], kind: str, scene: "Scene") -> "FloatArray | None":
    from warp_caustics.errors import MismatchError
    from warp_caustics.io.heights import read_heights

    if kind not in files:
        return None
    heights = read_heights(files[kind])
    n = scene.height_samples
    if heights.shape != (n, n):
        raise MismatchError(
            f"{kind} {files[kind]!r} has shape {list(heights.shape)}, the scene [{n}, {n}]; "
            f"resample it, or --set scene.height_samples={len(heights)}"
        )
    return heights


def make_method(config: "Config", device: str) -> "Reconstructor":
    """The configured method for the configured scene."""
    from nets.reconstruct import methods

    name, options = config.reconstruction.method, config.reconstruction.options
    if name in methods.SEEDED:
        options = {"seed": config.simulation.seed, **options}
    chosen: Reconstructor = methods.create(name, config.scene, device=device, **options)
    return chosen


def reconstruct_from_transport(
    method: "Reconstructor", inputs: Inputs, scene: "Scene", device: str, progress: "ProgressCallback | None"
) -> tuple["Reconstruction", Inputs]:
    """Result of a method that starts where transport ends, and the inputs with that start.

    Ctrl-C before the method starts makes what transport found so far the result.
    """
    from warp_caustics.reconstruct.transport.transport import transport_initial, with_initial

    start = transport_initial(scene, inputs.caustic, device, progress)
    inputs = replace(inputs, initial=start.heights_m)
    if start.stop_reason == "interrupted":
        return start, inputs
    return with_initial(method.reconstruct(inputs.caustic, initial=start.heights_m, progress=progress), start), inputs
