"""The commands of the page from a bare lab to a verdict work on the files that it names."""

import json
import shlex
from pathlib import Path

import pytest

from cli.main import main

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "lab.md").read_text(encoding="utf-8")
LINES = [
    shlex.split(line)
    for line in PAGE.splitlines()
    if line.startswith(("nsfc capture examples", "nsfc reconstruct examples"))
]
INSPECTION = next(shlex.split(line) for line in PAGE.splitlines() if line.startswith("nsfc inspect examples"))


@pytest.mark.parametrize("words", LINES, ids=lambda words: words[1])
def test_commands_run_on_the_files_that_come_along(words, tmp_path, monkeypatch):
    """As a newcomer types them: with one iteration, which explains nothing, a reconstruction takes three times as long."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    assert main(words[1:]) == 0
    assert (tmp_path / words[words.index("-o") + 1]).exists()


def test_the_example_is_what_its_list_of_lines_says(tmp_path, monkeypatch):
    """As a newcomer types it: capture, print and list tell the same plate, though one line is as narrow as a sample."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    assert INSPECTION[INSPECTION.index("--nominal") + 1] == "examples/data/printed_lines.csv"
    assert main(INSPECTION[1:]) == 0
    found = json.loads((tmp_path / "verdict" / "inspection.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "pass"
    assert {fibre["status"] for fibre in found["fibres"]} == {"as designed"}


def test_every_step_is_there_and_searches_find_it():
    assert len(LINES) == 2
    for word in ("lamp", "collimation", "screen", "camera", "exposure", "dark", "flat", "corners", "calibration"):
        assert word in PAGE.lower()
    assert "monochrome" in PAGE and "Take a photo" in PAGE
    named = [word.strip("`,.") for word in PAGE.split() if "examples/data/" in word]
    assert all((ROOT / name).exists() for name in named)
