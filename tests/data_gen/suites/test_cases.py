"""Suites: what they hold, and that nothing of them is ever trained on."""

import dataclasses
import hashlib
import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest

from data_gen.dataset_config import DatasetConfig, sample_seed
from data_gen.samples import Reliefs
from data_gen.suites import lab
from data_gen.suites.light import Light, bench_angles, channel_moves, channel_scenes, true_heights
from data_gen.suites.one_thing import DIFFERENCES
from data_gen.suites.suites import SUITES, find_suite, suite_cases
from data_gen.testset import field_heights, fields_config
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene

EVERY = [case for name in SUITES for case in suite_cases(name)]
BY_PLACE = {(case.suite, case.row, case.plate.number): case for case in reversed(EVERY)}


def of(suite, row, number=0):
    return BY_PLACE[suite, row, number]


def test_sizes_and_names():
    assert {name: len(suite_cases(name)) for name in SUITES} == {
        "ideal": 10, "one-thing": 10 * len(DIFFERENCES), "lab": 20, "prints": 110,
    }  # fmt: skip
    for name in SUITES:
        names = [case.name for case in suite_cases(name)]
        assert len(set(names)) == len(names)
        assert all(part.replace("-", "").replace("_", "").replace(".", "").isalnum() for part in names)
        few = suite_cases(name, 2)
        assert [case.key() for case in few] == [case.key() for case in suite_cases(name) if case.plate.number < 2]
    assert len({case.key() for case in EVERY}) == len(EVERY)


def test_no_stream_of_a_training_holds_a_plate():
    """The same configuration with the role of data sets, whatever its seed, has other seeds for every purpose."""
    plates = {(case.plate.fingerprint, case.plate.number): case.plate for case in EVERY if case.suite != "ideal"}
    for plate in plates.values():
        assert plate.config.role == "bench"
        for role in ("data", "test"):
            other = DatasetConfig.model_validate(plate.config.model_dump() | {"role": role}).sample_fingerprint()
            assert other != plate.fingerprint
            for purpose in ("relief", "photons/test", "noise", "making", "traits"):
                assert sample_seed(other, purpose, plate.number) != sample_seed(
                    plate.fingerprint, purpose, plate.number
                )
    fingerprints = {plate.fingerprint for plate in plates.values()}
    assert fields_config().sample_fingerprint() not in fingerprints
    assert fields_config(which="test").sample_fingerprint() not in fingerprints


def test_nobody_else_gives_the_role():
    """Data sets have the role ``data`` unless code says otherwise, and only the suites' own code says ``bench``."""
    from cli.config import Config, dataset_config

    assert dataset_config(Config(), kind="updater", n_samples=3, seed=1, denoiser=None).role == "data"
    root = Path(__file__).parents[3]
    sources = [path for name in ("warp_caustics", "data_gen", "nets", "cli") for path in (root / name).rglob("*.py")]
    said = [
        path for path in sources if re.search(r"""role["']?\s*[=:]\s*["']bench""", path.read_text(encoding="utf-8"))
    ]
    assert said == [root / "data_gen" / "suites" / "case.py"]


def test_a_plate_of_the_role_is_another_plate():
    plate = of("one-thing", "nothing").plate
    config = DatasetConfig.model_validate(plate.config.model_dump() | {"role": "data"})
    assert not np.array_equal(Reliefs(config, "cpu").strokes(0), Reliefs(plate.config, "cpu").strokes(0))


def test_fingerprints_of_earlier_data_sets_are_as_before():
    """A third role changes nothing for the two that there were, and what a bench is changes no plate on it."""
    assert fields_config().sample_fingerprint() == "6589b5f86154139e3bae0b500ae54cf3ed25aa9040947cb9f66d87a7346f3f96"
    test = fields_config(which="test").sample_fingerprint()
    assert test == "08a73e53dd75590eed15c70884bebddc3a4b92a42803cfed8bf71b66d6b5f2e2"
    data = DatasetConfig(kind="updater", n_samples=10).fingerprint()
    assert data == "191a0e60c429ba4f9d32096aca85261fe3098385a0ef9b15c627a92c83cb1363"


@pytest.mark.parametrize(
    ("suite", "digest"),
    [
        ("ideal", "a3505442be0785fcec0045fafa099e8fc23ab5a532a6211042e77dafec987dc1"),
        ("one-thing", "30113191b7a036c6bcc8cbd36847ee35a110d2fe79b254b924212fec25bb1f40"),
        ("lab", "26d8484e5006b4416e54f5622f36ecf5cbcec8962f2eb6056258469cb9c11d19"),
        ("prints", "c7d58a8bb2cbe95d7e60f847cdb4dd98f0328fc0ff5577f7ac381e4f8ace6948"),
    ],
)
def test_plates_are_those_that_were_published(suite, digest):
    """Fingerprints and seeds of all plates of a suite: figures of one year compare with those of the next."""
    plates = [
        (case.row, case.plate.number, case.plate.fingerprint, sample_seed(case.plate.fingerprint, "relief", number))
        for case in suite_cases(suite)
        for number in (case.plate.number,)
    ]
    assert hashlib.sha256(json.dumps(plates).encode()).hexdigest() == digest


def test_rows_of_one_thing_show_the_same_plates():
    same = [row for row, difference in DIFFERENCES.items() if difference.condition.relief == "plain"]
    shapes = {"meanders", "curves", "rings", "drops"}
    plates = {of("one-thing", row, 3).plate for row in same if row not in shapes}
    assert len({(plate.fingerprint, plate.number) for plate in plates}) == 1
    reliefs = [true_heights(of("one-thing", row, 3)) for row in ("nothing", "ellipse", "merge", "bow-20")]
    for one, other in itertools.combinations(reliefs, 2):
        assert np.abs(one - other).max() > 1e-6


def test_one_thing_differs_from_what_is_told():
    """In each row one of bench, camera, print; in the first none."""
    for row in DIFFERENCES:
        case = of("one-thing", row)
        plain = of("one-thing", "nothing")
        changed = [
            case.scene != case.told,
            case.condition != plain.condition,
            case.plate.fingerprint != plain.plate.fingerprint,
        ]
        assert sum(changed) == (row != "nothing"), row
        assert case.told == Scene()


def test_ideal_plates_are_the_development_fields():
    heights = field_heights()
    for number in (0, 7):
        np.testing.assert_array_equal(true_heights(of("ideal", "field", number)), heights[number].astype(np.float64))


@pytest.mark.parametrize("row", list(lab.BENCHES))
def test_benches_of_the_lab_are_off_by_what_is_said(row):
    bench, cases = lab.BENCHES[row], [case for case in suite_cases("lab") if case.row == row]
    for case in cases:
        told, scene = case.told, case.scene
        assert told.screen_position_m[2] - scene.screen_position_m[2] == pytest.approx(bench.gap_m)
        assert scene.base_thickness_m - told.base_thickness_m == pytest.approx(bench.base_m, abs=1e-12)
        assert np.hypot(*scene.light_tilt_rad) == pytest.approx(np.radians(bench.tilt_deg))
        assert scene.fresnel and not told.fresnel
        assert np.hypot(*case.camera.shift_px) == pytest.approx(bench.shift_px)
        assert np.hypot(*case.camera.light[:2]) == pytest.approx(bench.uneven)
        if not told.is_collimated:
            assert scene.lamp_radius_m / scene.light_distance_m == pytest.approx(
                np.tan(np.radians(bench.disc_deg)), rel=1e-2
            )
        if case.camera.mixing is not None:
            np.testing.assert_allclose(np.sum(case.camera.mixing, axis=1), 1)
    tilts = {case.scene.light_tilt_rad for case in cases}
    assert len(tilts) == (5 if bench.tilt_deg else 1)
    assert len({case.plate.fingerprint for case in cases}) == 5


def test_benches_show_no_plate_twice():
    plates = [case.plate.fingerprint for case in suite_cases("lab")]
    assert len(set(plates)) == len(plates)


def test_bow_is_in_the_truth():
    case = of("lab", "poor", 3)
    plain = Reliefs(case.plate.config, "cpu").true([3])[0].double().numpy()
    bowl = true_heights(case) - plain
    n = len(bowl)
    assert bowl[n // 2, n // 2] == pytest.approx(0, abs=1e-8)
    assert bowl[n // 2, 0] == pytest.approx(10e-6, rel=0.02)
    assert bowl[0, 0] == pytest.approx(20e-6, rel=0.04)


def test_channels_apart_are_on_moved_screens():
    case = of("one-thing", "apart-0.3")
    moves = channel_moves(case)
    np.testing.assert_allclose(np.hypot(*moves.T), (0.3, 0.0, 0.3))
    scenes = channel_scenes(case)
    assert [scene.wavelengths_m for scene in scenes] == [(wave,) for wave in case.told.wavelengths_m]
    for scene, move in zip(scenes, moves, strict=True):
        found = np.array(scene.screen_position_m[:2]) / scene.pixel_size_m
        np.testing.assert_allclose(found, move, atol=1e-12)
    assert len(bench_angles(case)) == 4
    assert channel_scenes(of("one-thing", "nothing")) == [Scene()]


def test_a_lens_that_shows_all_aside_is_one_moved_screen():
    case = of("lab", "ordinary")
    (scene,) = channel_scenes(case)
    moved = np.array(scene.screen_position_m[:2]) / scene.pixel_size_m
    np.testing.assert_allclose(moved, [-by for by in case.camera.shift_px], atol=1e-12)
    assert scene.screen_position_m[2] == case.scene.screen_position_m[2]
    np.testing.assert_allclose(np.hypot(*channel_moves(of("lab", "poor")).T), (0.3, 0.0, 0.3))


def test_index_is_higher_at_every_wavelength():
    case = of("lab", "ordinary")
    higher = np.array(case.scene.glass_indices) - case.told.glass_indices
    np.testing.assert_allclose(higher, 7e-4, atol=1e-12)


def test_light_that_meets_the_relief_again_is_lost_in_the_lab():
    """Methods are not told, and no bench of another suite loses any: there the image is what methods assume."""
    case = of("lab", "careful")
    assert {each.scene.second_hits for each in EVERY if each.suite == "lab"} == {"lost"}
    assert {each.scene.second_hits for each in EVERY if each.suite != "lab"} == {"ignored"}
    assert {each.told.second_hits for each in EVERY} == {"ignored"}
    heights, light = true_heights(case), Light("cpu", n_photons=200_000)
    through = dataclasses.replace(case, scene=case.scene.model_copy(update={"second_hits": "passed"}))
    lost = 1 - light.behind_plate(case, heights).sum() / light.behind_plate(through, heights).sum()
    assert 1e-3 < lost < 2e-2


def test_wrong_names_and_counts_are_explained():
    with pytest.raises(InputError, match="suite 'labs' is not known; did you mean 'lab'"):
        find_suite("labs")
    with pytest.raises(InputError, match="6 plates of each row of lab; there are 5, give 1 to 5"):
        suite_cases("lab", 6)
    with pytest.raises(InputError, match="has no row 'blur-3'; did you mean 'blur-"):
        suite_cases("one-thing", rows=("blur-3",))


def test_methods_are_told_which_benches_are_exactly_as_told():
    """Those of ideal and prints, and of one-thing where camera or print differ; none that somebody has to photograph."""
    assert all(case.is_bench_exact for case in (*suite_cases("ideal", 1), *suite_cases("prints", 1)))
    assert not any(case.is_bench_exact for case in suite_cases("lab", 1))
    exact = {case.row: case.is_bench_exact for case in suite_cases("one-thing", 1)}
    assert all(exact[row] for row in ("nothing", "blur-2", "apart-0.3", "ambient-3", "ellipse", "bow-20", "rings"))
    others = ("gap-10um", "base-30um", "no-dispersion", "lamp-1m", "tilt-0.2deg", "shift-0.25", "scale-0.2", "fresnel")
    assert not any(exact[row] for row in others)


@pytest.mark.parametrize("suite", list(SUITES))
def test_plates_of_another_seed(suite):
    """Under the same differences; none is one of the suite's own, and each seed has its own."""
    own, other, third = suite_cases(suite, 1), suite_cases(suite, 1, seed=7), suite_cases(suite, 1, seed=8)
    assert [case.name for case in own] == [case.name for case in other]
    plates = [{case.plate.fingerprint for case in cases} for cases in (own, other, third)]
    assert not plates[0] & plates[1] and not plates[1] & plates[2]
    assert [case.is_bench_exact for case in own] == [case.is_bench_exact for case in other]
    for case, same in zip(own, other, strict=True):
        assert case.told == same.told and case.plate.config.reliefs == same.plate.config.reliefs
    with pytest.raises(InputError, match="seed -1 is not between"):
        suite_cases(suite, 1, seed=-1)
