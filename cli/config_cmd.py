"""``nsfc config``: look at configurations."""

import rich_click as click

from cli.console import Console
from cli.options import json_option


@click.group()
def config() -> None:
    """Show or check configurations."""


_file = click.argument("source", metavar="[FILE|NAME]", required=False)
_set = click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Override one value; repeatable.")


@config.command()
@_file
@_set
@json_option
def show(source: str | None, settings: tuple[str, ...], as_json: bool) -> None:
    """Print the complete configuration, every default filled in, as YAML."""
    from cli.config import dump_config, load_config

    console, found = Console(as_json), load_config(source, settings)
    console.line(dump_config(found).rstrip())
    console.record(found.model_dump(mode="json"))


@config.command()
@_file
@_set
@json_option
def check(source: str | None, settings: tuple[str, ...], as_json: bool) -> None:
    """Check a configuration, the reconstruction method's options included; exit code 3 where something is wrong."""
    from cli.config import load_config
    from cli.job import make_method

    console, found = Console(as_json), load_config(source, settings)
    make_method(found, "cpu")
    scene = found.scene
    console.line(
        f"{source or 'defaults'}: ok, {scene.height_samples}^2 heights, {scene.image_pixels}^2 pixels, "
        f"{scene.n_wavelengths} wavelengths, method {found.reconstruction.method}"
    )
    console.record({"ok": True, "source": source, "fingerprint": found.fingerprint()})
