"""Many plates, and a folder that is watched."""

import csv
import os
import shutil
import time

import numpy as np
import pytest

import cli.inspection.series
from cli.inspection.plates import COLUMNS
from cli.inspection.watch import Watcher
from cli.main import main
from cli.marker import MARKER

CONFIG = ("--config", "small", "--device", "cpu", "--tolerance", "50um")


@pytest.fixture
def plates(inputs, tmp_path):
    """Folder with two images and one that is none."""
    folder = tmp_path / "plates"
    folder.mkdir()
    for name in ("a.tif", "c.tif"):
        shutil.copy(inputs / "image.tif", folder / name)
    (folder / "b.tif").write_text("no image at all\n")
    for age, name in enumerate(("c.tif", "b.tif", "a.tif")):
        os.utime(folder / name, (1e9 - age, 1e9 - age))
    return folder


def inspect(*arguments):
    return main(["inspect", *map(str, arguments), *CONFIG])


def rows(folder):
    with open(folder / "plates.csv", newline="") as file:
        reader = csv.DictReader(file)
        found = list(reader)
    assert tuple(reader.fieldnames) == COLUMNS
    return found


def test_one_row_per_plate_and_a_bad_image_stops_nothing(full_figures, fake, plates, lines_csv, tmp_path):
    out = tmp_path / "out"
    assert inspect(plates, "--nominal", lines_csv, "-o", out) == 3
    table = rows(out)
    assert [(row["image"], row["status"], row["verdict"], row["exit_code"]) for row in table] == [
        ("a.tif", "done", "pass", "0"), ("b.tif", "failed", "", "3"), ("c.tif", "done", "pass", "0"),
    ]  # fmt: skip
    assert "b.tif" in table[1]["error"] and float(table[0]["volume_mm3"]) > 0
    assert sorted(os.listdir(out)) == [MARKER, "a", "c", "plates.csv", "trend.png"]
    assert (out / "trend.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_listed_is_skipped_until_it_changes(fake, plates, lines_csv, tmp_path):
    out = tmp_path / "out"
    inspect(plates, "--nominal", lines_csv, "-o", out)
    assert fake.calls == 2
    os.utime(plates / "a.tif", (2e9, 2e9))  # another time, the same content
    assert inspect(plates, "--nominal", lines_csv, "-o", out) == 3
    assert fake.calls == 2
    fake.excess_m = np.full((32, 32), 0.0)
    fake.excess_m[:6, :6] = 3e-4
    assert inspect(plates / "a.tif", plates / "c.tif", "--nominal", lines_csv, "-o", out, "--force") == 7
    assert fake.calls == 4 and [row["verdict"] for row in rows(out) if row["image"] != "b.tif"] == ["fail", "fail"]


def test_other_settings_inspect_again(fake, plates, lines_csv, tmp_path):
    out = tmp_path / "out"
    inspect(plates, "--nominal", lines_csv, "-o", out)
    inspect(plates, "--nominal", lines_csv, "-o", out, "--margin", "1mm")
    assert fake.calls == 4 and len(rows(out)) == 3


def test_a_foreign_table_is_refused(fake, plates, lines_csv, tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "plates.csv").write_text("a,b\n1,2\n")
    assert inspect(plates, "--nominal", lines_csv, "-o", tmp_path / "out") == 4
    assert "has other columns than this version writes" in capsys.readouterr().err


def test_watcher_waits_until_a_file_is_complete(tmp_path):
    """Seen twice alike and not empty; each version once; hidden files and others never."""
    watcher = Watcher(str(tmp_path), lambda path: False)
    path = tmp_path / "a.tif"
    assert watcher.look() == []
    path.write_bytes(b"")
    (tmp_path / ".b.tif").write_bytes(b"x")
    (tmp_path / "notes.txt").write_bytes(b"x")
    assert watcher.look() == [] and watcher.look() == []
    path.write_bytes(b"one")
    assert watcher.look() == []
    path.write_bytes(b"one two")
    assert watcher.look() == []
    assert watcher.look() == [str(path)]
    assert watcher.look() == []
    path.write_bytes(b"another plate")
    assert watcher.look() == []
    assert watcher.look() == [str(path)]
    path.unlink()
    assert watcher.look() == []


def test_watch_goes_on_after_a_bad_image_and_where_it_was(fake, plates, lines_csv, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    arguments = [str(plates), "--nominal", str(lines_csv), "-o", str(out), "--watch", "0.5"]

    def sleeping(limit, new=None):
        looks = []

        def sleep(seconds):
            assert seconds == 0.5
            looks.append(seconds)
            if len(looks) == 1 and new is not None:
                shutil.copy(plates / "a.tif", plates / new)
            if len(looks) == limit:
                raise KeyboardInterrupt

        return sleep

    run_watch = cli.inspection.series.run_watch
    with monkeypatch.context() as patch:
        patch.setattr(cli.inspection.series, "run_watch", lambda *a: run_watch(*a, sleep=sleeping(2)))
        assert inspect(*arguments) == 130
    assert [row["image"] for row in rows(out)] == ["a.tif", "b.tif", "c.tif"]  # in order of time
    assert fake.calls == 2 and "3 plates are in" in capsys.readouterr().err
    with monkeypatch.context() as patch:
        patch.setattr(cli.inspection.series, "run_watch", lambda *a: run_watch(*a, sleep=sleeping(4, new="d.tif")))
        assert inspect(*arguments) == 130
    assert [row["image"] for row in rows(out)] == ["a.tif", "b.tif", "c.tif", "d.tif"]
    assert fake.calls == 3


def test_ctrl_c_within_a_plate_leaves_it_for_the_next_start(fake, plates, lines_csv, tmp_path, monkeypatch):
    out = tmp_path / "out"
    fake.stop_reason = "interrupted"
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    assert inspect(plates, "--nominal", lines_csv, "-o", out, "--watch", "0.01") == 130
    assert not (out / "plates.csv").exists()
    fake.stop_reason = "max_iterations"
    assert inspect(plates / "a.tif", plates / "c.tif", "--nominal", lines_csv, "-o", out) == 0
