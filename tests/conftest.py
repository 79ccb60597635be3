"""Fixtures that several test packages share."""

import gc
import os

import pytest

from warp_caustics.scene import Scene

if "PYTEST_XDIST_WORKER" in os.environ:
    # Tests run on all cores already; threads of several workers would wait for each other. Before torch is imported.
    os.environ.setdefault("OMP_NUM_THREADS", "1")


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
