"""When Python looks for unused objects: not while modules load, always afterwards."""

import gc
import subprocess
import sys

import pytest

from cli.garbage import loaded, postponed


@pytest.fixture(autouse=True)
def enabled_again():
    yield
    gc.enable()


def test_nothing_is_sought_until_all_is_loaded():
    with postponed():
        assert not gc.isenabled()
        loaded()
        assert gc.isenabled()
    assert gc.isenabled()


def test_a_command_that_fails_early_leaves_the_search_on():
    with pytest.raises(ValueError, match="early"), postponed():
        raise ValueError("early")
    assert gc.isenabled()


def test_a_program_that_wants_no_search_keeps_it_off():
    gc.disable()
    with postponed():
        pass
    assert not gc.isenabled()


def test_what_was_there_before_is_kept_out_of_the_search_once():
    """A second time would keep what the work between has left unused."""
    code = (
        "import gc\nfrom cli.garbage import loaded, postponed\n"
        "with postponed(): loaded()\n"
        "first = gc.get_freeze_count()\n"
        "held = [[] for _ in range(1000)]\n"
        "with postponed(): loaded()\n"
        "print(first > 1000, gc.get_freeze_count() <= first)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["True", "True"]


def test_a_process_ends_without_a_search():
    """Last of all, after what modules do at the end; Python itself would look through everything once more."""
    code = (
        "import atexit, gc\natexit.register(lambda: print(gc.get_freeze_count()))\n"
        "import cli.main\natexit.register(lambda: print(gc.get_freeze_count()))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before, after = map(int, run.stdout.split())
    assert before == 0 and after > 1000
