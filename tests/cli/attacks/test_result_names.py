"""A result of every image, whatever its name."""

import importlib.util
import io
import json
import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from attack import CONFIG

import nets.reconstruct
from cli.main import main
from cli.marker import MARKER


@pytest.mark.parametrize(
    ("image", "folder"),
    [
        ("a.tif", "a"),
        ("...tif", "...tif"),
        ("..tif", "..tif"),
        (".tif", ".tif"),
        ("a..tif", "a."),
        ("summary.csv.tif", "summary.csv.tif"),
        ("plates.csv.png", "plates.csv.png"),
        (f"{MARKER}.tif", f"{MARKER}.tif"),
        ("b\udcff.tif", "b\udcff"),
    ],
)
def test_every_image_has_a_folder_of_its_own(image, folder):
    from cli.output import result_name

    assert result_name(f"some/{image}") == folder


def test_a_result_is_not_lost_because_of_its_name(inputs, tmp_path, fake_method):
    """Names that are no text, names of dots, a terminal that knows no umlauts."""
    names = [b"b\xff.tif", b"...tif", "ü {x}.tif".encode(), b"x" * 240 + b".tif"]
    folder = tmp_path / "images"
    folder.mkdir()
    for name in names:
        shutil.copy(inputs / "image.tif", os.path.join(os.fsencode(folder), name))
    # A process of its own: what stdout accepts is settled when Python starts.
    out = tmp_path / "out"
    done = fake_method(["reconstruct", str(folder), "-o", str(out), *CONFIG], "ascii")
    assert done.returncode == 0, done.stderr[-800:]
    results = [name for name in os.listdir(os.fsencode(out)) if name not in (b"summary.csv", MARKER.encode())]
    assert len(results) == len(names)
    assert all(b"report.html" in os.listdir(os.path.join(os.fsencode(out), name)) for name in results)


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_a_single_result_is_told_whatever_its_name(inputs, tmp_path, stand_in, monkeypatch, encoding):
    """As JSON on a stdout that knows no such name."""
    image, single = tmp_path / os.fsdecode(b"b\xff.tif"), tmp_path / "single"
    shutil.copy(inputs / "image.tif", image)
    told = io.BytesIO()
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(told, encoding, errors="strict", write_through=True))
    assert main(["reconstruct", str(image), "-o", str(single), *CONFIG, "--json"]) == 0
    assert (single / "report.html").exists() and json.loads(told.getvalue())["method"] == "fake"


@pytest.fixture
def stand_in(monkeypatch):
    """Puts a method that only pretends in place of the real ones, in this process."""
    spec = importlib.util.spec_from_file_location("fake_method", Path(__file__).parent.with_name("fake_method.py"))
    fake = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fake)
    module = fake.methods_module()
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(nets.reconstruct, "methods", module, raising=False)


@pytest.fixture
def fake_method():
    """Runs ``nsfc`` in a process of its own with a method that only pretends."""
    program = textwrap.dedent(f"""
        import importlib.util, sys
        import nets.reconstruct
        spec = importlib.util.spec_from_file_location("fake_method", {str(Path(__file__).parent.with_name("fake_method.py"))!r})
        fake = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(fake)
        module = fake.methods_module()
        sys.modules[module.__name__] = nets.reconstruct.methods = module
        from matplotlib.figure import Figure
        from tests.quick_figures import quickly
        Figure.savefig = quickly
        from cli.main import main
        sys.exit(main(sys.argv[1:]))
    """)

    def run(arguments, encoding):
        environment = {**os.environ, "PYTHONIOENCODING": f"{encoding}:strict"}
        return subprocess.run(
            [sys.executable, "-c", program, *arguments], env=environment, check=False, capture_output=True
        )

    return run
