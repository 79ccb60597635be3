"""What the trust of a result is worth: plates on the bench that is told, and on others.

    python -m benchmarks.trust [--plates 12] [--device cpu] [--seed 901727]

Plates of an own seed, three times each: as told; with a gap 300 um wider than told; with ellipses for sections. Of each
the error, the ratio of what is left of the image to what noise and simulation leave (1.5 is the limit), and the share
of its parts that are not explained; first at all pixels, then where the heights were found: on a CPU that is at fewer.
"""

import argparse
import math

from data_gen.dataset_config import DatasetConfig
from data_gen.suites.case import Case, Plate
from data_gen.suites.conditions import CONDITIONS, Condition
from data_gen.suites.light import Light
from data_gen.suites.shot import measured
from nets.reconstruct.methods import create
from nets.reconstruct.network_io import TRAINED_EXPOSURE_ERROR
from warp_caustics.metrics import height_errors
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.trust import Trust
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

GAP_M = 300e-6


def main() -> None:
    """Print a row for each plate and bench."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plates", type=int, default=12)
    parser.add_argument("--seed", type=int, default=901_727)
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    told, plates = Scene(), DatasetConfig(kind="updater", n_samples=arguments.plates, seed=arguments.seed)
    x, y, z = told.screen_position_m
    wider = Scene.model_validate(told.model_dump() | {"screen_position_m": (x, y, z - GAP_M)})
    light, method = Light(arguments.device), create("direct", told, device=arguments.device)
    simulator = CausticSimulator(told, device=arguments.device)
    benches = (("told", told, Condition()), ("gap", wider, Condition()), ("ellipse", told, CONDITIONS["ellipse"]))
    print("bench   plate  RMSE [um]  all pixels: ratio  parts  as shipped: ratio  parts  line")
    for name, scene, condition in benches:
        for number in range(arguments.plates):
            case = Case("trust", name, name, Plate(plates, number), told, scene, condition=condition)
            shot = measured(case, light)
            found = method.reconstruct(shot.image)
            heights = found.heights_m
            seen = Resimulation(simulator, shot.image).exposed(least=TRAINED_EXPOSURE_ERROR).exposed(heights)
            everywhere = seen.through(seen.found_camera(heights)).trust(heights)
            assert found.trust is not None
            error = height_errors(heights, shot.heights_m, told.plate_size_m)["rmse_um"]
            line = found.trust.line.partition(":")[0]
            print(
                f"{name:8}{number:5}{error:11.1f}{told_by(everywhere):>25}{told_by(found.trust):>25}  {line}",
                flush=True,
            )


def told_by(trust: Trust) -> str:
    """Ratio of what is left to what was to be expected, and the share of parts that hold more."""
    if trust.noise is None or trust.places is None:
        return "-"
    return f"{trust.left / math.hypot(trust.noise, trust.simulation):.2f}  {trust.places:6.1%}"


if __name__ == "__main__":
    main()
