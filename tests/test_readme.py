"""The README says what is true."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_make_targets_exist():
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
    named = set(re.findall(r"`?make ([a-z]+)", README))
    assert {"demo", "test"} <= named <= targets


def test_commands_exist():
    from cli.main import COMMANDS

    named = set(re.findall(r"`?nsfc ([a-z]+)", README))
    assert named == set(COMMANDS)


def test_named_files_exist():
    for name in re.findall(r"`((?:configs|constraints|examples)/[\w./-]+)`", README):
        assert (ROOT / name).exists(), name
    links = re.findall(r"\]\((?!https?:)([^)]+)\)", README)
    assert "docs/demo.png" in links
    assert all((ROOT / link.partition("#")[0]).is_file() for link in links)


def test_result_files_are_those_written():
    from cli.results import FILES

    table = README.split("| file | content |")[1].split("\n\n")[0]
    assert set(re.findall(r"`([a-z.]+\.(?:npy|tif|stl|png|html|json|yaml))`", table)) == set(FILES)


def test_exit_codes_are_those_used():
    import warp_caustics.errors as errors

    codes = {int(code) for code in re.findall(r"^\| (\d+) \|", README, re.M)}
    classes = [errors.InputError, errors.DamagedDataError, errors.MismatchError, errors.ResourceError]
    used = {0, errors.EXIT_BUG, errors.EXIT_USAGE, errors.EXIT_INTERRUPTED, errors.EXIT_TERMINATED, errors.EXIT_FAILED}
    assert codes == used | {error.exit_code for error in classes}


def test_python_example_runs():
    """At a quarter of its resolution, to be quick."""
    (example,) = re.findall(r"```python\n(.*?)```", README, re.S)
    assert "image_pixels=256" in example
    names = {}
    exec(compile(example.replace("image_pixels=256", "image_pixels=64"), "README.md", "exec"), names)
    assert names["heights"].grad.abs().max() > 0


@pytest.mark.parametrize("script", [".ci/run"])
def test_scripts_are_executable_bash(script):
    path = ROOT / script
    assert path.stat().st_mode & 0o111
    subprocess.run(["bash", "-n", path], check=True)
