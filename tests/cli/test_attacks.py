"""Every command that writes, against every kind of thing that is not its own: nothing of anybody is ever lost.

One attack is a place with something in it, and a command that is told to write there. Whatever the command
says, all that was there is there afterwards, with the same content. Methods only pretend.
"""

import errno
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import nets.reconstruct
from cli.design import DESIGN_FILES
from cli.inspection.files import INSPECTION, INSPECTION_FILES
from cli.inspection.job import InspectionJob
from cli.main import main
from cli.marker import MARKER, read_marker, sealed_marker, strangers, write_marker
from cli.output import ResultKind, check_target, result_folder
from cli.results import ALL_FILES, RECONSTRUCTION
from cli.testset import testset_kind as fields_kind
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io import exchange
from warp_caustics.io.journal import journal_path, only_writer

CONFIG = ("--config", "small", "--device", "cpu")
RUN = (
    "config.resolved.yaml", "metrics.csv", "weights.safetensors", "checkpoints/model.pt", "checkpoints/last.ckpt",
    "pictures/holiday.png", "tensorboard/notes.txt", ".lock",
)  # fmt: skip
SEARCH = ("search.yaml", "study.db", "best.yaml", "network.yaml", "trials.csv", "report.html", ".claims.lock")
COMPARISON = ("index.html", "table.csv", "table.json", "summary.csv", "cells/a.json", "images/a.npz")
STORE = ("config.json", "index.h5", "COMPLETE.json", "shards/00000.h5", "thesis.tex")


class Commands:
    """How each command is told to write to a path, with inputs that are right."""

    def __init__(self, folder):
        self.image, self.heights, self.lines = folder / "image.tif", folder / "heights.npy", folder / "lines.csv"
        self.picture = folder / "picture.npy"
        np.save(self.picture, np.eye(16))
        self.lines.write_text("start_x_mm,start_y_mm,end_x_mm,end_y_mm,width_mm,height_um\n-12,-10,12,8,6,300\n")

    def line(self, name, out):
        second = self.image.with_name("second.tif")
        check = ("--nominal", self.lines, "--tolerance", "50um")
        lines = {
            "reconstruct": ("reconstruct", self.image, "-o", out, *CONFIG),
            "batch": ("reconstruct", self.image, second, "-o", out, *CONFIG),
            "inspect": ("inspect", self.image, "-o", out, *check, *CONFIG),
            "series": ("inspect", self.image, second, "-o", out, *check, *CONFIG),
            "design": ("design", self.picture, "-o", out, "--max-time", "1e-6", *CONFIG),
            "testset": ("data", "testset", out, "--fields", "1", *CONFIG),
            "train": ("train", "direct", "--fresh", "-o", out, "--max-steps", "1", "--device", "cpu"),
            "search": ("search", "denoiser", "--fresh", "-o", out, "--n-trials", "1", "--device", "cpu"),
            "compare": ("compare", self.heights, "--methods", "flat", "-o", out, *CONFIG),
            "build": ("data", "build", "updater", out, "--n", "3", *CONFIG),
            "simulate": ("simulate", self.heights, "-o", out, *CONFIG),
            "capture": ("capture", self.image, "-o", out, "--config", "small"),
        }
        return [str(part) for part in lines[name]]


FOLDERS = {
    "reconstruct": ALL_FILES,
    "batch": ("summary.csv", "image/height.npy", "image/report.html", "second/result.json"),
    "inspect": INSPECTION_FILES,
    "series": ("plates.csv", "trend.png", "image/inspection.json", "image/height.npy", "image/report.html"),
    "design": DESIGN_FILES,
    "testset": fields_kind().files[:3],
    "train": RUN,
    "search": SEARCH,
    "compare": COMPARISON,
    "build": STORE,
}
NO_FORCE = ("build", "search", "compare", "simulate", "capture")
FILES = {"simulate": "caustic.tif", "capture": "irradiance.tif"}


@pytest.fixture
def commands(inputs, tmp_path, monkeypatch):
    """Commands whose long part only pretends."""
    folder = tmp_path / "inputs"
    shutil.copytree(inputs, folder)
    shutil.copy(folder / "image.tif", folder / "second.tif")

    class Reached(InputError):
        """What a long part raises: it was begun, the folder was taken for one that may be written."""

    def reached(*args, **options):
        raise Reached("reached")

    for name in ("cli.train._trained", "cli.search._searched", "cli.testset._write", "nets.evaluation.fields.prepare"):
        monkeypatch.setattr(name, reached)
    monkeypatch.setattr("cli.job.Job._announce", reached)
    monkeypatch.setattr("cli.data._announce", lambda *args: None)
    monkeypatch.setattr("cli.inspection.series._Series._draw_trend", lambda series: None)
    monkeypatch.setattr("warp_caustics.design.designer.Designer.design", reached)
    fake = type("Fake", (), {"reconstruct": reached})
    monkeypatch.setattr(InspectionJob, "method", lambda job: fake())
    monkeypatch.setattr("cli.job.make_method", lambda *args: fake())
    assert nets.reconstruct is not None
    return Commands(folder)


def tree(folder):
    """Everything below a folder: kind and content by path."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = ("link", os.readlink(path))
        elif path.is_file():
            found[name] = ("file", hashlib.sha256(path.read_bytes()).hexdigest(), path.stat().st_ino)
        else:
            found[name] = ("folder",) if path.is_dir() else ("other",)
    return found


def attack(tmp_path, commands, name, out, force):
    """Run a command; returns its exit code, after all that was there was found again."""
    before = tree(tmp_path)
    code = main([*commands.line(name, out), *(["--force"] if force else [])])
    after = tree(tmp_path)
    lost = {path: entry for path, entry in before.items() if after.get(path) != entry}
    assert not lost, f"{name}, --force {force}: {lost}"
    assert code not in (0, 1), (name, code)
    hidden = [path for path in after if path not in before and os.path.basename(path).startswith(".nsfc-")]
    assert not hidden, hidden
    return code


def put(path, kind, tmp_path):
    """Something of somebody else in the place of a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    victim = tmp_path / "victim.txt"
    victim.write_text("years of work")
    if kind == "file":
        path.write_text("years of work")
    elif kind == "json":
        path.write_text(json.dumps({"method": "mine", "residual": 1, "kind": "run"}))
    elif kind == "folder":
        path.mkdir()
        (path / "thesis.tex").write_text("years of work")
    elif kind == "link":
        path.symlink_to(victim)
    elif kind == "pipe":
        os.mkfifo(path)
    return path


KINDS = ("file", "json", "folder", "link", "pipe")


@pytest.mark.parametrize("name", FOLDERS)
def test_a_name_of_ours_makes_no_file_ours(commands, tmp_path, name):
    """A lone file, folder, link or pipe of a name that the command writes, with --force and without."""
    number = 0
    for held in FOLDERS[name]:
        for kind in KINDS:
            for force in (False, True) if name not in NO_FORCE else (False,):
                number += 1
                out = tmp_path / f"out{number}"
                out.mkdir()
                put(out / held, kind, tmp_path)
                attack(tmp_path, commands, name, out, force)
                # A writer needs nothing of a batch whose own table is not touched.
                shutil.rmtree(out)
    print(f"attacks: {number}")


@pytest.mark.parametrize("name", FOLDERS)
def test_all_names_of_ours_together_make_no_folder_ours(commands, tmp_path, name):
    for number, kind in enumerate(("file", "json")):
        out = tmp_path / f"out{number}"
        for held in FOLDERS[name]:
            put(out / held, kind, tmp_path)
        attack(tmp_path, commands, name, out, force=name not in NO_FORCE)


def forged():
    return {
        "text": "mine",
        "list": "[]",
        "deep": "[" * 100_000,
        "kind": json.dumps({"written_by": "nsfc", "format": 1, "kind": "other", "id": "1", "files": {"a": ""}}),
        "format": json.dumps({"written_by": "nsfc", "format": 2, "kind": "run", "id": "1", "files": {"a": ""}}),
        "above": json.dumps(
            {
                "written_by": "nsfc",
                "format": 1,
                "kind": "reconstruction",
                "id": "1",
                "files": {"../victim.txt": "", "a": "0", "/etc/hostname": "", "..": ""},
            }
        ),
    }


@pytest.mark.parametrize("name", [name for name in FOLDERS if name != "build"])
def test_forged_markers(commands, tmp_path, name):
    for number, text in enumerate(forged().values()):
        for force in (False, True) if name not in NO_FORCE else (False,):
            out = tmp_path / f"out{number}{force}"
            put(out / "a", "file", tmp_path)
            (out / MARKER).write_text(text)
            place = {"batch": "summary.csv", "series": "plates.csv"}.get(name)
            if place is not None:
                put(out / place, "file", tmp_path)
            attack(tmp_path, commands, name, out, force)
    out = tmp_path / "linked"
    put(out / MARKER, "link", tmp_path)
    if name not in ("batch", "series"):
        attack(tmp_path, commands, name, out, force=name not in NO_FORCE)


@pytest.mark.parametrize("name", [*FOLDERS, *FILES])
def test_places_that_are_no_place(commands, tmp_path, name):
    """A file, a pipe, a broken link, a link to a folder of somebody else."""
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("x")
    (mine / "height.npy").write_text("x")
    (tmp_path / "file.tif").write_text("x")
    os.mkfifo(tmp_path / "pipe.tif")
    (tmp_path / "to_mine").symlink_to(mine)
    places = ["file.tif", "pipe.tif", "mine", "to_mine", "none/out.tif"]
    if name in ("batch", "series"):
        places = ["file.tif", "pipe.tif", "none/out.tif"]  # many results may lie in any folder
    for place in places:
        attack(tmp_path, commands, name, tmp_path / place, force=False)
        if name not in NO_FORCE:
            attack(tmp_path, commands, name, tmp_path / place, force=True)


@pytest.mark.parametrize("name", ["reconstruct", "inspect", "design", "testset"])
def test_the_place_of_the_lock(commands, tmp_path, name):
    for number, kind in enumerate(("file", "json", "folder", "link", "pipe")):
        out = tmp_path / f"out{number}"
        put(journal_path(out), kind, tmp_path)
        attack(tmp_path, commands, name, out, force=False)


@pytest.mark.parametrize("name", [*FOLDERS, *FILES])
def test_an_input_is_never_an_output(commands, tmp_path, name):
    """The input itself, a link to it, another name of the same file, and a result with an input in it."""
    number = 0
    sources = (commands.image, commands.heights, commands.lines, commands.picture)
    for source in sources:
        used = str(source) in commands.line(name, "out")
        if not used:
            continue
        hard, soft = tmp_path / "hard.tif", tmp_path / "soft.tif"
        os.link(source, hard)
        soft.symlink_to(source)
        for place in (source, hard, soft):
            for force in (False, True) if name not in ("build", "search", "compare") else (False,):
                number += 1
                attack(tmp_path, commands, name, place, force)
        hard.unlink()
        soft.unlink()


def genuine(out, kind):
    """A result as this program leaves it."""
    check_target(out, True, kind)
    with result_folder(out, True, kind) as folder:
        for name in kind.files:
            (folder / name).write_text(f"result {name}")
    return out


KINDS_OF_RESULTS = (RECONSTRUCTION, INSPECTION, ResultKind("design", DESIGN_FILES), fields_kind())


@pytest.mark.parametrize(
    ("name", "kind"), list(zip(("reconstruct", "inspect", "design", "testset"), KINDS_OF_RESULTS, strict=True))
)
def test_a_genuine_result_with_something_of_the_user(commands, tmp_path, name, kind):
    """A file more, one changed, one replaced by a link or a folder; a result of another command."""
    changes = {
        "more": lambda out: (out / "thesis.tex").write_text("x"),
        "hidden": lambda out: (out / ".git").mkdir(),
        "temporary": lambda out: (out / ".tmp-notes").write_text("x"),
        "changed": lambda out: (out / kind.files[0]).write_text("x"),
        "link": lambda out: ((out / kind.files[0]).unlink(), (out / kind.files[0]).symlink_to(commands.image)),
        "folder": lambda out: ((out / kind.files[0]).unlink(), (out / kind.files[0]).mkdir()),
        "marker": lambda out: (out / MARKER).write_text("x"),
        "unmarked": lambda out: (out / MARKER).unlink(),
    }
    for change, apply in changes.items():
        out = genuine(tmp_path / change, kind)
        apply(out)
        attack(tmp_path, commands, name, out, force=True)
    for number, other in enumerate(KINDS_OF_RESULTS):
        if other.name != kind.name:
            attack(tmp_path, commands, name, genuine(tmp_path / f"other{number}", other), force=True)


def test_inputs_within_the_result_that_is_replaced(commands, tmp_path, capsys):
    for number, role in enumerate(("image", "initial", "reference", "dark", "config", "linked")):
        out = genuine(tmp_path / f"r{number}", RECONSTRUCTION)
        inside = out / "height.tif"
        options = {"image": [], "linked": [], "config": ["--config", str(inside)]}.get(role, [f"--{role}", str(inside)])
        image = commands.image
        if role == "image":
            image = inside
        if role == "linked":
            image = tmp_path / "linked.tif"
            image.symlink_to(inside)
        if role == "config":
            inside = out / "config.resolved.yaml"
            inside.write_text("scene: {image_pixels: 128}\n")
            options = ["--config", str(inside)]
            write_marker(out, sealed_marker(RECONSTRUCTION.name, out))
        before = tree(tmp_path)
        line = ["reconstruct", str(image), "-o", str(out), "--device", "cpu", "--force", *options]
        assert main([*line, *([] if role == "config" else ["--config", "small"])]) == 3, role
        assert "is in the output" in capsys.readouterr().err, role
        assert tree(tmp_path) == before


# ------------------------------------------------------------------------------------------- what may be replaced


def test_a_result_of_an_earlier_version_may_be_replaced_as_far_as_it_is_known(tmp_path):
    from cli.marker import RESULT_KEYS

    out = genuine(tmp_path / "out", RECONSTRUCTION)
    (out / MARKER).unlink()
    assert strangers(out, "reconstruction", RECONSTRUCTION.files.__contains__)[0]  # no record says so
    (out / "result.json").write_text(json.dumps(dict.fromkeys(RESULT_KEYS)))
    assert strangers(out, "reconstruction", RECONSTRUCTION.files.__contains__) == ([], [])
    (out / "height.mat").write_text("mine")
    with pytest.raises(InputError, match="height.mat"):
        check_target(out, True, RECONSTRUCTION)
    (out / "height.mat").unlink()
    with pytest.raises(InputError, match="--force"):
        check_target(out, False, RECONSTRUCTION)
    genuine(out, RECONSTRUCTION)
    assert read_marker(out).kind == "reconstruction"


@pytest.fixture(params=["exchange", "two renames"])
def any_file_system(request, monkeypatch):
    """One that exchanges names, and one that cannot."""
    if request.param == "two renames":
        monkeypatch.setattr(exchange, "exchange", lambda one, other: False)
    return request.param


def test_replacing_leaves_the_new_result_and_nothing_else(tmp_path, any_file_system):
    out = genuine(tmp_path / "out", RECONSTRUCTION)
    first = read_marker(out).id
    genuine(out, RECONSTRUCTION)
    assert read_marker(out).id != first
    assert sorted(os.listdir(tmp_path)) == ["out"]
    assert sorted(os.listdir(out)) == sorted((*RECONSTRUCTION.files, MARKER))


def test_this_file_system_exchanges_names(tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / f"was_{name}").touch()
    if not exchange.exchange(tmp_path / "a", tmp_path / "b"):
        pytest.skip("it does not")
    assert (tmp_path / "a" / "was_b").exists() and (tmp_path / "b" / "was_a").exists()
    with pytest.raises(OSError) as found:
        exchange.exchange(tmp_path / "a", tmp_path / "none")
    assert found.value.errno == errno.ENOENT


KILLED = """
import os, signal, sys
from pathlib import Path
from cli.results import RECONSTRUCTION
from cli.output import result_folder
from warp_caustics.io import exchange
import cli.output
where, out, can_exchange = sys.argv[1], Path(sys.argv[2]), sys.argv[3] == "True"

def die(*args):
    os.kill(os.getpid(), signal.SIGKILL)

rename, swap, count = os.rename, exchange.exchange, 0

def renamed(old, new):
    global count
    count += 1
    if where == f"before rename {count}":
        die()
    rename(old, new)
    if where == f"after rename {count}":
        die()

def swapped(one, other):
    if where == "before exchange":
        die()
    done = swap(one, other) if can_exchange else False
    if where == "after exchange":
        die()
    return done

exchange.os.rename = renamed
exchange.exchange = swapped
if where == "while clearing":
    cli.output._clear = die
with result_folder(out, True, RECONSTRUCTION) as folder:
    for name in RECONSTRUCTION.files:
        (folder / name).write_text("new " + name)
        if where == "while writing" and name == "result.json":
            die()
if where == "at the end":
    die()
"""


@pytest.mark.parametrize(
    ("where", "can_exchange", "is_new"),
    [
        ("while writing", True, False),
        ("before exchange", True, False),
        ("after exchange", True, True),
        ("while clearing", True, True),
        ("before rename 1", False, False),
        ("after rename 1", False, True),  # neither has the name: the journal is finished
        ("before rename 2", False, True),
        ("after rename 2", False, True),
        ("while clearing", False, True),
        ("at the end", True, True),
    ],
)
def test_a_kill_at_any_point_leaves_one_result_and_the_next_command_sweeps(tmp_path, where, can_exchange, is_new):
    out = genuine(tmp_path / "out", RECONSTRUCTION)
    (tmp_path / ".nsfc-notes").write_text("mine")
    first = read_marker(out).id
    done = subprocess.run([sys.executable, "-c", KILLED, where, str(out), str(can_exchange)], check=False)
    assert done.returncode == -signal.SIGKILL
    # Without --force: nothing is replaced, but what was begun is ended.
    with pytest.raises(InputError, match="earlier result"), result_folder(out, False, RECONSTRUCTION):
        pass
    assert sorted(os.listdir(tmp_path)) == [".nsfc-notes", "out"]
    assert (read_marker(out).id != first) == is_new
    texts = {(out / name).read_text().split()[0] for name in RECONSTRUCTION.files}
    assert texts == {"new" if is_new else "result"}
    assert strangers(out, "reconstruction", RECONSTRUCTION.files.__contains__) == ([], [])


def test_files_that_appear_while_a_result_is_replaced_stay(tmp_path, any_file_system, monkeypatch):
    import cli.output

    out = genuine(tmp_path / "out", RECONSTRUCTION)
    publish = cli.output.publish_folder

    def slow(new, target):
        (out / "thesis.tex").write_text("just now")
        return publish(new, target)

    monkeypatch.setattr(cli.output, "publish_folder", slow)
    genuine(out, RECONSTRUCTION)
    assert (out / "thesis.tex").read_text() == "just now"
    assert sorted(os.listdir(tmp_path)) == ["out"]


def test_two_writers_of_one_result(tmp_path):
    out = tmp_path / "out"
    with result_folder(out, False, RECONSTRUCTION) as folder:
        (folder / "height.npy").write_text("first")
        with (
            pytest.raises(MismatchError, match=f"is being written by process {os.getpid()}"),
            result_folder(out, False, RECONSTRUCTION),
        ):
            pass
        assert MismatchError.exit_code == 5
    assert (out / "height.npy").read_text() == "first"
    assert sorted(os.listdir(tmp_path)) == ["out"]


def test_many_writers_of_one_result(tmp_path):
    """One or several win in turn, the others end with exit 5 or 3; the result is whole."""
    program = textwrap.dedent("""
        import sys, time
        from pathlib import Path
        from cli.failures import explained
        from cli.output import result_folder
        from cli.results import RECONSTRUCTION
        try:
            with result_folder(Path(sys.argv[1]), True, RECONSTRUCTION) as folder:
                for name in RECONSTRUCTION.files:
                    (folder / name).write_text(sys.argv[2])
                time.sleep(0.2)
        except Exception as error:
            sys.exit(explained(error)[1])
    """)
    out = tmp_path / "out"
    writers = [subprocess.Popen([sys.executable, "-c", program, str(out), str(k)]) for k in range(6)]
    codes = [writer.wait() for writer in writers]
    assert set(codes) <= {0, 5} and 0 in codes, codes
    assert len({(out / name).read_text() for name in RECONSTRUCTION.files}) == 1
    assert sorted(os.listdir(tmp_path)) == ["out"]


# -------------------------------------------------------------------------------------------------------- trainings


def test_two_trainings_into_one_folder(tmp_path):
    from cli.run_folder import run_folder

    run = tmp_path / "run"
    with run_folder(run, force=False, resume=False):
        for options in ({"force": True, "resume": False}, {"force": False, "resume": True}):
            with pytest.raises(MismatchError, match="is being written by process"), run_folder(run, **options):
                pass
    with run_folder(run, force=False, resume=False):
        pass


def test_a_dead_training_blocks_nobody(tmp_path):
    run = tmp_path / "run"
    program = (
        "import sys, time; from pathlib import Path; from cli.run_folder import run_folder\n"
        "with run_folder(Path(sys.argv[1]), force=False, resume=False):\n    print('in', flush=True); time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", program, str(run)], stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"in\n"
    from cli.run_folder import run_folder

    with pytest.raises(MismatchError, match=f"process {process.pid}"), run_folder(run, force=True, resume=False):
        pass
    process.kill()
    process.wait()
    with run_folder(run, force=False, resume=True):
        pass
    assert (run / ".lock").read_bytes() == b""


def test_force_of_a_run_removes_what_a_run_wrote(tmp_path):
    from cli.run_folder import run_folder

    run = tmp_path / "run"
    with run_folder(run, force=False, resume=False):
        for name in ("checkpoints/last.ckpt", "pictures/step-00000001.png", "tensorboard/events.out.tfevents.1.h.2.3"):
            (run / name).parent.mkdir(exist_ok=True)
            (run / name).touch()
    for name in ("checkpoints/model.pt", "pictures/holiday.png", "tensorboard/run/x", "metrics.xlsx"):
        path = put(run / name, "file", tmp_path)
        before = tree(run)
        with pytest.raises(InputError, match="holds other files"), run_folder(run, force=True, resume=False):
            pass
        assert tree(run) == before
        path.unlink()
        if name == "tensorboard/run/x":
            path.parent.rmdir()
    with run_folder(run, force=True, resume=False):
        assert sorted(os.listdir(run)) == [".lock", MARKER]


def test_a_run_of_an_earlier_version_may_be_resumed_and_replaced(tmp_path):
    from cli.run_folder import run_folder

    run = tmp_path / "run"
    (run / "checkpoints").mkdir(parents=True)
    (run / "checkpoints" / "last.ckpt").touch()
    (run / "config.resolved.yaml").write_text("kind: direct\nnetwork: {}\nscene: {}\ntraining: {}\n")
    with run_folder(run, force=False, resume=True):
        pass
    (run / MARKER).unlink()
    with run_folder(run, force=True, resume=False):
        assert not (run / "checkpoints").exists()


def test_a_training_that_cannot_start_deletes_nothing(tmp_path, capsys):
    from cli.run_folder import run_folder

    run = tmp_path / "run"
    with run_folder(run, force=False, resume=False):
        (run / "weights.safetensors").write_text("weights")
    for options in (
        ["--device", "cuda:99"],
        ["--device", "cpu", "--initial-weights", str(tmp_path / "none")],
        ["--device", "cpu", "--initial-weights", str(run / "weights.safetensors")],
    ):
        assert main(["train", "direct", "--fresh", "-o", str(run), "--force", "--max-steps", "1", *options]) in (3, 6)
        assert (run / "weights.safetensors").read_text() == "weights"


# ------------------------------------------------------------------------------------------------------------ names


@pytest.mark.parametrize(
    ("image", "folder"),
    [
        ("a.tif", "a"),
        ("...tif", "...tif"),
        ("..tif", "..tif"),
        (".tif", ".tif"),
        ("a..tif", "a."),
        ("summary.csv.tif", "summary.csv.tif"),
        ("plates.csv.png", "plates.csv.png"),
        (f"{MARKER}.tif", f"{MARKER}.tif"),
        ("b\udcff.tif", "b\udcff"),
    ],
)
def test_every_image_has_a_folder_of_its_own(image, folder):
    from cli.output import result_name

    assert result_name(f"some/{image}") == folder


def test_a_result_is_not_lost_because_of_its_name(inputs, tmp_path, fake_method):
    """Names that are no text, names of dots, a terminal that knows no umlauts; one image and several."""
    names = [b"b\xff.tif", b"...tif", "ü {x}.tif".encode(), b"x" * 240 + b".tif"]
    folder = tmp_path / "images"
    folder.mkdir()
    for name in names:
        shutil.copy(inputs / "image.tif", os.path.join(os.fsencode(folder), name))
    # A process of its own: what stdout accepts is settled when Python starts.
    out = tmp_path / "out"
    done = fake_method(["reconstruct", str(folder), "-o", str(out), *CONFIG], "ascii")
    assert done.returncode == 0, done.stderr[-800:]
    results = [name for name in os.listdir(os.fsencode(out)) if name not in (b"summary.csv", MARKER.encode())]
    assert len(results) == len(names)
    assert all(b"report.html" in os.listdir(os.path.join(os.fsencode(out), name)) for name in results)
    for encoding in ("utf-8", "ascii"):
        single = tmp_path / f"single-{encoding}"
        done = fake_method(
            ["reconstruct", folder / os.fsdecode(names[0]), "-o", str(single), *CONFIG, "--json"], encoding
        )
        assert done.returncode == 0 and (single / "report.html").exists(), done.stderr[-800:]


@pytest.fixture
def fake_method():
    """Runs ``nsfc`` in a process of its own with a method that only pretends."""
    program = textwrap.dedent(f"""
        import importlib.util, sys
        import nets.reconstruct
        spec = importlib.util.spec_from_file_location("fake_method", {str(Path(__file__).with_name("fake_method.py"))!r})
        fake = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(fake)
        module = fake.methods_module()
        sys.modules[module.__name__] = nets.reconstruct.methods = module
        from cli.main import main
        sys.exit(main(sys.argv[1:]))
    """)

    def run(arguments, encoding):
        environment = {**os.environ, "PYTHONIOENCODING": f"{encoding}:strict"}
        return subprocess.run(
            [sys.executable, "-c", program, *arguments], env=environment, check=False, capture_output=True
        )

    return run


# ------------------------------------------------------------------------------------------------ a believed verdict


def test_an_image_of_the_same_time_is_another_image(tmp_path):
    """Name, size and time are equal, as after `cp -p`: the content decides."""
    from cli.inspection.plates import Plates

    image = tmp_path / "a.tif"
    image.write_bytes(b"good")
    os.utime(image, (1e9, 1e9))
    plates = Plates(tmp_path, "settings")
    sha256 = hashlib.sha256(b"good").hexdigest()
    row = {"image": "a.tif", "exit_code": "0", "modified": "2001-09-09T01:46:40.000000000Z", "sha256": sha256}
    plates.add(str(image), row)
    assert plates.is_done(str(image))
    image.write_bytes(b"bad!")
    os.utime(image, (1e9, 1e9))
    assert not plates.is_done(str(image))
    plates.add(str(image), {**row, "sha256": ""})
    assert not plates.is_done(str(image))


def test_a_watched_folder_sees_an_image_of_the_same_time(tmp_path):
    from cli.inspection.watch import Watcher

    image = tmp_path / "a.tif"
    watcher = Watcher(str(tmp_path), lambda path: False)
    for content in (b"good", b"bad!"):
        image.write_bytes(content)
        os.utime(image, (1e9, 1e9))
        assert watcher.look() == []
        assert watcher.look() == [str(image)]
        time.sleep(0.02)  # the file system's clock ticks


def test_the_lock_file_of_a_target_is_kept_short(tmp_path):
    target = tmp_path / ("x" * 255)
    with only_writer(journal_path(target), target) as journal:
        journal.note({"state": "writing"})
    assert list(tmp_path.iterdir()) == []
    assert replace(RECONSTRUCTION, name="x").files == RECONSTRUCTION.files
