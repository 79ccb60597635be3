"""Every command that writes, against every kind of thing that is not its own: nothing of anybody is ever lost.

One attack is a place with something in it, and a command that is told to write there. Whatever the command
says, all that was there is there afterwards, with the same content. Methods only pretend.
"""

import json
import os
import shutil

import pytest
from attack import FILES, FOLDERS, KINDS, KINDS_OF_RESULTS, NO_FORCE, attack, genuine, put, tree

from cli.main import main
from cli.marker import MARKER, sealed_marker, write_marker
from cli.results import RECONSTRUCTION
from warp_caustics.io.journal import journal_path


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


@pytest.mark.parametrize("name", [*FOLDERS, *FILES])
def test_a_link_that_points_at_itself_is_no_place(commands, tmp_path, name, capsys):
    """It exists neither as a file nor as a folder, and no folder can be made of it."""
    out = tmp_path / ("loop" + (".tif" if name in FILES else ""))
    out.symlink_to(out.name)
    force = name not in NO_FORCE or name in FILES
    assert attack(tmp_path, commands, name, out, force) == 3
    error = capsys.readouterr().err
    assert "loop" in error and "reached" not in error
