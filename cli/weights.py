"""``nsfc weights``: what is in a weights file, and whether it is what was written."""

from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console
from cli.options import json_option

if TYPE_CHECKING:
    from nets.weights import WeightsInfo


USES = {
    "denoiser": "photon noise of simulated images, for nsfc",
    "direct": "image to heights, for direct, fibres, auto and inspect",
    "direct-family": "the same on other benches, which it is told of",
    "updater": "the step of nsfc",
    "updater-no-denoiser": "the step of nsfc without its denoiser (ablation)",
    "updater-no-gradient": "the step of nsfc without the gradient (ablation)",
}
"""What each shipped network is for."""


@click.group()
def weights() -> None:
    """List, inspect and verify the weights of networks."""


@weights.command(name="list")
@json_option
def list_(as_json: bool) -> None:
    """List the networks that come with the software: what they are for, and their files."""
    from nets.shipped import shipped_weights
    from nets.weights import weights_info

    console, records = Console(as_json), []
    for file in shipped_weights():
        found = weights_info(file)
        uses = USES.get(file.stem, "")
        scene = found.scene
        console.line(
            f"{file.stem:<20}  {found.architecture.kind:<9} {found.parameters / 1e6:4.1f} M parameters, "
            f"{scene.height_samples}^2 heights, {scene.image_pixels}^2 pixels, "
            f"{found.training.get('steps', '?')} steps: {uses}"
        )
        records.append({"file": str(file), "use": uses, **described(found)})
    console.line("nsfc weights info FILE tells more; files lie in " + str(shipped_weights()[0].parent))
    console.record({"networks": records})


@weights.command()
@click.argument("file", metavar="FILE")
@json_option
def info(file: str, as_json: bool) -> None:
    """Print architecture, size, receptive field, scene and training of a network; the file is verified too.

    Of its training: settings, ranges of its reliefs, date, commit, licence, devices, and every training before it.
    """
    from nets.weights import load_weights

    console, record = Console(as_json), described(load_weights(file).info)
    for key, value in _flat(record):
        console.line(f"{key:<34}  {value}")
    console.record({"file": file, **record})


@weights.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True)
@json_option
def verify(files: tuple[str, ...], as_json: bool) -> int:
    """Check that files hold what was written and fit their architecture; the exit code is that of the first bad one."""
    from nets.weights import load_weights
    from warp_caustics.errors import CausticsError

    console, results, code = Console(as_json), [], 0
    for file in files:
        try:
            found = load_weights(file).info
        except CausticsError as error:
            click.echo(f"error: {error}", err=True)
            results.append({"file": file, "ok": False, "error": str(error)})
            code = code or error.exit_code
        else:
            console.line(f"{file}: ok, {found.architecture.kind}, {found.parameters} parameters, {found.content_hash}")
            results.append({"file": file, "ok": True, "content_hash": found.content_hash})
    console.record({"ok": code == 0, "files": results})
    return code


def described(found: "WeightsInfo") -> dict[str, Any]:
    """Everything about a network, as JSON values."""
    from dataclasses import asdict

    from nets.receptive import receptive_field

    return {
        "architecture": found.architecture.model_dump(mode="json"),
        "parameters": found.parameters,
        "receptive_field": asdict(receptive_field(found.architecture, found.scene)),
        "scene": found.scene.model_dump(mode="json"),
        "precision": found.precision,
        "data_fingerprint": found.data_fingerprint,
        "training": dict(found.training),
        "code": dict(found.code),
        "content_hash": found.content_hash,
    }


def _flat(record: dict[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """One line per value, keys of nested records joined by dots."""
    lines = []
    for key, value in record.items():
        if isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
            value = {str(number): item for number, item in enumerate(value, start=1)}
        if isinstance(value, dict) and value:
            lines += _flat(value, f"{prefix}{key}.")
        else:
            lines.append((f"{prefix}{key}", "-" if value is None else str(value)))
    return lines
