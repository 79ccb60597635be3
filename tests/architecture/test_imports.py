"""What may import what, and what ``nsfc --help`` must not load."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ORDER = ("warp_caustics", "data_gen", "nets", "cli")
HEAVY = {
    "torch", "warp", "numpy", "scipy", "matplotlib", "h5py", "skimage", "trimesh", "tifffile", "pydantic", "yaml",
    "lightning", "optuna",
}  # fmt: skip

MANY_MODULES = 400
"""Help pages load about 265 modules in a tenth of a second; torch alone would bring 1,100 and take a second."""


def imported_packages(source):
    """Top-level names of everything that a module imports, functions included."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            names.add((node.module or "").split(".")[0])
    return names


def forbidden_for(package):
    return {*ORDER[ORDER.index(package) + 1 :], "tests"}


@pytest.mark.parametrize("package", ORDER)
def test_imports_point_down(package):
    """warp_caustics <- data_gen <- nets <- cli."""
    modules = sorted((ROOT / package).rglob("*.py"))
    assert modules
    for module in modules:
        wrong = imported_packages(module.read_text(encoding="utf-8")) & forbidden_for(package)
        assert not wrong, f"{module.relative_to(ROOT)} imports {', '.join(sorted(wrong))}"


def test_the_check_sees_imports_inside_functions():
    source = "import numpy.linalg\ndef f():\n    from cli.main import main\n"
    assert imported_packages(source) == {"numpy", "cli"}
    assert imported_packages(source) & forbidden_for("warp_caustics") == {"cli"}


def test_kernels_know_nothing_of_torch():
    for module in (ROOT / "warp_caustics" / "kernels").glob("*.py"):
        assert "torch" not in imported_packages(module.read_text(encoding="utf-8")), module.name


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["simulate", "--help"],
        ["design", "-h"],
        ["reconstruct", "-h"],
        ["inspect", "-h"],
        ["config", "-h"],
        ["data", "build", "-h"],
        ["train", "-h"],
        ["search", "-h"],
        ["compare", "-h"],
        ["capture", "-h"],
        ["weights", "info", "-h"],
    ],
)
def test_help_loads_nothing_heavy(arguments):
    code = (
        "import sys; from cli.main import main; code = main(sys.argv[1:]);"
        f"print('HEAVY', sorted({HEAVY!r} & set(sys.modules)), len(sys.modules)); sys.exit(code)"
    )
    run = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert "Usage: nsfc" in run.stdout
    mark, heavy, modules = run.stdout.splitlines()[-1].split()
    assert (mark, heavy) == ("HEAVY", "[]")
    assert int(modules) < MANY_MODULES


def test_the_installed_command_answers():
    run = subprocess.run([Path(sys.executable).with_name("nsfc"), "--help"], capture_output=True, text=True)
    assert run.returncode == 0 and "Usage: nsfc" in run.stdout


def test_package_imports_lazily():
    """import warp_caustics stays cheap; its public names come on first use."""
    code = (
        "import sys, warp_caustics; early = {'torch', 'warp', 'pydantic'} & set(sys.modules);"
        "warp_caustics.Scene; print(early, 'pydantic' in sys.modules, 'torch' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["set()", "True", "False"]
