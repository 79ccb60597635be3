"""How carefully a bench was set up: signs, their second largest, and what becomes of numbers that no image tells."""

import math
from dataclasses import asdict

import pytest

from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.bench_record import FoundNumber
from warp_caustics.found_bench.bench_uncertainty import careful_widths
from warp_caustics.found_bench.care import CAREFUL, SET_UP, TOLD_TIMES, UNTOLD, Care, care_of, signs_of_care
from warp_caustics.found_bench.rest_causes import SPOTS, UNEVEN, Cause
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene

SCENE = Scene()
NUMBERS = BenchNumbers.of(SCENE)
WIDTHS = careful_widths(SCENE)
PLACE = WIDTHS["screen_x_m"]


def counters(*causes, bench=(), **others):
    rest = {"ratio": 0.5, "causes": [asdict(cause) for cause in causes]}
    return {"rest": rest, "bench": {"numbers": [asdict(number) for number in bench]}, **others}


def uneven(times):
    return Cause(UNEVEN, "uneven", times * CAREFUL[UNEVEN], 1e-4, 0.5)


def moved(times, sigma=0.0, is_used=True, name="screen_x_m"):
    parameter = next(p for p in NUMBERS.parameters if p.name == name)
    return FoundNumber.of(parameter, 0.0, times * WIDTHS[name], sigma, is_used=is_used)


def test_one_sign_is_an_accident_and_two_are_a_habit():
    assert care_of(counters(uneven(20)), NUMBERS).times == 1
    assert care_of(counters(uneven(20), bench=[moved(30)]), NUMBERS).times == pytest.approx(20)
    assert care_of(counters(uneven(0.2), bench=[moved(0.3)]), NUMBERS).times == 1


def test_an_accident_that_does_not_explain_the_image_was_not_all():
    """Of lines alone it is known how many times the noise they leave."""
    far = moved(168, name="vergence_per_m")
    for left, times in ((None, 1), (1.0, 1), (3.1, 1), (8.4, 168)):
        assert care_of(counters(bench=[far], discrepancy=left, explained_by="fibres"), NUMBERS).times == pytest.approx(
            times
        )
    crowd = counters(discrepancy=8.4, explained_by="fibres")
    assert care_of(crowd, NUMBERS).times == 1, "of a bench that looks as told"
    free = counters(bench=[far], discrepancy=8.4, explained_by="network")
    assert care_of(free, NUMBERS).times == 1, "heights that are no lines"


def test_an_image_of_unknown_noise_tells_nothing():
    assert care_of({"bench": {"numbers": [asdict(moved(30)), asdict(moved(30, name="vergence_per_m"))]}}, NUMBERS) == (
        Care(1.0, {})
    )


def test_only_numbers_that_no_image_tells_and_nobody_says_are_widened():
    wide, names = Care(20.0, {}).widened(WIDTHS, ())
    assert set(names) == set(UNTOLD) and all(wide[name] == pytest.approx(20 * WIDTHS[name]) for name in UNTOLD)
    assert all(wide[name] == WIDTHS[name] for name in WIDTHS if name not in UNTOLD)
    some, rest = Care(20.0, {}).widened(WIDTHS, {"gap_m"})
    assert some["gap_m"] == WIDTHS["gap_m"] and rest == ["base_thickness_m", "index_offset"]
    assert Care(20.0, {}).widened({"gap_m": 1e-5}, ()) == ({"gap_m": pytest.approx(2e-4)}, ["gap_m"])
    assert Care(1.0, {}).widened(WIDTHS, ()) == (WIDTHS, [])


def test_the_user_is_told_in_one_line_how_to_say_it_and_not_of_trifles():
    care = Care(20.0, {SET_UP: 30.0, UNEVEN: 20.0})
    line = care.record({"gap_m": 2e-4}, ["gap_m"])["line"]
    assert "20 times less care" in line and "gap_m +- 0.0002" in line and "--prior gap_m=" in line
    assert "set-up 30" in line and "\n" not in line
    assert care.record({"gap_m": 2e-4}, [])["line"] == ""
    assert Care(0.9 * TOLD_TIMES, {}).record({"gap_m": 2e-5}, ["gap_m"])["line"] == ""


def test_place_and_lamp_are_one_sign():
    """A lamp aside moves the picture; what is within its own deviation is none; dispersion may be colours apart."""
    both = signs_of_care(counters(bench=[moved(30), moved(50, name="vergence_per_m")]), NUMBERS)
    assert both == {SET_UP: pytest.approx(50)}
    unsure = signs_of_care(counters(bench=[moved(3, 2 * PLACE)]), NUMBERS)
    assert unsure[SET_UP] == pytest.approx(math.sqrt(5))
    glass = Cause("dispersion_scale", "glass", 0.5, 0.01, is_bench=True)
    assert signs_of_care(counters(glass), NUMBERS) == {}


def test_signs_of_light_dirt_and_camera_come_largest_first():
    camera = ChannelCamera.perfect(3, SCENE.image_pixels).record | {"shift_px": [[0.3, 0.4], [0, 0], [0, 0]]}
    stray = Cause(AMBIENT, "stray", 2 * CAREFUL[AMBIENT], 0.0)
    found = signs_of_care(counters(stray, Cause(SPOTS, "dust", 50.0, 0.0, 0.3), camera=camera), NUMBERS)
    assert found["colours_px"] == pytest.approx(0.5 / CAREFUL["colours_px"]) and found[AMBIENT] == pytest.approx(2)
    assert list(found.values()) == sorted(found.values(), reverse=True) and found[SPOTS] > 40
