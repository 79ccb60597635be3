"""A reconstruction that only pretends, to test what an inspection does with one."""

from dataclasses import dataclass, field

import numpy as np
import pytest

import cli.inspection.job
from nets.inspection.from_nominal import FromNominalResult
from warp_caustics.prints.fit_design import FittedLine
from warp_caustics.reconstruct.base import Reconstruction

CONFIG = ("--config", "small", "--device", "cpu", "--tolerance", "50um")


@dataclass
class FakeMethod:
    """Answers with the design plus ``excess_m``; ``fail`` is raised."""

    excess_m: np.ndarray = field(default_factory=lambda: np.zeros((32, 32)))
    fail: BaseException | None = None
    stop_reason: str = "max_iterations"
    calls: int = 0

    def reconstruct(self, image, nominal, *, progress=None):
        self.calls += 1
        if self.fail is not None:
            raise self.fail
        result = Reconstruction(
            "design", nominal.relief_m + self.excess_m, 0.9 * image.irradiance, 0.1, self.stop_reason,
            timings_s={"free": 0.5}, uncertainty_m=np.full(nominal.relief_m.shape, 1e-6),
        )  # fmt: skip
        return FromNominalResult(result, tuple(FittedLine(line, 0.0, 0.0, 1e-6, 1e-6) for line in nominal.lines))


@pytest.fixture
def fake(monkeypatch):
    """Takes the place of the reconstruction."""
    method = FakeMethod()
    monkeypatch.setattr(cli.inspection.job.InspectionJob, "method", lambda job: method)
    return method


@pytest.fixture
def lines_csv(tmp_path):
    """The line behind the image of ``inputs``."""
    path = tmp_path / "lines.csv"
    path.write_text("start_x_mm,start_y_mm,end_x_mm,end_y_mm,width_mm,height_um\n-12,-10,12,8,6,300\n")
    return path
