"""One plate: read, reconstruct, compare with the design, write."""

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cli.console import Console
from cli.garbage import loaded
from cli.inputs import read_files, read_inputs
from cli.inspection.files import INSPECTION, inspection_record, write_inspection
from cli.output import result_folder
from cli.provenance import file_records, file_sha256
from cli.results import result_record, trust_lines, write_results
from warp_caustics.capture.settings import capture_files, capture_settings, is_capture_file
from warp_caustics.device import start_device
from warp_caustics.errors import EXIT_FAILED
from warp_caustics.io.json_file import json_text
from warp_caustics.io.printable import printable

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from cli.config import Config
    from nets.inspection.from_nominal import FromNominal
    from warp_caustics.inspection.findings import Inspection
    from warp_caustics.inspection.nominal import Nominal

EXIT_CODES = {"pass": 0, "fail": EXIT_FAILED, "uncertain": EXIT_FAILED}
"""Exit code of each verdict: a plate that cannot be shown to be good does not pass."""


@dataclass(frozen=True, eq=False)
class InspectionOutcome:
    """What became of one plate.

    Attributes:
        inspection: comparison with the design.
        record: the same as in inspection.json.
    """

    inspection: "Inspection"
    record: Mapping[str, Any]

    @property
    def exit_code(self) -> int:
        return EXIT_CODES[self.inspection.verdict]


@dataclass(eq=False)
class InspectionJob:
    """An inspection but for its image; the networks are loaded once, with the first.

    Attributes:
        config: scene, and options of the reconstruction.
        nominal: what was to be printed.
        judged: True where the plate is judged, shape [n, n].
        tolerance_m: [m].
        margin_m: border that is not judged [m], for the record.
        density_kg_m3: of the glass; None takes that of the scene's.
        is_placed: the picture lies where the design says.
        files: paths by role: nominal, mask.
        capture: options on how to read an image, see :mod:`cli.capture_options`.
        device: value of --device.
        force: replace earlier results.
        console: where to report.
    """

    config: "Config"
    nominal: "Nominal"
    judged: "npt.NDArray[np.bool_]"
    tolerance_m: float
    margin_m: float
    density_kg_m3: float | None
    is_placed: bool
    files: Mapping[str, str]
    capture: Mapping[str, Any]
    device: str
    force: bool
    console: Console
    kind = INSPECTION
    _method: "FromNominal | None" = None

    @cached_property
    def settings(self) -> str:
        """Hash of all that a verdict depends on besides the image."""
        frames = {key: value for key, value in self.capture.items() if value is not None}
        calibration = capture_files(None, capture_settings(self.capture))
        tree = {
            "config": self.config.fingerprint(),
            "files": {kind: file["sha256"] for kind, file in file_records(self.files).items()},
            "n_lines": len(self.nominal.lines),
            "tolerance_m": self.tolerance_m,
            "margin_m": self.margin_m,
            "density_kg_m3": self.density_kg_m3,
            "capture": frames,
        }
        if self.is_placed:
            tree["is_placed"] = True
        if self.nominal.section != "cosine":
            tree["section"] = self.nominal.section  # left out where it is as always, so that older tables stay valid
        if calibration:
            # Another dark frame under the same name makes another image.
            tree["calibration"] = {kind: file["sha256"] for kind, file in file_records(calibration).items()}
        return hashlib.sha256(json_text(tree).encode()).hexdigest()[:16]

    def content(self, image: str) -> str:
        """Hash of all that is read as an image: its file, or a capture file with its frames."""
        own = capture_files(image, capture_settings(self.capture, image)) if is_capture_file(image) else {}
        if not own:
            return file_sha256(image)
        records = {kind: file["sha256"] for kind, file in file_records(own).items()}
        return hashlib.sha256(json_text(records).encode()).hexdigest()

    def reads(self, image: str) -> list[str]:
        """Every file that is read for an image."""
        return read_files(image, self.files, self.capture)

    def method(self) -> "FromNominal":
        """The reconstruction, made at the first call.

        Raises:
            InputError: options that it does not know.
        """
        if self._method is None:
            from nets.inspection.from_nominal import FromNominal, FromNominalOptions

            options = FromNominalOptions(**self.config.reconstruction.options)
            self._method = FromNominal(self.config.scene, options, start_device(self.device))
            loaded()  # all that an inspection computes with
        return self._method

    def run(self, image: str, target: Path, output: str, force: bool = False) -> InspectionOutcome:
        """Inspect one plate and write its result.

        Args:
            image: path.
            target: folder that :func:`cli.output.check_target` returned.
            output: the same as a person wrote it.
            force: replace an earlier result, whatever --force says.

        Raises:
            KeyboardInterrupt: Ctrl-C; nothing is written, a measurement cut short judges no plate.
        """
        from warp_caustics.inspection.judge import doubted, judge_plate

        console, config = self.console, self.config
        inputs = read_inputs({"image": image, **self.files}, config.scene, capture_settings(self.capture, image))
        for warning in inputs.capture.warnings:
            console.warn(warning)
        method = self.method()
        title = printable(os.path.basename(image))
        with result_folder(target, force or self.force, self.kind) as folder:
            with console.progress() as progress:
                found = method.reconstruct(inputs.caustic, self.nominal, progress=progress)
            plate = found.reconstruction
            if plate.stop_reason == "interrupted":
                raise KeyboardInterrupt
            inspection = judge_plate(
                plate.heights_m,
                self.nominal,
                config.scene,
                self.tolerance_m,
                sigma_m=plate.uncertainty_m,
                fitted=found.lines,
                mask=self.judged,
                density_kg_m3=self.density_kg_m3,
                is_placed=self.is_placed,
            )
            inspection = doubted(inspection, plate.trust)
            result = result_record(plate, inputs, config)
            record = {
                "image": image,
                "design": self.nominal.origin,
                **inspection_record(inspection),
                "trust": result["trust"],
                "residual": plate.residual,
                "uncertainty": result["uncertainty"],
                "no_uncertainty": result["no_uncertainty"],
                "timings_s": plate.timings_s,
                "inputs": inputs.files,
                "config_fingerprint": config.fingerprint(),
                "versions": result["versions"],
                "created": result["created"],
            }
            write_results(folder, plate, inputs, config, result, inspection)
            write_inspection(folder, inspection, config.scene, title, record)
        for warning in (*plate.warnings, *inspection.warnings):
            console.warn(warning)
        for line in summary(output, inspection, record):
            console.line(line)
        return InspectionOutcome(inspection, {"output": output, **record})


def summary(output: str, found: "Inspection", record: Mapping[str, Any]) -> list[str]:
    """A few lines for people."""
    odd = [fibre for fibre in found.fibres if fibre.status != "as designed"]
    lines = [*trust_lines(record), f"verdict    {found.verdict}", *(f"           {reason}" for reason in found.reasons)]
    lines.append(
        f"deviation  RMS {record['rms_deviation_m'] * 1e6:.3g} um, largest {record['peak_deviation_m'] * 1e6:.4g} um; "
        f"tolerance {found.tolerance_m * 1e6:g} um along the surface's normal"
    )
    lines.append(
        f"volume     {found.volume_m3 * 1e9:.4g} mm^3 (nominal {found.nominal_volume_m3 * 1e9:.4g}), "
        f"{found.mass_kg * 1e3:.4g} g"
    )
    if found.place is not None:
        lines.append(f"picture    {found.place.line}")
    if found.fibres:
        lines.append(f"fibres     {len(found.fibres)}, {len(found.fibres) - len(odd)} as designed")
    lines.append(f"residual   {record['residual']:.4g} of the image")
    lines.append(f"result     {output}: inspection.png, report.html, inspection.json, regions.csv, ...")
    return lines
