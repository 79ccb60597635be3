"""The notebook runs from the first cell to the last, without Jupyter, and is stored without outputs."""

import ast
import json
from pathlib import Path

NOTEBOOK = Path(__file__).parents[1] / "examples" / "first_steps.ipynb"


def cells():
    return json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]


def test_it_is_stored_as_one_would_begin():
    assert len({cell["id"] for cell in cells()}) == len(cells())
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells() if "outputs" in cell)


def test_its_cells_run_one_after_the_other(tmp_path, monkeypatch):
    """What a cell ends with is shown there, so it must have a short repr."""
    monkeypatch.chdir(tmp_path)
    names, shown = {}, []
    for cell in cells():
        if cell["cell_type"] != "code":
            continue
        tree = ast.parse("".join(cell["source"]))
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, cell["id"], "exec"), names)
        if last is not None:
            shown.append(eval(compile(ast.Expression(last.value), cell["id"], "eval"), names))
    assert all(len(repr(value)) < 600 for value in shown)
    assert repr(names["result"]).startswith("Reconstruction('transport', 48 x 48 heights from ")
    shown[-1].savefig(tmp_path / "result.png")
    assert not [path for path in tmp_path.iterdir() if path.name != "result.png"]
