"""What attacks on written files share: commands whose long part only pretends."""

import shutil
import sys
from pathlib import Path

import pytest

import nets.reconstruct
from cli.inspection.job import InspectionJob
from warp_caustics.errors import InputError

HERE = str(Path(__file__).parent)
if HERE not in sys.path:
    sys.path.insert(0, HERE)


@pytest.fixture
def commands(inputs, tmp_path, monkeypatch):
    """Commands whose long part only pretends."""
    from attack import Commands

    folder = tmp_path / "inputs"
    shutil.copytree(inputs, folder)
    shutil.copy(folder / "image.tif", folder / "second.tif")

    class Reached(InputError):
        """What a long part raises: it was begun, the folder was taken for one that may be written."""

    def reached(*args, **options):
        raise Reached("reached")

    for name in ("cli.train._trained", "cli.search._searched", "cli.testset._write", "nets.evaluation.fields.prepare"):
        monkeypatch.setattr(name, reached)
    monkeypatch.setattr("cli.job.Job._announce", reached)
    monkeypatch.setattr("cli.data._announce", lambda *args: None)
    monkeypatch.setattr("cli.inspection.series._Series._draw_trend", lambda series: None)
    monkeypatch.setattr("warp_caustics.design.designer.Designer.design", reached)
    fake = type("Fake", (), {"reconstruct": reached})
    monkeypatch.setattr(InspectionJob, "method", lambda job: fake())
    monkeypatch.setattr("cli.job.make_method", lambda *args: fake())
    assert nets.reconstruct is not None
    return Commands(folder)
