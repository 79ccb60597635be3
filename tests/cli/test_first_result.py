"""What a first result must not wait for, asked in a process of its own."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"

NOT_NEEDED = {
    "h5py", "IPython", "lightning", "matplotlib.pyplot", "onnx", "optuna", "OpenEXR", "pandas", "pytest", "skimage",
    "scipy.stats", "sklearn", "sympy", "torch._dynamo", "torch._inductor", "torch.onnx", "torch.utils.tensorboard",
}  # fmt: skip
"""Each takes a tenth of a second or more: torch._dynamo, with sympy, 0.7 s."""


@pytest.fixture(scope="module")
def first_result(tmp_path_factory):
    """What a process said of itself after ``nsfc reconstruct`` of the example."""
    code = (
        "import gc, json, sys\nfrom cli.main import main\ncode = main(sys.argv[1:])\n"
        "print(json.dumps({'modules': sorted(sys.modules), 'left': gc.get_freeze_count()})); sys.exit(code)"
    )
    output = tmp_path_factory.mktemp("first") / "out"
    data = EXAMPLES / "data"
    arguments = ["reconstruct", data / "capture.tif", "--dark", data / "dark.tif", "--flat", data / "flat.tif"]
    arguments += ["-o", output, "--config", EXAMPLES / "demo.yaml", "--method", "direct", "--device", "cpu"]
    run = subprocess.run([sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert "overview.png" in os.listdir(output)
    return json.loads(run.stdout.splitlines()[-1])


def test_a_first_result_loads_nothing_it_does_not_need(first_result):
    modules = set(first_result["modules"])
    assert {"torch", "warp", "matplotlib.figure", "nets.reconstruct.direct"} <= modules
    assert not NOT_NEEDED & modules


def test_modules_are_left_out_of_the_search_for_garbage(first_result):
    """Torch and Warp alone make a quarter of a million objects."""
    assert first_result["left"] > 200_000
