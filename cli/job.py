"""A reconstruction but for its image: read, reconstruct, write, tell."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cli.config import Config
from cli.console import Console
from cli.garbage import loaded
from cli.inputs import Inputs, read_files, read_inputs
from cli.output import result_folder
from cli.results import RECONSTRUCTION, result_record, summary, write_results
from warp_caustics.capture.settings import capture_settings
from warp_caustics.device import start_device

if TYPE_CHECKING:
    from warp_caustics.reconstruct.base import ProgressCallback, Reconstruction, Reconstructor


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

    config: Config
    files: Mapping[str, str]
    capture: Mapping[str, Any]
    from_transport: bool
    device: str
    force: bool
    console: Console
    kind = RECONSTRUCTION

    def reads(self, image: str) -> list[str]:
        """Every file that is read for an image."""
        return read_files(image, self.files, self.capture)

    @cached_property
    def started_device(self) -> str:
        """The device, checked and started at the first use."""
        return start_device(self.device)

    @cached_property
    def method(self) -> "Reconstructor":
        """The method, made at the first use.

        Raises:
            InputError: unknown, or options that it does not know.
        """
        method = make_method(self.config, self.started_device)
        loaded()  # all that a reconstruction computes with
        return method

    def run(self, image: str, target: Path, output: str) -> Outcome:
        """Reconstruct one image and write its result.

        Args:
            image: path.
            target: folder that :func:`cli.output.check_target` returned.
            output: the same as a person wrote it.
        """
        from nets.reconstruct.with_causes import explained

        settings = capture_settings(self.capture, image)
        inputs = read_inputs({"image": image, **self.files}, self.config.scene, settings)
        self.console.warn(*inputs.capture.warnings)
        method = self.method
        with result_folder(target, self.force, self.kind) as folder:
            self._announce(method, inputs)
            with self.console.progress() as progress:
                if self.from_transport:
                    result, inputs = self._from_transport(inputs, progress)
                else:
                    result = method.reconstruct(inputs.caustic, initial=inputs.initial, progress=progress)
                result = explained(result, inputs.caustic, self.config.scene, self.started_device)
            record = result_record(result, inputs, self.config)
            write_results(folder, result, inputs, self.config, record)
        self.console.warn(*result.warnings)
        self.console.line(*summary(output, result, record))
        return Outcome(result, record)

    def _announce(self, method: "Reconstructor", inputs: Inputs) -> None:
        """Say what ``auto`` will do."""
        choose = getattr(method, "choose", None)
        if choose is not None and not self.from_transport:
            choice = choose(inputs.caustic, inputs.initial)
            self.console.line(f"auto       {choice.plan}: {choice.why}")

    def _from_transport(self, inputs: Inputs, progress: "ProgressCallback | None") -> tuple["Reconstruction", Inputs]:
        """Result of the method when it starts where transport ends, and the inputs with that start.

        Ctrl-C before the method starts makes what transport found so far the result.
        """
        from warp_caustics.reconstruct.transport.transport import transport_initial, with_initial

        start = transport_initial(self.config.scene, inputs.caustic, self.started_device, progress)
        inputs = replace(inputs, initial=start.heights_m)
        if start.stop_reason == "interrupted":
            return start, inputs
        result = self.method.reconstruct(inputs.caustic, initial=start.heights_m, progress=progress)
        return with_initial(result, start), inputs


def make_method(config: Config, device: str) -> "Reconstructor":
    """The configured method for the configured scene.

    Raises:
        InputError: unknown, or options that it does not know.
    """
    from nets.reconstruct import methods

    name, options = config.reconstruction.method, config.reconstruction.options
    if name in methods.SEEDED:
        options = {"seed": config.simulation.seed, **options}
    chosen: Reconstructor = methods.create(name, config.scene, device=device, **options)
    return chosen
