"""Numbers of benches that methods found, against those that the benches of a suite have."""

import dataclasses

import pytest
import torch

from data_gen.suites.lab import BENCHES
from data_gen.suites.suites import suite_cases
from nets.evaluation.bench.found_numbers import covered_numbers, number_rows, true_numbers
from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.operator import Camera
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.bench_record import FoundBench, FoundNumber
from warp_caustics.found_bench.picture_size import picture_size
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator


def case(row, suite="one-thing"):
    return suite_cases(suite, 1, (row,))[0]


def record_of(case, **found):
    """Of a cell whose method found these numbers, each known to a hundredth of what it is, and no other."""
    numbers = BenchNumbers.of(case.told)
    told = [
        FoundNumber.of(p, numbers.before[p.name], found[p.name], abs(found[p.name]) / 100, is_used=True)
        for p in numbers.parameters
        if p.name in found
    ]
    bench = FoundBench((*told, *(FoundNumber.not_told(p, 0.0) for p in numbers.not_told)), True, "", 1)
    return {"field": case.name, "row": case.row, "method": "fibres", "counters": {"bench": bench.record}}


def test_true_numbers_are_those_that_differ():
    told = true_numbers(case("nothing"))
    assert told["gap_m"] == 1e-6 and told["dispersion_scale"] == 1 and told["ambient"] == told["vergence_per_m"] == 0

    def other(row):
        return {name: value for name, value in true_numbers(case(row)).items() if value != told[name]}

    assert other("gap-100um") == {"gap_m": pytest.approx(101e-6)}
    assert other("ambient-3") == {"ambient": 0.03}
    assert other("tilt-0.2deg") == {"tilt_x_rad": pytest.approx(0.0034907, rel=1e-4)}
    assert other("no-dispersion") == {"dispersion_scale": 0, "index_offset": pytest.approx(1.4633 - 1.45846, abs=1e-5)}
    assert set(other("shift-1")) == {"screen_x_m", "screen_y_m"}
    assert other("apart-0.5") == other("blur-1") == other("ellipse") == {}


def test_a_picture_of_another_size_has_the_vergence_that_looks_like_it():
    large = case("scale-0.5")
    assert picture_size(large.told, true_numbers(large)["vergence_per_m"]) == pytest.approx(1.005)


def test_a_picture_that_the_camera_moves_is_of_a_screen_that_was_moved_the_other_way():
    """By the images of both."""
    scene = Scene(height_samples=16, image_pixels=64)
    ordinary = case("ordinary", "lab")
    camera = CameraConfig(shift_px=(1.5, -0.5))
    true = true_numbers(dataclasses.replace(ordinary, scene=scene, told=scene, camera=camera))
    x = (torch.arange(16) - 7.5) / 8
    heights = 3e-4 * torch.exp(-4 * ((x[:, None] - 0.1) ** 2 + (x + 0.2) ** 2))
    seen = Camera(camera, scene).signal(CausticSimulator(scene, "lattice")(heights))
    place = true["screen_x_m"], true["screen_y_m"], scene.screen_position_m[2]
    moved = CausticSimulator(scene.model_copy(update={"screen_position_m": place}), "lattice")(heights)
    inside = (slice(None), slice(4, -4), slice(4, -4))
    assert (seen - moved)[inside].abs().max() < 0.1 * (moved - 1)[inside].abs().max()


def test_light_and_glass_of_a_bench_with_a_camera_are_its_own():
    true, bench = true_numbers(case("ordinary", "lab")), BENCHES["ordinary"]
    assert (true["ambient"], true["index_offset"]) == (bench.ambient, bench.index)
    assert true["gap_m"] == pytest.approx(-bench.told.screen_position_m[2] + bench.gap_m)


def test_numbers_that_no_image_told_are_left_out_and_cases_that_are_not_asked():
    moved = case("shift-0.5")
    true = true_numbers(moved)
    record = record_of(moved, screen_x_m=1.005 * true["screen_x_m"], screen_y_m=1.02 * true["screen_y_m"])
    rows = number_rows([moved], [record, record | {"field": "elsewhere_0"}, {"field": moved.name, "row": moved.row}])
    assert [row["name"] for row in rows] == ["screen_x_m", "screen_y_m"]
    assert rows[0]["true"] == true["screen_x_m"] and rows[0]["verdict"] == "found" and rows[0]["told"] == 0
    assert covered_numbers(rows) == (0.5, 1.0)
    assert covered_numbers([]) is None
    assert covered_numbers([dataclasses.asdict(Exact())]) == (0.0, 0.0)


@dataclasses.dataclass
class Exact:
    """A number that is said to be exactly known, and is not."""

    found: float = 1.0
    true: float = 2.0
    sigma: float = 0.0
