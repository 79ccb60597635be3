"""Every example runs by itself and finds what it promises: each asserts its own result."""

import ast
import runpy
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest

GALLERY = Path(__file__).parents[1] / "examples" / "gallery"
SCRIPTS = sorted(GALLERY.glob("plot_*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_example_checks_itself(script):
    """An assert that names nothing computed would be no check."""
    tree = ast.parse(script.read_text(encoding="utf-8"))
    checks = [node for node in ast.walk(tree) if isinstance(node, ast.Assert)]
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and "assert_" in ast.unparse(node.func)]
    assert any(isinstance(inner, ast.Name) for node in [*checks, *calls] for inner in ast.walk(node))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_example_runs(script, tmp_path, monkeypatch):
    """From another folder than its own, without a screen; in this process, where torch is loaded already."""
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")
    plt.close("all")
    assert not list(tmp_path.iterdir())
