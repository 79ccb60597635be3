"""Suite ``one-thing``: ten plates, and one thing at a time that differs from the scene that methods are told."""

import math
from dataclasses import dataclass, field
from typing import Any

from data_gen.config import CurvesConfig, DropsConfig, MeandersConfig, PatternConfig, ReliefConfig, RingsConfig
from data_gen.suites.case import Case, Plate, bench_plates
from data_gen.suites.conditions import CONDITIONS, Condition
from warp_caustics.scene import Scene

SEED = 20_261_201
PLATES = 10

NO_DISPERSION = 1.4633
"""Index of fused silica near the middle of the visible, at every wavelength."""


@dataclass(frozen=True)
class Difference:
    """What is not as told.

    Attributes:
        title: for people.
        condition: of camera and print.
        scene: fields of the scene with other values.
        gap_m: more gap to the screen than told [m].
        shift_px: of the whole image, in a direction of each plate's own [px].
        reliefs: another pattern.
    """

    title: str
    condition: Condition = field(default_factory=Condition)
    scene: dict[str, Any] = field(default_factory=dict)
    gap_m: float = 0.0
    shift_px: float = 0.0
    reliefs: PatternConfig = field(default_factory=ReliefConfig)


def lamp_at(distance_m: float, scene: Scene) -> dict[str, Any]:
    """Fields of a scene with a point source above the plate's centre, whose cone just holds the plate."""
    above = distance_m - scene.base_thickness_m
    corner = math.hypot(*scene.plate_size_m) / 2
    return {
        "emission_half_angle_rad": math.atan(1.05 * corner / above),
        "light_position_m": (0.0, 0.0, distance_m),
    }


def enlarged(share: float) -> Condition:
    """All channels as much too large."""
    return Condition(scaled=(share, share, share), is_displaced=True)


DIFFERENCES: dict[str, Difference] = {
    "nothing": Difference("nothing; 1 % noise"),
    "apart-0.05": Difference("red and blue 0.05 px from green, any direction", CONDITIONS["apart-0.05"]),
    "apart-0.1": Difference("0.1 px", CONDITIONS["apart-0.1"]),
    "apart-0.2": Difference("0.2 px", CONDITIONS["apart-0.2"]),
    "apart-0.3": Difference("0.3 px", CONDITIONS["apart-0.3"]),
    "apart-0.5": Difference("0.5 px", CONDITIONS["apart-0.5"]),
    "blur-0.5": Difference("blur of 0.5 px (std)", CONDITIONS["blur-0.5"]),
    "blur-1": Difference("blur of 1 px", CONDITIONS["blur-1"]),
    "blur-2": Difference("blur of 2 px", CONDITIONS["blur-2"]),
    "noise-3": Difference("noise of 3 % where it is as bright as a flat plate", CONDITIONS["noise-3"]),
    "noise-10": Difference("noise of 10 %", CONDITIONS["noise-10"]),
    "uneven-5": Difference("light uneven by 5 %", CONDITIONS["uneven-5"]),
    "ambient-3": Difference("ambient light of 3 %", CONDITIONS["ambient-3"]),
    "mixing-5": Difference("channels mixed by 5 %", CONDITIONS["mixing-5"]),
    "gap-10um": Difference("gap 10 um wider", gap_m=10e-6),
    "gap-100um": Difference("gap 100 um wider", gap_m=100e-6),
    "base-30um": Difference("base 30 um thicker", scene={"base_thickness_m": 3.03e-3}),
    "base-100um": Difference("base 100 um thicker", scene={"base_thickness_m": 3.1e-3}),
    "no-dispersion": Difference("glass without dispersion, index 1.4633", scene={"glass": NO_DISPERSION}),
    "lamp-1m": Difference("lamp at 1 m instead of infinity", scene=lamp_at(1.0, Scene())),
    "lamp-0.3m": Difference("lamp at 0.3 m", scene=lamp_at(0.3, Scene())),
    "disc-0.5deg": Difference(
        "lamp a disc of half angle 0.5 degrees", scene={"lamp_half_angle_rad": math.radians(0.5)}
    ),
    "tilt-0.2deg": Difference("light tilted by 0.2 degrees", scene={"light_tilt_rad": (math.radians(0.2), 0.0)}),
    "fresnel": Difference("Fresnel losses at both faces", scene={"fresnel": True}),
    "quarter": Difference("section: quarter cosine", CONDITIONS["quarter"]),
    "ellipse": Difference("section: ellipse", CONDITIONS["ellipse"]),
    "parabola": Difference("section: parabola", CONDITIONS["parabola"]),
    "gaussian": Difference("section: Gaussian", CONDITIONS["gaussian"]),
    "squashed": Difference("section: cos^1.2, a squashed crown", CONDITIONS["squashed"]),
    "merge": Difference("crossing lines merge: the highest instead of the sum", CONDITIONS["merge"]),
    "bow-20": Difference("plate bowed by 20 um", CONDITIONS["bow-20"]),
    "meanders": Difference("other prints: meanders", reliefs=MeandersConfig()),
    "curves": Difference("curves", reliefs=CurvesConfig()),
    "rings": Difference("rings", reliefs=RingsConfig()),
    "drops": Difference("round drops", reliefs=DropsConfig()),
    "shift-0.25": Difference("image shifted by 0.25 px", shift_px=0.25),
    "shift-0.5": Difference("image shifted by 0.5 px", shift_px=0.5),
    "shift-1": Difference("image shifted by 1 px", shift_px=1.0),
    "scale-0.2": Difference("image 0.2 % too large", enlarged(2e-3)),
    "scale-0.5": Difference("image 0.5 % too large", enlarged(5e-3)),
    "scale-1": Difference("image 1 % too large", enlarged(1e-2)),
}
"""By row."""


def cases(count: int, seed: int | None = None) -> list[Case]:
    """The cases, row by row, with the first ``count`` plates of each; of another seed than the suite's if given."""
    chosen = SEED if seed is None else seed
    return [
        one_case(row, difference, Plate(bench_plates(chosen, PLATES, difference.reliefs), number))
        for row, difference in DIFFERENCES.items()
        for number in range(count)
    ]


def one_case(row: str, difference: Difference, plate: Plate) -> Case:
    """A plate with one thing that differs."""
    told = plate.config.scene
    x, y, z = told.screen_position_m
    angle = float(plate.rng("shift").uniform(0, 2 * math.pi))
    size_x, size_y = told.pixel_size_m
    # The picture moves against the screen.
    x -= difference.shift_px * math.cos(angle) * size_x
    y -= difference.shift_px * math.sin(angle) * size_y
    changed = {"screen_position_m": (x, y, z - difference.gap_m), **difference.scene}
    scene = Scene.model_validate(told.model_dump() | changed)
    return Case("one-thing", row, difference.title, plate, told, scene, condition=difference.condition)
