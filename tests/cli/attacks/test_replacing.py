"""What may be replaced, and that a kill or a second writer at any point leaves one whole result."""

import errno
import json
import os
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace

import pytest
from attack import genuine

from cli.marker import MARKER, read_marker, strangers
from cli.output import check_target, result_folder
from cli.results import RECONSTRUCTION
from warp_caustics.errors import InputError, MismatchError, ResourceError
from warp_caustics.io import exchange
from warp_caustics.io.journal import journal_path, only_writer


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


def test_a_disk_without_room_for_the_journal_leaves_nothing(tmp_path, monkeypatch):
    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device")

    target = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        with (
            pytest.raises(ResourceError, match="No space left on device; .*; free space"),
            only_writer(journal_path(target), target),
        ):
            pass
        assert list(tmp_path.iterdir()) == []
        # What a writer that was killed had noted is still told to the next one.
        told = json.dumps({"pid": 1, "state": "writing", "folder": "x"})
        journal_path(target).write_text(told + "\n")
        with pytest.raises(ResourceError), only_writer(journal_path(target), target):
            pass
    assert journal_path(target).read_text() == told + "\n"


def test_the_lock_file_of_a_target_is_kept_short(tmp_path):
    target = tmp_path / ("x" * 255)
    with only_writer(journal_path(target), target) as journal:
        journal.note({"state": "writing"})
    assert list(tmp_path.iterdir()) == []
    assert replace(RECONSTRUCTION, name="x").files == RECONSTRUCTION.files
