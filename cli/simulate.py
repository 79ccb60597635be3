"""``nsfc simulate``: from a height map to its caustic."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from cli.console import Console
from cli.options import bench_option, config_options, device_option, integer, json_option, number, seed_option
from warp_caustics.device import start_device

if TYPE_CHECKING:
    from warp_caustics.scene import Scene

PHOTONS_PER_PIXEL = 64
"""Of a lattice, where nobody says how many: sixteen times as many as methods simulate with. An image that is kept is to
be right to a third of a percent of flat light, and fits of lines see a percent (warp_caustics/extrapolated.py)."""
LEAST_OVER_BORDER = 1e-4
"""Share of the light beyond the image's border that is worth a word."""


_SAMPLES = "scene.height_samples"


@click.command()
@click.argument("heights", type=click.Path())
@click.option("-o", "--output", type=click.Path(), required=True, help="Image: .tif, .png, .exr, .npy, .npz or .h5.")
@click.option("--noise", type=number, default=0.0, metavar="SHARE", help="White noise, of flat light: 0.01 is 1 %.")
@click.option("--preset", help="Photon set: lattice (sharp, without noise) or paper (random, s = 16).")
@click.option("--n-photons", type=integer, help="n_l: light paths per wavelength; 64 a pixel on a lattice.")
@click.option("--smoothing", type=number, help="s: scales the photon footprint.")
@click.option("--placement", help="Where photons start: lattice, stratified, sobol or random.")
@click.option(
    "--camera",
    metavar="FILE|NAME",
    help="YAML file of a camera, careful, ordinary, poor, or bench (that of --bench): writes a photo of 16 bits "
    "with its "
    "dark and flat frames.",
)
@click.option("--force", is_flag=True, help="Replace OUTPUT if it exists.")
@bench_option
@seed_option
@device_option
@config_options
@json_option
def simulate(
    heights: str,
    output: str,
    noise: float,
    preset: str | None,
    n_photons: int | None,
    smoothing: float | None,
    placement: str | None,
    camera: str | None,
    force: bool,
    bench: str | None,
    seed: int | None,
    device: str,
    config_source: str | None,
    settings: tuple[str, ...],
    as_json: bool,
) -> None:
    """Simulate the caustic of HEIGHTS, a map of the relief in metres, a list of printed lines or a design.

    Maps are .npy, .npz, .tif or .h5 files, lists and designs .csv or .yaml. The number of height samples is that of the
    map, unless --config or --set say otherwise.
    """
    import numpy as np

    from cli.config import load_config
    from cli.output import check_file
    from cli.shipped_files import config_files
    from warp_caustics.errors import InputError
    from warp_caustics.io.images import write_image
    from warp_caustics.prints.relief_file import read_relief

    options = {
        "preset": preset, "n_photons": n_photons, "smoothing": smoothing, "placement": placement, "seed": seed,
    }  # fmt: skip
    if not 0 <= noise <= 1:
        raise InputError(f"--noise {noise:g} is not between 0 and 1, parts of flat light; 0.01 is 1 %")
    overrides = {f"simulation.{key}": value for key, value in options.items()}
    config = load_config(config_source, settings, overrides, bench=bench)
    if config_source is None and not any(setting.strip().startswith(_SAMPLES) for setting in settings):
        config = load_config(None, settings, {**overrides, _SAMPLES: _samples_of(heights)}, bench=bench)
    scene = config.scene
    relief = read_relief(heights, scene.height_samples, scene.plate_size_m, "height map")
    inputs: list[str | Path] = [heights, *config_files(config_source), *([] if bench is None else [bench])]
    check_file(output, force, inputs)
    if camera is None:
        _check_output(output, config.scene)
    else:
        from cli.photo_job import PhotoJob, camera_source

        photo = PhotoJob.checked(camera_source(camera, bench), output, scene, inputs, noise=noise, force=force)

    import torch

    from warp_caustics.energy import check_reaches, energy_budget
    from warp_caustics.simulator import CausticSimulator

    photons = config.simulation.model_dump(exclude={"deterministic"})
    if photons["n_photons"] is None and photons["preset"] == "lattice":
        photons["n_photons"] = PHOTONS_PER_PIXEL * scene.image_pixels**2
    simulator = CausticSimulator(config.scene, device=start_device(device), **photons)
    on_device = torch.tensor(relief, dtype=simulator.dtype, device=simulator.device)
    start = time.perf_counter()
    on_screen = simulator(on_device)
    image = on_screen.cpu().numpy()
    elapsed_s = time.perf_counter() - start
    budget = energy_budget(simulator, on_device, on_screen)
    check_reaches(budget)
    console = Console(as_json)
    made: dict[str, Any] = {}
    if camera is not None:
        made = photo.write(simulator, on_screen, config.simulation.seed)
        console.warn(*made.pop("warnings"))
    elif noise > 0:
        flat = np.array(scene.radiosity_W_m2, np.float32)[:, None, None]
        drawn = np.random.default_rng(config.simulation.seed).standard_normal(image.shape, np.float32)
        # A camera does not count below zero.
        image = np.maximum(image + noise * flat * drawn, 0.0)
    if camera is None:
        write_image(output, image, wavelengths_m=scene.wavelengths_m, pixel_size_m=scene.pixel_size_m)

    record: dict[str, Any] = {
        "output": output,
        "time_s": elapsed_s,
        "noise": noise,
        "min_irradiance_W_m2": image.min(axis=(1, 2)),
        "max_irradiance_W_m2": image.max(axis=(1, 2)),
        "mean_irradiance_W_m2": image.mean(axis=(1, 2), dtype=np.float64),
        "energy": budget,
        "settings": simulator.settings(),
        "config_fingerprint": config.fingerprint(),
        **made,
    }
    if camera is None:
        console.line(f"image      {output}, {' x '.join(map(str, image.shape))}")
    else:
        console.line(*photo.lines(made))
    console.line(
        f"photons    {simulator.n_photons} per wavelength, {simulator.plan.placement}, s = {simulator.smoothing:g}"
    )
    console.line(f"time       {elapsed_s:.2f} s on {simulator.device}")
    console.line(f"irradiance {image.min():.4g} to {image.max():.4g} W/m^2")
    console.line(*energy_lines(budget))
    console.record(record)


def _samples_of(heights: str) -> int | None:
    """Samples per side of a height map; None for a list of lines, which has none."""
    from warp_caustics.io.heights import read_heights
    from warp_caustics.prints.line_list import is_line_list

    return None if is_line_list(heights) else len(read_heights(heights))


def energy_lines(budget: dict[str, Any]) -> list[str]:
    """What became of the light, one line per wavelength."""
    fates = [key for key in budget if key not in ("wavelengths_m", "emitted_W", "over_border")]
    lines = []
    for channel, wavelength in enumerate(budget["wavelengths_m"]):
        parts = [f"{100 * budget[fate][channel]:.4g} % {fate.replace('_', ' ')}" for fate in fates]
        if budget.get("over_border", [0.0] * (channel + 1))[channel] >= LEAST_OVER_BORDER:
            over = budget["over_border"][channel]
            parts[0] += f" (of it {100 * over:.3g} % over the border of the image, by the width of footprints)"
        lines.append(f"light      {wavelength * 1e9:.0f} nm: {', '.join(parts)}")
    return lines


def _check_output(output: str, scene: "Scene") -> None:
    """Refuse an output that cannot be written before the simulation instead of after it."""
    import tempfile

    import numpy as np

    from warp_caustics.errors import InputError
    from warp_caustics.io.images import write_image

    target = Path(output)
    try:
        with tempfile.TemporaryDirectory(prefix=".nsfc-", dir=target.parent) as folder:
            probe = Path(folder, f"probe{target.suffix}")
            # So wide that the channels are the smallest axis, as they are in the image itself.
            side = min(scene.image_pixels, max(8, scene.n_wavelengths + 1))
            write_image(probe, np.ones((scene.n_wavelengths, side, side)), wavelengths_m=scene.wavelengths_m)
    except InputError as error:
        raise InputError(str(error).replace(str(probe), output)) from error
    except OSError as error:
        raise InputError(f"folder {str(target.parent)!r} cannot be written to ({error.strerror}); create it") from error
