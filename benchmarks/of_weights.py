"""Everything that was measured or fitted with the networks that ship, and so has to change with them.

    python -m benchmarks.of_weights            # what is out of date for nets/trained; exit code 1 if anything is
    python -m benchmarks.of_weights --all      # every place, with the command of its figures

Each place names the weights it was last measured with, by the first eight digits of their content hash (``nsfc weights
info``). Whoever replaces weights goes through the list, measures again or says on the page that figures are of
earlier weights, and writes the new hash, or :data:`EARLIER`, here. A test does not pass before.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]

EARLIER = "earlier"
"""In place of a hash: the page says that its figures are of earlier weights."""

DIRECT = {"direct": "035b3b3b"}
NSFC = {"denoiser": "d32ff12e", "updater": "5365d754"}
ABLATIONS = {**NSFC, "updater-no-denoiser": "83330354", "updater-no-gradient": "e6ed5cbc"}
OLD = {"direct": EARLIER}
FAMILY = {"direct-family": "04fdebcc"}
OLD_FAMILY = {"direct-family": EARLIER}


@dataclass(frozen=True)
class Place:
    """Figures or constants that belong to weights.

    Attributes:
        file: relative to the repository.
        mark: text in it, at or above what changes: a heading, a constant.
        weights: hash of each network, by the stem of its file.
        command: gives it anew.
    """

    file: str
    mark: str
    weights: dict[str, str]
    command: str


CONDITIONS = "python -m benchmarks.robustness --device cuda"
OWN = f"{CONDITIONS} --own 777001 --fields 60"
LEARNED = "python -m benchmarks.learned iterations --iterations 20 --device cuda"
COMPARE = "nsfc compare --testset"
RELEASE = "python -m benchmarks.release --device cuda"

PLACES = (
    # Constants in the code.
    Place("nets/reconstruct/uncertainty.py", "DIRECT_CALIBRATION =", DIRECT, f"{OWN} --calibrate"),
    Place(
        "nets/reconstruct/uncertainty.py", "FAMILY_CALIBRATION =", FAMILY, "python -m benchmarks.family --told nearly"
    ),
    Place("nets/reconstruct/refinement.py", "TRUSTED_M =", OLD, "--method direct on a bare plate with 1 % of noise"),
    Place("nets/reconstruct/refinement.py", "TRUSTED_BESIDE_CAMERA_M =", OLD, OWN),
    Place("nets/shipped.py", "FEWEST_STEPS =", {**DIRECT, **ABLATIONS}, "nsfc weights list"),
    # Stored figures, from which tests/test_figures.py checks the pages.
    Place("benchmarks/robustness_h200.json", '"weights"', DIRECT, f"{CONDITIONS}, on the CPU too; {OWN}; {COMPARE}"),
    Place("benchmarks/learned_h200.json", "iterations/full", ABLATIONS, LEARNED),
    Place("benchmarks/bench.json", '"weights"', {**DIRECT, **FAMILY}, "make bench-lab"),
    Place("benchmarks/release.json", '"cells"', {**DIRECT, **FAMILY, **ABLATIONS}, RELEASE),
    Place("benchmarks/auto_cpu.json", '"rmse_um"', {**DIRECT, **FAMILY}, "nsfc bench run --suite ideal --methods auto"),
    Place("benchmarks/conditioning.json", '"weights"', DIRECT, "python -m benchmarks.conditioning --device cuda"),
    Place("docs/training.md", "### Ways to be told", DIRECT, "python -m benchmarks.conditioning --device cuda"),
    # Pages.
    Place("README.md", "## What it reaches", {**DIRECT, **NSFC}, "benchmarks/robustness_h200.json, learned_h200.json"),
    Place("docs/start.md", "## Read the result", DIRECT, "make demo"),
    Place("docs/learned.md", "## Measured", {**DIRECT, **NSFC}, CONDITIONS),
    Place("docs/learned.md", "### Thirty test fields", {**DIRECT, **FAMILY, **ABLATIONS}, RELEASE),
    Place("docs/learned.md", "### The camera", DIRECT, OWN),
    Place("docs/learned.md", "### Noise and exposure", OLD, "python -m benchmarks.learned noise; exposure"),
    Place("docs/learned.md", "### The paper's iteration", {**OLD, **ABLATIONS}, LEARNED),
    Place("docs/learned.md", "### Symmetries and refinement", OLD, f"{OWN} --set refine_iterations=60"),
    Place("docs/fibres.md", "# The printed lines: `fibres`", DIRECT, f"{COMPARE} --methods direct,fibres"),
    Place(
        "docs/fibres_search.md",
        "## Prints as machines make them",
        DIRECT,
        "own plates of rows of prints: data_gen.suites.print_shapes with another SEED",
    ),
    Place("docs/learned.md", "## Uncertainty", DIRECT, f"{OWN} --calibrate"),
    Place("docs/any_image.md", "## What it costs", {**DIRECT, **FAMILY}, "python -m benchmarks.any_image --force"),
    Place(
        "benchmarks/lines_elsewhere.json",
        '"plates"',
        {**DIRECT, **FAMILY},
        "python -m benchmarks.lines_elsewhere; docs/found_bench.md",
    ),
    Place("docs/found_bench.md", "## Measured", {**DIRECT, **OLD_FAMILY}, "python -m benchmarks.found_bench"),
    Place("docs/lab.md", "## What the walk takes", DIRECT, "make demo"),
    Place("docs/compare.md", "## The ten development fields", {**OLD, **NSFC}, COMPARE),
    Place("docs/compare.md", "## Images of another renderer", OLD, "the command on the page"),
    Place("docs/bench.md", "## Figures", {**DIRECT, **FAMILY}, "make bench-lab"),
    Place("docs/inspect.md", "## How the plate is recovered", OLD, "python -m benchmarks.inspection"),
    Place("docs/inspect.md", "## Measured", OLD, "python -m benchmarks.inspection"),
    Place("docs/capture.md", "### Blur", OLD, CONDITIONS),
    Place("docs/capture.md", "## Measured", OLD, "nsfc capture, nsfc reconstruct --method direct of the photos there"),
    Place(
        "docs/training.md",
        "## The networks that ship",
        {**DIRECT, **FAMILY, **ABLATIONS},
        "nsfc weights info; metrics.csv",
    ),
    Place("docs/training.md", "### The direct network", DIRECT, "the commands of its training, metrics.csv"),
    Place("docs/training.md", "### The network that is told of its bench", FAMILY, "the same of its training"),
    Place("docs/learned.md", "## Scenes", {**DIRECT, **FAMILY}, "nsfc bench run --suite lab --rows another"),
)


def shipped() -> dict[str, str]:
    """Content hash of every shipped network, eight digits, by the stem of its file."""
    from nets.weights import weights_info

    files = sorted((ROOT / "nets" / "trained").glob("*.safetensors"))
    return {path.stem: weights_info(path).content_hash[:8] for path in files}


def out_of_date(weights: dict[str, str], places: tuple[Place, ...] = PLACES) -> list[str]:
    """A line for each place that names other weights than these."""
    told = []
    for place in places:
        old = [
            f"{name} {seen} -> {weights.get(name, 'none')}"
            for name, seen in place.weights.items()
            if seen not in (EARLIER, weights.get(name))
        ]
        if old:
            told.append(f"{place.file}, {place.mark}: {', '.join(old)}; {place.command}")
    return told


def main(arguments: list[str] | None = None) -> int:
    """Print the places."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("--all", action="store_true", help="every place, up to date or not")
    options: Any = parser.parse_args(arguments)
    told = out_of_date(shipped())
    if options.all:
        lines = [
            f"{p.file}, {p.mark}: {' '.join(f'{k} {v}' for k, v in p.weights.items())}; {p.command}" for p in PLACES
        ]
        print("\n".join(lines))
    else:
        print("\n".join(told) if told else "every place names the weights that ship")
    return 1 if told and not options.all else 0


if __name__ == "__main__":
    sys.exit(main())
