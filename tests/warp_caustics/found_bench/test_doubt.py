"""Whether a result says that its heights may be wrong by more than it states."""

import math
from dataclasses import asdict

import numpy as np
import pytest

from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.bench_record import FoundNumber
from warp_caustics.found_bench.bench_uncertainty import careful_widths
from warp_caustics.found_bench.doubt import CAREFUL, MOST_TIMES, SET_UP, UNTOLD, doubt_of, signs_of_care
from warp_caustics.found_bench.rest_causes import SPOTS, UNEVEN, Cause
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene

SCENE = Scene()
NUMBERS = BenchNumbers.of(SCENE)
PLACE = careful_widths(SCENE)["screen_x_m"]
PARTS = {
    "network_um": 4.0,
    "bench_um": 3.0,
    "numbers": {name: {"sigma": 1e-6, "um": 1.0} for name in UNTOLD} | {"vergence_per_m": {"sigma": 0.02, "um": 2.0}},
}


def counters(*causes, ratio=0.5, bench=(), parts=PARTS, **others):
    rest = {"ratio": ratio, "causes": [asdict(cause) for cause in causes]}
    found = {"rest": rest, "bench": {"numbers": [asdict(number) for number in bench]}, **others}
    return found if parts is None else found | {"uncertainty": parts}


def uneven(times):
    return Cause(UNEVEN, "uneven", times * CAREFUL[UNEVEN], 1e-4, 0.5)


def moved(times, sigma=0.0, is_used=True, name="screen_x_m"):
    parameter = next(p for p in NUMBERS.parameters if p.name == name)
    return FoundNumber.of(parameter, 0.0, times * careful_widths(SCENE)[name], sigma, is_used=is_used)


def test_a_result_that_its_uncertainty_explains_is_in_no_doubt():
    doubt = doubt_of(counters(), NUMBERS, 5.0)
    assert doubt.times == pytest.approx(1) and not doubt.is_doubtful and not doubt.warnings()


def test_more_left_than_the_image_part_explains_is_warned_of():
    """What the bench leaves uncertain leaves nothing of an image, and is not multiplied."""
    doubt = doubt_of(counters(ratio=3.0), NUMBERS, 5.0)
    assert doubt.times == pytest.approx(math.hypot(3 * 4, 3) / 5) and doubt.is_doubtful
    assert "3 times as much is left" in doubt.warnings()[0] and "they may be wrong by more" in doubt.warnings()[0]
    shaded = counters(ratio=3.0, parts=PARTS | {"bench_um": 40.0})
    assert not doubt_of(shaded, NUMBERS, math.hypot(4, 40)).is_doubtful


def test_one_sign_is_an_accident_and_two_are_a_habit():
    one = doubt_of(counters(uneven(20)), NUMBERS, 5.0)
    assert one.care == 1 and one.times == pytest.approx(1)
    two = doubt_of(counters(uneven(20), bench=[moved(30)]), NUMBERS, 5.0)
    assert two.care == pytest.approx(20)
    assert two.times == pytest.approx(math.sqrt(25 + 3 * (20**2 - 1)) / 5) and two.times > MOST_TIMES
    (line,) = two.warnings()
    assert f"wrong by {two.times:.2g} times" in line and "gap_m" in line and "--prior" in line and "\n" not in line


def test_signs_that_do_not_matter_beside_the_stated_uncertainty_are_no_warning():
    """The same bench with heights that are a hundred um uncertain anyway."""
    parts = PARTS | {"network_um": 100.0}
    doubt = doubt_of(counters(uneven(20), bench=[moved(30)], parts=parts), NUMBERS, math.hypot(100, 3))
    assert doubt.care == pytest.approx(20) and not doubt.is_doubtful


def test_what_the_user_says_of_gap_base_and_index_is_believed():
    told = BenchNumbers.of(SCENE, dict.fromkeys(UNTOLD, 1e-4))
    doubt = doubt_of(counters(uneven(20), bench=[moved(30)]), told, 5.0)
    assert doubt.unsaid == () and not doubt.is_doubtful
    some = doubt_of(counters(uneven(20), bench=[moved(30)]), BenchNumbers.of(SCENE, {"gap_m": 1e-4}), 5.0)
    assert some.unsaid == ("base_thickness_m", "index_offset") and "gap_m," not in some.warnings()[0]


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


def test_a_cause_that_the_uncertainty_has_a_part_of_is_no_warning():
    lamp = Cause("vergence_per_m", "a lamp", 1.0, 0.1, is_bench=True)
    within = doubt_of(counters(lamp), NUMBERS, 5.0)
    assert not within.is_doubtful and within.signs[SET_UP] > 40
    for parts, stated in ((None, 5.0), (None, None), (PARTS | {"numbers": {}}, 5.0)):
        without = doubt_of(counters(lamp, parts=parts), NUMBERS, stated)
        assert without.is_doubtful and "a lamp: 1 +- 0.1" in without.warnings()[0]


def test_without_an_uncertainty_nothing_is_said_of_it():
    doubt = doubt_of(counters(uneven(20), bench=[moved(30)], ratio=None, parts=None), NUMBERS, None)
    assert doubt.times is None and not doubt.is_doubtful and not doubt.warnings()
    assert doubt.record["care"] == pytest.approx(20) and not doubt.record["is_doubtful"]


def test_heights_that_claim_to_be_exact_are_not_divided_by():
    parts = PARTS | {"network_um": 0.0, "bench_um": 0.0, "numbers": {}}
    assert np.isfinite(doubt_of(counters(parts=parts, ratio=1000.0), NUMBERS, 0.0).times)
