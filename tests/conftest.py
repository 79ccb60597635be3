"""Fixtures that several test packages share."""

import contextlib
import ctypes
import gc
import os
import signal
import stat

import pytest

from warp_caustics.scene import Scene

if "PYTEST_XDIST_WORKER" in os.environ:
    # Tests run on all cores already; threads of several workers would wait for each other. Before torch and NumPy are
    # imported.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What a script starts beside itself ignores Ctrl-C, and Python with it; the tests send it to themselves and to children.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

KEPT_BYTES = 2**30
"""Freed memory that a process of the tests keeps. By default malloc hands arrays of more than 32 MiB back at once and
each new one is paged in again, zeros first: in virtual machines more than half of the oracle's time."""

# For workers and children, before they start; for this process itself by mallopt (M_TRIM_THRESHOLD, M_MMAP_THRESHOLD).
os.environ.setdefault("MALLOC_TRIM_THRESHOLD_", str(KEPT_BYTES))
os.environ.setdefault("MALLOC_MMAP_THRESHOLD_", str(KEPT_BYTES))
with contextlib.suppress(AttributeError, OSError):  # other C libraries have none
    for parameter in (-1, -3):
        ctypes.CDLL(None).mallopt(parameter, KEPT_BYTES)


_fsync = os.fsync


def _synced(descriptor):
    """As ``os.fsync``, refusals included, but for the disk, for which some thousand calls would wait 5 ms each."""
    mode = os.fstat(descriptor).st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        _fsync(descriptor)


@pytest.fixture(scope="session", autouse=True)
def no_waiting_for_disks():
    """No test cuts the power: that files are synced, and in which order, is told by the calls. Children do sync."""
    os.fsync = _synced
    yield
    os.fsync = _fsync


@pytest.fixture
def real_fsync(no_waiting_for_disks, monkeypatch):
    """Asked for where the call itself is tested."""
    monkeypatch.setattr(os, "fsync", _fsync)


def pytest_addoption(parser):
    parser.addoption("--device", default="cpu", help="device for tests that run on any: cpu, cuda, cuda:1")


def pytest_collection_finish():
    """Modules and tests stay to the end: collections of garbage need not look through them again and again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def device(request):
    """Device of this test run."""
    return request.config.getoption("--device")


@pytest.fixture(scope="session")
def tiny_scene():
    """Tab. 1 with 16^2 heights and 32^2 pixels."""
    return Scene(height_samples=16, image_pixels=32)
