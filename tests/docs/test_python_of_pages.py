"""Python on the pages compiles, imports what there is, and the interface's example finds its relief."""

import importlib
import re

import numpy as np
import pytest

from tests.docs.pages import DOCS, blocks

PYTHON = list(blocks("python"))


@pytest.mark.parametrize("block", PYTHON, ids=lambda block: block.name)
def test_python_compiles_and_names_exist(block):
    """What is imported is there; the rest at least compiles. README's and the interface's examples are run, too."""
    compile(block.text, block.name, "exec")
    for module, names in re.findall(r"^from ([\w.]+) import ([\w, ]+)", block.text, re.M):
        assert all(hasattr(importlib.import_module(module), name.strip()) for name in names.split(","))


def test_interface_example_runs():
    """README's is run by test_readme."""
    (block,) = [block for block in PYTHON if block.page == DOCS / "api" / "index.md"]
    names = {}
    exec(compile(block.text, block.name, "exec"), names)
    gradient = names["heights"].grad.numpy()
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 0
    truth = names["heights"].detach().numpy()
    assert np.sqrt(np.mean((names["result"].heights_m - truth) ** 2)) < 0.2 * np.sqrt(np.mean(truth**2))
