"""``nsfc inspect`` of one plate."""

import csv
import json
import os

import numpy as np
import pytest

from cli.inspection.files import OWN_FILES
from cli.main import main
from cli.marker import MARKER
from cli.results import FILES, UNCERTAINTY_FILES
from warp_caustics.io.heights import read_heights
from warp_caustics.io.mesh import height_field_mesh, write_mesh

CONFIG = ("--config", "small", "--device", "cpu", "--tolerance", "50um")


def inspect(*arguments):
    return main(["inspect", *map(str, arguments), *CONFIG])


def defect():
    excess = np.zeros((32, 32))
    excess[4:8, 22:27] = 2e-4
    return excess


def test_a_good_plate_passes_and_leaves_everything_behind(full_figures, fake, inputs, lines_csv, tmp_path, capsys):
    out = tmp_path / "out"
    assert inspect(inputs / "image.tif", "--nominal", lines_csv, "-o", out) == 0
    assert sorted(os.listdir(out)) == sorted((*FILES, *UNCERTAINTY_FILES, *OWN_FILES, MARKER))
    record = json.loads((out / "inspection.json").read_text())
    assert record["verdict"] == "pass" and record["tolerance_m"] == pytest.approx(5e-5)
    assert record["inputs"]["nominal"]["path"] == str(lines_csv)
    assert [fibre["status"] for fibre in record["fibres"]] == ["as designed"]
    assert (out / "inspection.png").read_bytes().startswith(b"\x89PNG")
    assert capsys.readouterr().out.startswith("verdict    pass")


def test_a_defect_fails_with_code_7_and_stands_in_the_tables(fake, inputs, lines_csv, tmp_path, capsys):
    fake.excess_m = defect()
    out = tmp_path / "out"
    assert inspect(inputs / "image.tif", "--nominal", lines_csv, "-o", out, "--json") == 7
    record = json.loads(capsys.readouterr().out)
    assert record["verdict"] == "fail" and len(record["regions"]) == 1
    with open(out / "regions.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    pitch = 50 / 32
    place = float(row["x_mm"]), float(row["y_mm"])
    assert place == pytest.approx((-25 + 24.5 * pitch, -25 + 6 * pitch), rel=1e-5)
    assert float(row["volume_mm3"]) == pytest.approx(20 * pitch**2 * 0.2, rel=1e-4)
    np.testing.assert_allclose(read_heights(out / "deviation.npy"), defect(), atol=1e-12)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "too much glass" in page


def test_every_kind_of_design_is_the_same_plate(fake, inputs, relief, lines_csv, tmp_path):
    from cli.config import load_config

    scene = load_config("small", (), {}).scene
    write_mesh(tmp_path / "d.stl", height_field_mesh(relief, scene.plate_size_m, scene.base_thickness_m))
    np.save(tmp_path / "fine.npy", np.repeat(np.repeat(relief, 3, 0), 3, 1))
    for number, design in enumerate([lines_csv, inputs / "heights.npy", tmp_path / "d.stl", tmp_path / "fine.npy"]):
        out = tmp_path / str(number)
        assert inspect(inputs / "image.tif", "--nominal", design, "-o", out) == 0
        np.testing.assert_allclose(read_heights(out / "height.npy"), relief, atol=2e-8)
    assert "resampled from 96 to 32" in json.loads((tmp_path / "3" / "inspection.json").read_text())["design"]


def test_mask_and_margin_leave_a_defect_out(fake, inputs, lines_csv, tmp_path):
    fake.excess_m = defect()
    mask = np.ones((64, 64), np.float32)
    mask[6:18, 42:56] = 0
    np.save(tmp_path / "mask.npy", mask)
    arguments = (inputs / "image.tif", "--nominal", lines_csv)
    assert inspect(*arguments, "-o", tmp_path / "a", "--mask", tmp_path / "mask.npy") == 0
    assert inspect(*arguments, "-o", tmp_path / "b", "--margin", "13mm") == 0
    assert inspect(*arguments, "-o", tmp_path / "c", "--margin", "30mm") == 3


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("--tolerance", "50 parsec"), 2, "is no length; write 50um"),
        (("--tolerance", "0um"), 2, "0 would fail every plate"),
        (("--tolerance", "50"), 2, "give a unit such as um"),
        (("--margin", "-1mm"), 2, "not between 0"),
        (("--density", "0"), 2, "is not above 0"),
        (("--watch", "0"), 2, "seconds above 0 and one folder"),
        (("--watch", "1"), 3, "is no folder"),
        (("--mask", "none.png"), 3, "does not exist"),
        (("--nominal", "none.csv"), 3, "does not exist"),
    ],
)
def test_wrong_arguments_are_one_line(fake, inputs, lines_csv, tmp_path, capsys, arguments, code, message):
    given = ["inspect", str(inputs / "image.tif"), *CONFIG, "--nominal", str(lines_csv), "-o", str(tmp_path / "out")]
    assert main([*given, *arguments]) == code
    error = capsys.readouterr().err.strip()
    assert message in error and error.count("\n") == 0
    assert not (tmp_path / "out").exists() and fake.calls == 0


def test_ctrl_c_judges_nothing(fake, inputs, lines_csv, tmp_path):
    fake.stop_reason = "interrupted"
    assert inspect(inputs / "image.tif", "--nominal", lines_csv, "-o", tmp_path / "out") == 130
    assert sorted(os.listdir(tmp_path)) == ["lines.csv"]


def test_an_earlier_result_needs_force(fake, inputs, lines_csv, tmp_path, capsys):
    arguments = (inputs / "image.tif", "--nominal", lines_csv, "-o", tmp_path / "out")
    assert inspect(*arguments) == 0
    assert inspect(*arguments) == 3
    assert "--force" in capsys.readouterr().err
    assert inspect(*arguments, "--force") == 0


def test_the_lines_of_a_height_map(fake, inputs, relief, tmp_path, capsys):
    """Found in the map, they are judged as those of a list; what is not made of lines is refused."""
    np.save(tmp_path / "design.npy", relief)
    out = tmp_path / "out"
    arguments = (inputs / "image.tif", "--nominal", tmp_path / "design.npy", "--find-lines")
    assert inspect(*arguments, "-o", out) == 0
    record = json.loads((out / "inspection.json").read_text())
    assert record["design"].endswith("made of 1 printed lines") and (out / "fibres.csv").exists()
    np.save(tmp_path / "design.npy", relief + 1e-4 * np.random.default_rng(1).random(relief.shape))
    assert inspect(*arguments, "-o", tmp_path / "other") == 5
    assert "leave --find-lines out, or give the list of lines" in capsys.readouterr().err


def test_the_section_of_the_lines_reaches_the_verdict(fake, inputs, lines_csv, tmp_path, monkeypatch):
    """Relief, tolerance zone and fibres are those of lines of that section."""
    import cli.inspect
    from cli.inspection.job import InspectionJob
    from warp_caustics.prints.line import SECTIONS, line_relief
    from warp_caustics.prints.line_list import read_lines
    from warp_caustics.prints.tolerance import line_limit

    assert cli.inspect.SECTIONS == SECTIONS
    lines, found, settings = read_lines(lines_csv), {}, {}
    run = InspectionJob.run

    def watched(job, *arguments, **options):
        outcome = run(job, *arguments, **options)
        found[job.nominal.section], settings[job.nominal.section] = outcome.inspection, job.settings
        return outcome

    monkeypatch.setattr(InspectionJob, "run", watched)
    arguments = (inputs / "image.tif", "--nominal", lines_csv)
    assert inspect(*arguments, "-o", tmp_path / "a") == 0
    assert inspect(*arguments, "-o", tmp_path / "b", "--section", "quarter") == 0
    assert tuple(found) == SECTIONS and len(set(settings.values())) == 2
    for section, inspection in found.items():
        np.testing.assert_array_equal(inspection.nominal_m, line_relief(lines, 32, (0.05, 0.05), section=section))
        zone = line_limit(lines, 32, (0.05, 0.05), 5e-5, section=section)
        is_zone = np.isclose(inspection.limit_m, zone, rtol=1e-9)
        assert (is_zone | (inspection.limit_m > zone)).all() and is_zone.mean() > 0.5
        assert inspection.fibres[0].volume_m3 == pytest.approx(inspection.nominal_volume_m3)
    record = json.loads((tmp_path / "b" / "inspection.json").read_text())
    assert "of section 'quarter'" in record["design"]
    assert "of section" not in json.loads((tmp_path / "a" / "inspection.json").read_text())["design"]


@pytest.mark.slow
def test_a_real_reconstruction_finds_a_bump(inputs, relief, tmp_path):
    """End to end without a network, from an image: the design lacks half of the line's height."""
    np.save(tmp_path / "design.npy", 0.5 * relief)
    out = tmp_path / "out"
    assert inspect(inputs / "image.tif", "--nominal", tmp_path / "design.npy", "-o", out) == 7
    record = json.loads((out / "inspection.json").read_text())
    assert record["verdict"] == "fail"
    assert record["peak_deviation_m"] == pytest.approx(1.5e-4, rel=0.15)
    assert record["volume_m3"] == pytest.approx(relief.sum() * (0.05 / 32) ** 2, rel=0.1)
