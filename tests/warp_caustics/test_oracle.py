"""The oracle stands on its own: what it checks must not tell it what to expect."""

import ast
from pathlib import Path

import pytest

from warp_caustics import oracle
from warp_caustics.kernels import footprint, profiles
from warp_caustics.optics import MAX_SIGMA_FRACTION, MIN_SIGMA_PX


def test_it_imports_nothing_from_what_it_checks():
    """Only the scene, which is data, comes from the package."""
    tree = ast.parse(Path(oracle.__file__).read_text())
    imports = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    imports |= {name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names}
    assert {name for name in imports if name.startswith("warp_caustics")} == {"warp_caustics.scene"}


def test_its_constants_are_those_of_the_kernels():
    """Written out twice, so that one of them cannot change unseen."""
    assert pytest.approx(profiles.REACH, rel=1e-14) == oracle._REACH
    assert oracle._BOX_VARIANCE == footprint.BOX_VARIANCE
    assert oracle._LEAST_SIGMA_PX == MIN_SIGMA_PX
    assert oracle._LARGEST_SIGMA == MAX_SIGMA_FRACTION
