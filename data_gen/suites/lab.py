"""Suite ``lab``: five plates on each of four benches with a camera; much differs at once from what methods are told.

No figure of a bench is measured: they are plausible, between a bench somebody took care of and one in a hurry.
Directions (of a tilt, a shift, uneven light) are drawn for each plate.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from data_gen.config import CurvesConfig, MeandersConfig, PatternConfig, ReliefConfig
from data_gen.making import Making
from data_gen.suites.case import SHARP_PHOTONS, Case, Plate, bench_plates
from data_gen.suites.one_thing import lamp_at
from data_gen.suites.print_shapes import fibre_caps
from warp_caustics.camera.config import CameraConfig, SensorConfig
from warp_caustics.scene import Scene

SEED = 20_261_203
PLATES = 5

AS_PRINTED = Making(
    **fibre_caps(6).model_dump(exclude={"waviness", "end_thickness"}), waviness=(0.04, 0.04), end_thickness=(0.1, 0.4)
)
"""0.4 mm fibres, 1 to 6 passes fused to caps of 25 to 70 degrees, thicker ends, 4 % of waviness."""

KINDS: tuple[PatternConfig, ...] = (
    ReliefConfig(),
    ReliefConfig(making=Making(sections=("ellipse", "parabola", "quarter"), overlaps=("sum", "merge"))),
    ReliefConfig(making=Making(sections=("gaussian", "parabola"), exponent=(0.6, 1.5), overlaps=("max",))),
    MeandersConfig(line_count=(2, 4), making=AS_PRINTED),
    CurvesConfig(line_count=(3, 8), making=AS_PRINTED),
)
"""What the five plates are: Tab. 3, two with other sections, two as printed."""

FULL_WELL, EXPOSURE = 30_000.0, 0.04
"""Electrons at full scale, and part of it that flat light fills: 2.9 % of shot noise in one exposure."""


@dataclass(frozen=True)
class LabBench:
    """A bench as it is.

    Attributes:
        title: for people.
        told: scene that methods are told.
        gap_m: more gap to the screen than told [m].
        base_m: more base than told [m].
        index: more refractive index than told, at every wavelength [1].
        disc_deg: half angle under which the lamp is seen [degrees].
        tilt_deg: of collimated light [degrees].
        bow_m: of the plate [m].
        psf_px: standard deviation of the PSF [px].
        shift_px: of the whole picture [px].
        apart_px: of red and of blue from green [px].
        uneven: light at the rim, relative to the middle and less 1.
        ambient: of flat light.
        mixing: share that each neighbouring channel gives.
        sensor: with its noise.
    """

    title: str
    told: Scene
    gap_m: float
    base_m: float = 0.0
    index: float = 0.0
    disc_deg: float = 0.0
    tilt_deg: float = 0.0
    bow_m: float = 0.0
    psf_px: float = 0.0
    shift_px: float = 0.0
    apart_px: float = 0.0
    uneven: float = 0.0
    ambient: float = 0.0
    mixing: float = 0.0
    sensor: SensorConfig = field(default_factory=SensorConfig)


def sensor(exposures: int, read_noise: float, **others: float) -> SensorConfig:
    """A converter of 12 bits; noise of flat light is 2.9 % over the root of the number of exposures."""
    return SensorConfig.model_validate(
        {
            "exposure": EXPOSURE,
            "full_well_electrons": FULL_WELL,
            "read_noise_electrons": read_noise,
            "black_level": 0.015,
            "bits": 12,
            "photo_frames": exposures,
            **others,
        }
    )


def _another() -> Scene:
    told = Scene(base_thickness_m=3.2e-3, screen_position_m=(0.0, 0.0, -1e-3))
    return Scene.model_validate(told.model_dump() | lamp_at(0.5, told))


BENCHES: dict[str, LabBench] = {
    "careful": LabBench(
        "careful: gap 5 um wider, lamp disc 0.1 degrees, PSF 0.35 px, ambient 0.3 %, noise 0.7 %",
        Scene(),
        gap_m=5e-6,
        disc_deg=0.1,
        psf_px=0.35,
        ambient=0.003,
        sensor=sensor(16, 3.0),
    ),
    "ordinary": LabBench(
        "ordinary: gap 50 um wider, base 20 um thicker, index 0.0007 higher, lamp disc 0.5 degrees, tilt 0.2 degrees, "
        "PSF 0.7 px, 0.15 px off, light uneven by 2 %, ambient 1 %, mixing 3 %, speckle 2 %, noise 1.5 %",
        Scene(),
        gap_m=50e-6,
        base_m=20e-6,
        index=7e-4,
        disc_deg=0.5,
        tilt_deg=0.2,
        psf_px=0.7,
        shift_px=0.15,
        uneven=0.02,
        ambient=0.01,
        mixing=0.03,
        sensor=sensor(4, 5.0, speckle_contrast=0.02, speckle_width_px=1.0),
    ),
    "poor": LabBench(
        "poor: gap 200 um wider, base 60 um thinner, index 0.002 lower, lamp disc 1 degree, tilt 0.5 degrees, bow "
        "10 um, PSF 1.2 px, colours 0.3 px apart, light uneven by 5 %, ambient 3 %, speckle 5 %, 30 grains of "
        "dust, noise 3 %",
        Scene(),
        gap_m=200e-6,
        base_m=-60e-6,
        index=-2e-3,
        disc_deg=1.0,
        tilt_deg=0.5,
        bow_m=10e-6,
        psf_px=1.2,
        apart_px=0.3,
        uneven=0.05,
        ambient=0.03,
        sensor=sensor(1, 10.0, speckle_contrast=0.05, speckle_width_px=1.2, dust_grains=20, fresh_dust_grains=10),
    ),
    "another": LabBench(
        "another bench (base 3.2 mm, gap 1 mm, lamp at 0.5 m), told nearly: gap 20 um wider, base 10 um thicker, index "
        "0.0005 higher, lamp disc 0.12 degrees, PSF 0.5 px, light uneven by 1 %, noise 1 %",
        _another(),
        gap_m=20e-6,
        base_m=10e-6,
        index=5e-4,
        disc_deg=0.12,
        psf_px=0.5,
        uneven=0.01,
        sensor=sensor(8, 5.0),
    ),
}
"""By row."""


def cases(count: int, seed: int | None = None) -> list[Case]:
    """The cases, bench by bench, with the first ``count`` plates of each; of another seed than the suite's if given."""
    first = SEED if seed is None else seed
    return [_case(row, bench, number, first) for row, bench in BENCHES.items() for number in range(count)]


def _case(row: str, bench: LabBench, number: int, first: int) -> Case:
    # A seed for each bench: five plates each, not the same five four times.
    seed = first + 100 * list(BENCHES).index(row)
    return on_bench(row, Plate(bench_plates(seed, PLATES, KINDS[number], bench.told), number, bench.bow_m))


def on_bench(row: str, plate: Plate) -> Case:
    """Any plate on a bench of the suite; directions are drawn for each.

    Args:
        row: name of the bench.
        plate: on the scene that its bench is told.
    """
    bench = BENCHES[row]
    directions = plate.rng("bench")

    def drawn() -> tuple[float, float]:
        angle = directions.uniform(0, 2 * np.pi)
        return float(np.cos(angle)), float(np.sin(angle))

    scene, camera = _scene(bench, drawn), _camera(bench, drawn)
    return Case("lab", row, bench.title, plate, bench.told, scene, camera=camera, photons=SHARP_PHOTONS)


Direction = Callable[[], tuple[float, float]]
"""Draws a unit vector."""


def _scene(bench: LabBench, drawn: Direction) -> Scene:
    told, disc = bench.told, math.radians(bench.disc_deg)
    x, y, z = told.screen_position_m
    across, along = drawn()
    changed = {
        "base_thickness_m": told.base_thickness_m + bench.base_m,
        "screen_position_m": (x, y, z - bench.gap_m),
        "index_offset": told.index_offset + bench.index,
        "fresnel": True,
        "second_hits": "lost",
    }
    if told.is_collimated:
        tilt = math.radians(bench.tilt_deg)
        changed |= {"light_tilt_rad": (tilt * across, tilt * along), "lamp_half_angle_rad": disc}
    else:
        changed |= {"lamp_radius_m": told.light_distance_m * math.tan(disc)}
    return Scene.model_validate(told.model_dump() | changed)


def _camera(bench: LabBench, drawn: Direction) -> CameraConfig:
    shift, red, blue, light = drawn(), drawn(), drawn(), drawn()
    moved = tuple((bench.apart_px * x, bench.apart_px * y) for x, y in (red, (0.0, 0.0), blue))
    # A neighbour's share is taken from the channel's own light.
    mixing = bench.mixing * (np.eye(3, k=1) + np.eye(3, k=-1))
    mixing += np.diag(1 - mixing.sum(axis=1))
    return CameraConfig(
        psf_px=bench.psf_px,
        shift_px=(bench.shift_px * shift[0], bench.shift_px * shift[1]),
        colour_shift_px=moved if bench.apart_px else None,
        light=(bench.uneven * light[0], bench.uneven * light[1], 0.0, 0.0, 0.0),
        ambient=bench.ambient,
        mixing=tuple(tuple(map(float, row)) for row in mixing) if bench.mixing else None,
        sensor=bench.sensor,
    )
