"""What a reconstruction is told of its bench besides the scene: stray light, how sure all is, and whether to look."""

from collections.abc import Mapping, Sequence
from typing import Any

from cli.config import Config, ReconstructionConfig
from warp_caustics.errors import InputError

SERVED = ("auto", "direct")
"""Methods that look for a bench, and take stray light off."""


def told_options(config: Config, bench: str | None, set_up: str | None, priors: Sequence[str]) -> Config:
    """The configuration with what options and a calibrated bench say; what it holds already wins over the bench.

    Args:
        config: of the run.
        bench: bench.yaml of a calibration; None is none.
        set_up: known or estimate; None leaves it to the configuration.
        priors: NAME=WIDTH each.

    Raises:
        InputError: widths without a search, or a method that knows none.
    """
    from cli.calibration.shots import named_numbers

    reconstruction = config.reconstruction
    options: dict[str, Any] = dict(reconstruction.options)
    widths = named_numbers(priors, "--prior")
    chosen = set_up or options.get("set_up", "known")
    if widths and chosen != "estimate":
        raise InputError("--prior says how well the bench is known, which --set-up estimate asks; give both")
    if reconstruction.method not in SERVED:
        if set_up == "estimate":
            raise InputError(f"--set-up estimate is for --method {' or '.join(SERVED)}, not {reconstruction.method}")
        return config
    if set_up is not None:
        options["set_up"] = set_up
    before = {} if bench is None else _of_bench(bench, chosen == "estimate")
    known = before.pop("priors", {}) | dict(options.pop("priors", {})) | widths
    options = before | options | ({"priors": known} if known else {})
    return config.model_copy(
        update={"reconstruction": ReconstructionConfig(method=reconstruction.method, options=options)}
    )


def _of_bench(path: str, is_looked_for: bool) -> dict[str, Any]:
    """Options of a calibrated bench: its stray light, and where its numbers are looked for their deviations."""
    from warp_caustics.calibration.bench_file import read_bench
    from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers

    bench = read_bench(path)
    ambient = bench.camera.ambient
    stray = ambient if isinstance(ambient, tuple) else (ambient,)
    told: dict[str, Any] = {}
    if any(value > 0 for value in stray):
        told["ambient"] = sum(stray) / len(stray)
    if is_looked_for:
        numbers = BenchNumbers.of(bench.whole_scene())
        names = {p.name for p in (*numbers.parameters, *numbers.not_told)}
        widths = {name: width for name, width in bench.priors().items() if name in names}
        widths |= _stray_width(bench.priors(), AMBIENT)
        told["priors"] = widths
    return told


def _stray_width(priors: Mapping[str, float], name: str) -> dict[str, float]:
    """Of the mean over wavelengths; their errors go together."""
    own = [width for key, width in priors.items() if key.partition(".")[0] == name]
    return {name: sum(own) / len(own)} if own else {}
