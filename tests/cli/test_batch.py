"""``nsfc reconstruct`` of several images, and what auto and uncertainty add to a result."""

import csv
import importlib.util
import json
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nets.reconstruct
from cli.inputs import image_list
from cli.main import main
from cli.marker import MARKER
from cli.results import FILES, UNCERTAINTY_FILES
from warp_caustics.errors import InputError
from warp_caustics.io.heights import read_heights


@pytest.fixture
def fake(monkeypatch):
    """Puts a method that only pretends in place of the real ones, and counts how often one is made."""
    spec = importlib.util.spec_from_file_location("fake_method", Path(__file__).with_name("fake_method.py"))
    fake_method = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fake_method)
    module, made = fake_method.methods_module(), []
    create = module.create

    def counted(*args, **options):
        made.append(create(*args, **options))
        return made[-1]

    module.create = counted
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(nets.reconstruct, "methods", module, raising=False)
    return made


@pytest.fixture
def no_pages(monkeypatch):
    """Leaves pictures and report empty, which take longer than all else here; they are tested where they are made."""
    monkeypatch.setattr("cli.figures.write_figure", lambda path, figure: path.write_bytes(b""))
    monkeypatch.setattr("cli.report.write.write_report", lambda path, content: path.write_text(""))


@pytest.fixture
def images(inputs, tmp_path):
    """Folder with three images, the second of which is none, and other things."""
    folder = tmp_path / "images"
    folder.mkdir()
    for name in ("a.tif", "c.tif"):
        shutil.copy(inputs / "image.tif", folder / name)
    (folder / "b.tif").write_text("no image at all\n")
    (folder / "notes.txt").write_text("")
    return folder


def batch(*arguments):
    return main(["reconstruct", *map(str, arguments), "--config", "small", "--device", "cpu"])


def rows(folder):
    with open(folder / "summary.csv", newline="") as file:
        return list(csv.DictReader(file))


def test_one_bad_image_does_not_stop_the_others(fake, no_pages, images, tmp_path, capsys):
    out = tmp_path / "out"
    assert batch(images, "-o", out, "--reference", images.parent / "none.npy") == 3
    shutil.rmtree(out)
    assert batch(images, "-o", out) == 3
    assert len(fake) == 2
    assert sorted(os.listdir(out)) == [MARKER, "a", "c", "summary.csv"]
    assert sorted(os.listdir(out / "c")) == sorted((*FILES, MARKER))
    table = rows(out)
    assert [(row["image"][-5:], row["status"], row["exit_code"]) for row in table] == [
        ("a.tif", "done", "0"), ("b.tif", "failed", "3"), ("c.tif", "done", "0"),
    ]  # fmt: skip
    assert "b.tif" in table[1]["error"] and float(table[0]["residual"]) > 0
    captured = capsys.readouterr()
    assert "2 of 3 images done" in captured.out
    assert f"error: {images / 'b.tif'}:" in captured.err


def test_results_come_one_by_one(fake, no_pages, images, tmp_path, monkeypatch):
    """The first result is on disk before the second begins; a bug in one counts as its error."""
    out, seen = tmp_path / "out", []
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def reconstruct(self, image, **options):
        seen.append(sorted(os.listdir(out)))
        if len(seen) == 2:
            raise KeyError("bug")
        return original(self, image, **options)

    import cli.job

    make = cli.job.make_method

    def made(config, device):
        nonlocal original
        method = make(config, device)
        original = type(method).reconstruct
        type(method).reconstruct = reconstruct
        return method

    original = None
    monkeypatch.setattr(cli.job, "make_method", made)
    shutil.copy(images / "a.tif", images / "b.tif")
    assert batch(images / "*.tif", "-o", out) == 1
    assert "a" not in seen[0] and {"a", "summary.csv"} <= set(seen[1]) and "b" not in seen[2]
    assert [row["status"] for row in rows(out)] == ["done", "failed", "done"]


def test_ctrl_c_keeps_the_image_at_hand_and_ends_the_batch(fake, no_pages, images, tmp_path, monkeypatch):
    import cli.job

    run = cli.job.Job.run

    def interrupted(self, *args):
        outcome = run(self, *args)
        return replace(outcome, result=replace(outcome.result, stop_reason="interrupted"))

    monkeypatch.setattr(cli.job.Job, "run", interrupted)
    assert batch(images, "-o", tmp_path / "out") == 130
    assert sorted(os.listdir(tmp_path / "out")) == [MARKER, "a", "summary.csv"]
    assert rows(tmp_path / "out")[0]["status"] == "interrupted"


def test_json_is_one_record(fake, no_pages, images, tmp_path, capsys):
    assert batch(images, "-o", tmp_path / "out", "--json") == 3
    record = json.loads(capsys.readouterr().out)
    assert record["exit_code"] == 3 and len(record["images"]) == 3
    assert record["images"][0]["result"]["method"] == "fake" and record["images"][1]["result"] is None


def test_earlier_results_need_force(fake, no_pages, images, tmp_path, capsys):
    arguments = images / "a.tif", images / "c.tif", "-o", tmp_path / "out"
    assert batch(*arguments) == 0
    capsys.readouterr()
    assert batch(*arguments) == 3
    assert "--force" in capsys.readouterr().err
    assert batch(*arguments, "--force") == 0


def test_a_second_batch_replaces_its_own_overview_only(fake, no_pages, images, tmp_path, capsys):
    """The folder is marked as that of a batch, and yet a table of that name may be the user's by now."""
    out = tmp_path / "out"
    assert batch(images / "a.tif", images / "c.tif", "-o", out) == 0
    first = (out / "c" / "result.json").read_bytes()
    arguments = images / "a.tif", images / "c.tif", "-o", out, "--force"
    for text in ("plate,verdict\nmine,good\n", "years of work"):
        (out / "summary.csv").write_text(text)
        assert batch(*arguments) == 4
        assert "'" + str(out / "summary.csv") + "'" in capsys.readouterr().err
        assert (out / "summary.csv").read_text() == text and (out / "c" / "result.json").read_bytes() == first
    (out / "summary.csv").unlink()
    for name in ("d.tif", "e.tif"):
        shutil.copy(images / "a.tif", images / name)
    assert batch(images / "d.tif", images / "e.tif", "-o", out) == 0
    assert [row["folder"] for row in rows(out)] == ["d", "e"]
    assert (out / "c" / "result.json").read_bytes() == first, "results of other images stay as they are"


def test_equal_names_are_refused(fake, images, tmp_path, capsys):
    (tmp_path / "more").mkdir()
    shutil.copy(images / "a.tif", tmp_path / "more" / "a.tif")
    assert batch(images / "a.tif", tmp_path / "more" / "a.tif", "-o", tmp_path / "out") == 3
    assert "would both go to the folder 'a'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_what_counts_as_a_batch(images, tmp_path, monkeypatch):
    monkeypatch.chdir(images)
    assert image_list(["a.tif"]) == "a.tif"
    assert image_list(["none.tif"]) == "none.tif"
    assert image_list(["a.tif", "c.tif", "a.tif"]) == ["a.tif", "c.tif"]
    assert image_list(["[ac].tif"]) == ["a.tif", "c.tif"]
    assert image_list(["."]) == ["./a.tif", "./b.tif", "./c.tif"]
    shutil.copy("a.tif", "[ac].tif")
    assert image_list(["[ac].tif"]) == "[ac].tif"
    with pytest.raises(InputError, match="no file matches"):
        image_list(["*.exr"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no images"):
        image_list([str(tmp_path / "empty")])


def test_uncertainty_is_written_where_there_is_one(full_figures, fake, inputs, tmp_path, monkeypatch, capsys):
    """Its files can be replaced by a result without."""
    import cli.job

    sigma = np.full((32, 32), 2e-6)
    sigma[0] = 5e-6
    make = cli.job.make_method

    def made(config, device):
        method = make(config, device)
        plain = method.reconstruct
        method.reconstruct = lambda *a, **k: replace(plain(*a, **k), uncertainty_m=sigma)
        return method

    arguments = inputs / "image.tif", "-o", tmp_path / "out", "--reference", inputs / "heights.npy"
    with monkeypatch.context() as patch:
        patch.setattr(cli.job, "make_method", made)
        assert batch(*arguments) == 0
    out = tmp_path / "out"
    assert sorted(os.listdir(out)) == sorted((*FILES, *UNCERTAINTY_FILES, MARKER))
    np.testing.assert_array_equal(read_heights(out / "uncertainty.npy"), sigma)
    np.testing.assert_allclose(read_heights(out / "uncertainty.tif"), sigma, rtol=1e-6)
    assert (out / "uncertainty.png").read_bytes().startswith(b"\x89PNG")
    record = json.loads((out / "result.json").read_text())["uncertainty"]
    assert record["rms_um"] == pytest.approx(np.sqrt(np.mean(sigma**2)) * 1e6)
    assert 0 < record["within_one"] < record["within_two"] + 1e-9 < 1
    assert "uncertain  " in capsys.readouterr().out
    assert batch(*arguments, "--force") == 0
    assert sorted(os.listdir(out)) == sorted((*FILES, MARKER))
    assert json.loads((out / "result.json").read_text())["uncertainty"] is None


def test_auto_says_what_it_does(inputs, tmp_path, capsys):
    assert batch(inputs / "image.tif", "-o", tmp_path / "out", "--max-iterations", 1) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("auto       refine: the image shows no folds")
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert record["settings"]["auto"]["plan"] == "refine"
