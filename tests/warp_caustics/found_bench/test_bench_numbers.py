"""Which numbers are looked for, and what is said of them."""

import pytest

from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.bench_record import NOT_TOLD, FoundBench, FoundNumber, is_picture_smaller, verdict_of
from warp_caustics.found_bench.picture_size import lowest_vergence
from warp_caustics.scene import Scene

LAMP = Scene(light_position_m=(0.0, 0.0, 0.5), emission_half_angle_rad=0.1)


def test_parallel_light_may_come_from_a_lamp_and_a_lamp_may_be_elsewhere():
    assert set(BenchNumbers.of(Scene()).names) == {
        "screen_x_m", "screen_y_m", "vergence_per_m", "dispersion_scale", AMBIENT,
    }  # fmt: skip
    assert "lamp_distance_m" in BenchNumbers.of(LAMP).names
    assert "vergence_per_m" not in BenchNumbers.of(LAMP).names


@pytest.mark.parametrize("scene", [Scene(glass=1.46), Scene(radiosity_W_m2=(0.0, 1.0, 0.0))])
def test_without_dispersion_none_is_looked_for(scene):
    assert "dispersion_scale" not in BenchNumbers.of(scene).names


def test_widths_are_the_users_and_what_is_exact_is_left_out():
    numbers = BenchNumbers.of(Scene(), {"vergence_per_m": 0.3, "screen_x_m": 0.0, "gap_m": 0.0})
    widths = {p.name: p.prior for p in numbers.parameters}
    assert widths["vergence_per_m"] == 0.3
    assert "screen_x_m" not in widths
    assert "gap_m" not in {p.name for p in numbers.not_told}
    assert "base_thickness_m" in {p.name for p in numbers.not_told}


def test_what_is_no_width_is_refused():
    with pytest.raises(InputError, match="width of ambient -1 is below 0; give 0"):
        BenchNumbers.of(Scene(), {AMBIENT: -1.0})
    with pytest.raises(InputError, match="below 0"):
        BenchNumbers.of(Scene(), {AMBIENT: float("nan")})
    with pytest.raises(InputError, match="parameter 'gup_m' is not known"):
        BenchNumbers.of(Scene(), {"gup_m": 1e-3})


def test_scenes_of_values():
    numbers = BenchNumbers.of(Scene())
    assert numbers.scene_of(numbers.before) is numbers.scene
    near = numbers.scene_of({**numbers.before, "vergence_per_m": 2.0})
    assert near.light_distance_m == pytest.approx(0.5)
    lowest = lowest_vergence(Scene())
    assert -20 < lowest < -10 and numbers.within({"vergence_per_m": -50.0, AMBIENT: 2.0}) == {
        "vergence_per_m": lowest, AMBIENT: 0.5,
    }  # fmt: skip


def parameter(name):
    return next(p for p in BenchNumbers.of(Scene()).parameters if p.name == name)


def test_verdicts():
    vergence = parameter("vergence_per_m")
    assert verdict_of(vergence, 0.0, 1.0, 0.03) == "found"
    assert verdict_of(vergence, 0.0, 0.1, 0.03) == "as told"
    assert verdict_of(vergence, 0.0, 1.0, 0.9) == NOT_TOLD
    assert verdict_of(vergence, 0.0, 0.0, None) == NOT_TOLD


def test_what_explains_nothing_better_is_in_doubt_and_not_used():
    vergence = parameter("vergence_per_m")
    kept, not_kept = (FoundNumber.of(vergence, 0.0, 1.0, 0.03, is_used=used) for used in (True, False))
    assert (kept.verdict, kept.found) == ("found", 1.0)
    assert (not_kept.verdict, not_kept.found, not_kept.seen) == ("in doubt", 0.0, 1.0)
    lost = FoundNumber.of(vergence, 0.0, 0.0, None, is_used=False)
    assert (lost.verdict, lost.seen, lost.sigma) == (NOT_TOLD, None, vergence.prior)
    told = FoundBench((kept,), True, "why", 3)
    assert "vergence_per_m 1 +- 0.03 instead of 0" in told.warnings()[0]
    assert "--set-up known" in told.warnings()[0]
    assert "in doubt" in FoundBench((not_kept,), False, "why", 3).warnings()[0]
    assert not FoundBench((lost,), False, "why", 1).warnings()
    assert told.record["numbers"][0]["verdict"] == "found"


@pytest.mark.parametrize(
    ("seen", "is_picture", "why"),
    [
        (-3.0, False, "a picture that is too small, or light that converges"),
        (3.0, True, "a picture that is too large"),
        (3.0, False, ""),
        (0.01, True, ""),
    ],
)
def test_a_vergence_that_is_no_lamps_is_called_what_it_is(seen, is_picture, why):
    number = FoundNumber.of(parameter("vergence_per_m"), 0.0, seen, 0.06, is_used=True)
    found = FoundBench((number,), True, "less is left", 3, is_picture)
    assert found.record["numbers"][0]["why"] == why and found.record["is_picture"] == is_picture
    assert is_picture_smaller(found.record) == (seen < 0)
    assert [f"instead of 0 ({why});" in line for line in found.warnings()] == ([True] if why else [False] * (seen > 1))
