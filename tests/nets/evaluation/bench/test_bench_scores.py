"""Scores of reliefs, tables of them, and heights that another program made."""

from dataclasses import replace

import numpy as np
import pytest

from data_gen.suites.light import true_heights
from data_gen.suites.suites import suite_cases
from nets.evaluation.bench.scores import bench_scores, relief_scores
from nets.evaluation.bench.scoring import score_folder
from nets.evaluation.bench.table import bench_rows, bench_summary
from nets.evaluation.fields import Field
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.heights import write_heights
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.reconstruct.trust import Trust
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=32)


def test_scores_of_a_known_error():
    true = np.zeros((32, 32))
    true[8:24, 8:24] = 1e-4
    error = 2e-6 * np.where(np.arange(32) < 16, 1.0, 3.0)[None, :] * np.ones((32, 1))
    scores = relief_scores(true + error, true, SCENE, np.full((32, 32), 4e-6))
    assert scores["rmse_um"] == pytest.approx(np.sqrt((4 + 36) / 2))
    assert scores["rmse_mean_removed_um"] == pytest.approx(2)
    assert scores["within_one"] == 0.5 and scores["within_two"] == 1.0
    assert scores["flat_um"] == pytest.approx(50) and scores["stated_um"] == pytest.approx(4)
    assert scores["rmse_aligned_um"] <= scores["rmse_um"]
    assert relief_scores(true, true, SCENE)["within_one"] is relief_scores(true, true, SCENE)["stated_um"] is None
    assert relief_scores(true, true, SCENE)["within_two_on_relief"] is None


@pytest.mark.parametrize("is_explained", [None, True, False])
@pytest.mark.parametrize("warnings", [(), ("dim",)])
def test_warned_and_explained_are_told_apart(warnings, is_explained):
    scene = Scene(height_samples=32)
    trust = Trust("line", is_explained, 0.1, None, 0.0, 0.5, None, "unknown")
    field = Field("f", np.zeros((32, 32)), None, 0.0, "simulated")
    result = Reconstruction(
        "m", np.full((32, 32), 1e-6), np.zeros((1, 2, 2)), 0.1, "converged", warnings=warnings, trust=trust
    )
    found = bench_scores(scene, 1, "cpu")(result, field)
    assert (found["warned"], found["explained"], found["trust"]) == (bool(warnings), is_explained, "line")
    assert found["rmse_um"] == pytest.approx(1) and found["doubted"] is None
    for doubtful in (False, True):
        doubted = replace(result, counters={"doubt": {"times": 1.0, "is_doubtful": doubtful}})
        assert bench_scores(scene, 1, "cpu")(doubted, field)["doubted"] is doubtful
    without = bench_scores(scene, 1, "cpu")(replace(result, trust=None), field)
    assert without["explained"] is None and without["trust"] is None


def record(case, method, rmse, warned, **others):
    scores = {
        "rmse_um": rmse,
        "rmse_aligned_um": rmse / 2,
        "within_one": others.get("one"),
        "warned": warned,
        "explained": not warned,
    }
    return {
        "field": case,
        "row": "r",
        "title": "t",
        "method": method,
        "status": "done",
        "time_s": 1.0,
        "scores": scores,
    }


def test_summary_of_a_row():
    failed = {"field": "r_2", "row": "r", "title": "t", "method": "a", "status": "failed", "reason": "no"}
    rows = bench_rows([record("r_0", "a", 2.0, True, one=0.5), record("r_1", "a", 4.0, False), failed])
    (line,) = bench_summary(rows)
    assert (line["plates"], line["done"], line["warned"], line["explained"]) == (3, 2, 1, 1)
    assert line["rmse_um"] == 3 and line["rmse_um_median"] == 3 and line["rmse_aligned_um"] == 1.5
    assert line["within_one"] == 0.5 and line["within_two"] is None and line["time_s"] == 1
    (line,) = bench_summary(bench_rows([failed]))
    assert line["rmse_um"] is None and line["warned"] is None


@pytest.fixture(scope="module")
def cases():
    return suite_cases("one-thing", 2, ("nothing", "ellipse"))


def test_the_truth_has_no_error(tmp_path, cases):
    for case, suffix in zip(cases, (".npy", ".tif", ".h5", ".npz"), strict=True):
        write_heights(tmp_path / f"{case.name}{suffix}", true_heights(case))
    write_heights(tmp_path / f"{cases[0].name}_uncertainty.npy", np.full((128, 128), 1e-6))
    records, lines = score_folder(tmp_path, cases, "given")
    assert lines == []
    for found, tolerance in zip(records, (0, 1e-4, 0, 0), strict=True):
        assert found["scores"]["rmse_um"] <= tolerance and found["scores"]["flat_um"] > 30
    assert records[0]["scores"]["within_one"] == 1 and records[1]["scores"]["within_one"] is None


def test_folders_of_reconstruct_are_found_and_missing_cases_told(tmp_path, cases):
    case = cases[1]
    (tmp_path / case.name).mkdir()
    write_heights(tmp_path / case.name / "height.npy", true_heights(case) + 1e-6)
    write_heights(tmp_path / case.name / "uncertainty.npy", np.full((128, 128), 0.6e-6))
    records, (line,) = score_folder(tmp_path, cases, "given")
    assert line == f"3 of 4 cases have no heights: {cases[0].name}, {cases[2].name}, {cases[3].name}"
    done = {found["field"]: found for found in records}[case.name]
    assert done["scores"]["rmse_um"] == pytest.approx(1)
    assert done["scores"]["within_one"] == 0 and done["scores"]["within_two"] == 1


def test_files_that_cannot_be_scored(tmp_path, cases):
    with pytest.raises(InputError, match="is no folder; give one with files such as nothing_0.npy"):
        score_folder(tmp_path / "none", cases, "given")
    with pytest.raises(InputError, match="holds heights of no case of suite one-thing; name files as nothing_0.npy"):
        score_folder(tmp_path, cases, "given")
    write_heights(tmp_path / "nothing_0.npy", np.zeros((64, 64)))
    with pytest.raises(MismatchError, match="has 64 x 64 samples, the truth 128 x 128; resample"):
        score_folder(tmp_path, cases, "given")
    write_heights(tmp_path / "nothing_0.npy", np.zeros((128, 128)))
    write_heights(tmp_path / "nothing_0.tif", np.zeros((128, 128)))
    with pytest.raises(InputError, match="are both of case nothing_0; leave one"):
        score_folder(tmp_path, cases, "given")
    (tmp_path / "nothing_0.tif").unlink()
    np.save(tmp_path / "nothing_0.npy", np.full((128, 128), 0.4) * 1e3)
    with pytest.raises(InputError, match="is above 0.1 m; did you mean"):
        score_folder(tmp_path, cases, "given")


def test_a_bent_plate_has_no_error_but_its_form():
    rng = np.random.default_rng(1)
    y, x = np.meshgrid(np.linspace(-0.5, 0.5, 32), np.linspace(-0.5, 0.5, 32), indexing="ij")
    true, rest = 1e-4 * rng.random((32, 32)), 1e-6 * rng.standard_normal((32, 32))
    bent = 2e-5 * (4 * x**2 + y**2 - 3 * x * y) + 1e-5 * x + 3e-6
    plain, scores = relief_scores(true + rest, true, SCENE), relief_scores(true + rest + bent, true, SCENE)
    assert scores["rmse_um"] > 5 and scores["rmse_form_removed_um"] == pytest.approx(plain["rmse_form_removed_um"])
    assert 0.98 < plain["rmse_form_removed_um"] / plain["rmse_um"] < 1
    ripple = 1e-6 * np.cos(8 * np.pi * x)
    assert relief_scores(true + ripple, true, SCENE)["rmse_form_removed_um"] == pytest.approx(
        1e6 * ripple.std(), rel=0.05
    )
