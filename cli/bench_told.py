"""What a reconstruction is told besides the scene: stray light, how sure all is, what to look for and to give."""

from collections.abc import Mapping, Sequence
from typing import Any

from cli.config import Config, ReconstructionConfig
from warp_caustics.errors import InputError

SERVED = ("auto", "direct", "fibres")
"""Methods that look for a bench, and take stray light off."""


def told_options(
    config: Config, bench: str | None, set_up: str | None, priors: Sequence[str], samples: int | None = None
) -> Config:
    """The configuration with what options and a calibrated bench say; what it holds already wins over the bench.

    Args:
        config: of the run.
        bench: bench.yaml of a calibration; None is none.
        set_up: known or estimate; None leaves it to the configuration.
        priors: NAME=WIDTH each.
        samples: reliefs to give besides; None leaves it to the configuration.

    Raises:
        InputError: a search, widths or samples for a method that knows none.
    """
    from cli.calibration.shots import named_numbers

    reconstruction = config.reconstruction
    options: dict[str, Any] = dict(reconstruction.options)
    widths = named_numbers(priors, "--prior")
    if reconstruction.method not in SERVED:
        asked = "--set-up estimate" if set_up == "estimate" else "--prior" if widths else ""
        if samples:
            raise InputError(
                f"--samples {samples} is for --method {', '.join(SERVED)}; {reconstruction.method} finds one relief "
                "and knows of no other"
            )
        if asked:
            raise InputError(f"{asked} is for --method {', '.join(SERVED)}, not {reconstruction.method}")
        return config
    if set_up is not None:
        options["set_up"] = set_up
    if samples is not None:
        options["samples"] = samples
    before = {} if bench is None else _of_bench(bench)
    known = before.pop("priors", {}) | dict(options.pop("priors", {})) | widths
    options = before | options | ({"priors": known} if known else {})
    return config.model_copy(
        update={"reconstruction": ReconstructionConfig(method=reconstruction.method, options=options)}
    )


def _of_bench(path: str) -> dict[str, Any]:
    """Options of a calibrated bench: its stray light, and the deviations of its numbers."""
    from warp_caustics.calibration.bench_file import read_bench
    from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
    from warp_caustics.found_bench.thin_relief import PICTURE

    bench = read_bench(path)
    ambient = bench.camera.ambient
    stray = ambient if isinstance(ambient, tuple) else (ambient,)
    told: dict[str, Any] = {}
    if any(value > 0 for value in stray):
        told["ambient"] = sum(stray) / len(stray)
    numbers, sigmas = BenchNumbers.of(bench.whole_scene()), bench.priors()
    names = {p.name for p in (*numbers.parameters, *numbers.not_told, *PICTURE)}
    widths = {name: width for name, width in sigmas.items() if name in names} | _stray_width(sigmas, AMBIENT)
    # The picture's place is the camera's there; capture takes its pixels to those of the window, one to one.
    for axis, pixel in zip("xy", bench.whole_scene().pixel_size_m, strict=True):
        if f"shift_{axis}_px" in sigmas:
            widths[f"screen_{axis}_m"] = sigmas[f"shift_{axis}_px"] * pixel
    return told | ({"priors": widths} if widths else {})


def _stray_width(priors: Mapping[str, float], name: str) -> dict[str, float]:
    """Of the mean over wavelengths; their errors go together."""
    own = [width for key, width in priors.items() if key.partition(".")[0] == name]
    return {name: sum(own) / len(own)} if own else {}
