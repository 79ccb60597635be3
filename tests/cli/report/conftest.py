"""A small result with everything in it, and a browser without a network."""

import contextlib
import dataclasses
import html
import os
import re
import shutil
import signal
import subprocess

import numpy as np
import pytest

from cli.report.content import ReportContent
from warp_caustics.capture.stage import CaptureStage
from warp_caustics.inspection.findings import FibreFinding, Inspection, Region
from warp_caustics.scene import Scene

BROWSER = next(
    (found for name in ("chromium", "google-chrome", "chromium-browser") if (found := shutil.which(name))), None
)

# Names resolve to nothing, so that any request for something outside the file fails.
OPTIONS = [
    "--headless", "--no-sandbox", "--no-first-run", "--hide-scrollbars", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-quic",
    "--host-resolver-rules=MAP * ~NOTFOUND", "--virtual-time-budget=6000",
]  # fmt: skip
WEBGL = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""In software, which takes a second or two of each start."""


@pytest.fixture
def content(relief):
    """A recovered plate of 32 x 32 samples with a peak at row 20, column 5, and all that a report can hold."""
    rng = np.random.default_rng(3)
    scene = Scene(height_samples=32, image_pixels=64, plate_size_m=(0.05, 0.03))
    heights = relief + 1e-6 * rng.standard_normal((32, 32))
    heights[20, 5] = 5e-4
    measured = 1 + 0.1 * rng.standard_normal((3, 64, 64)).astype(np.float32)
    simulated = measured + 0.02
    mask = np.ones((32, 32), bool)
    mask[:2] = False
    deviation = heights - relief
    region = Region(
        1, (-0.0164, 0.0042), (-0.0172, 0.0038), (-0.0156, 0.0047), 1.4e-6, 6.5e-10, float(deviation[20, 5])
    )
    fibre = FibreFinding("1", "too high", (-0.012, -0.01), (0.012, 0.008), 2.5e-5, float("nan"), 1.25e-9)
    inspection = Inspection(
        "fail", ("1 region is out of tolerance",), 2e-5, relief, deviation, mask, np.abs(deviation) > 2e-5, (region,),
        (fibre,), 2.5e-8, 2e-8, 5.5e-5, ("the design was moved",),
    )  # fmt: skip
    stages = (
        CaptureStage("corners", "4 corners found", measured * 100, None, np.array([[3.0, 5.0], [60.0, 58.0]]), {"rms_px": 0.25}),
        CaptureStage("channels", "taken as they are"),
    )  # fmt: skip
    record = {
        "method": "refine", "residual": 0.01234, "stop_reason": "max_iterations", "iterations": 3,
        "errors": {"rmse_um": 4.567, "quantile95_um": 9.5, "reference_rms_um": 88.0},
        "uncertainty": {"within_one": 0.7, "within_two": 0.96}, "timings_s": {"a": 1.5, "b": 0.25},
        "counters": {"landed": [1.0, 1.0, float("nan")]}, "settings": {"nested": {"step_m": 5e-6}, "none": None},
        "warnings": ["only a fake"], "inputs": {"image": {"path": "folder/a.tif", "sha256": "ab" * 32}},
        "versions": {"nsfc": "0.1.0"}, "created": "2026-01-02T03:04:05+0000", "config_fingerprint": "feed",
        "history": [
            {"stage": "one", "iteration": 1, "residual": None}, {"stage": "one", "iteration": 2, "residual": 0.5},
            {"stage": "two", "iteration": 3, "residual": np.float32(0.25)},
        ],
    }  # fmt: skip
    return ReportContent(
        "plate.tif", scene, record, measured, simulated, heights, np.full((32, 32), 2e-6), relief, stages, inspection
    )


@pytest.fixture
def bare(content):
    """The same result with nothing but what is always there."""
    return dataclasses.replace(
        content, record={"method": "fake"}, uncertainty_m=None, reference_m=None, stages=(), inspection=None
    )


ATTEMPTS, PATIENCE_S = 2, 140


def printed(command, folder):
    """What the browser prints. It is started again where it hangs: headless ones do now and then on busy machines."""
    environment = {**os.environ, "HOME": str(folder)}
    for attempt in range(ATTEMPTS):
        profile = f"--user-data-dir={folder / f'profile-{attempt}'}"
        process = subprocess.Popen(
            [*command, profile], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment, start_new_session=True
        )
        try:
            return process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            continue
        finally:
            # Its helpers, too, which hold the pipes.
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    raise AssertionError(f"the browser hung {ATTEMPTS} times for {PATIENCE_S} s")


@pytest.fixture
def browse(tmp_path):
    """Opens a page; returns the attributes that its script left on the root element, and a screenshot's path."""
    if BROWSER is None:
        pytest.skip("no chromium or google-chrome on PATH to open the page with")

    def browse(text, script="", size=(1400, 1200), scale=1.0, has_webgl=True):
        page, picture = tmp_path / "page.html", tmp_path / "page.png"
        page.write_text(text.replace("</body>", f"<script>{script}</script></body>"), encoding="utf-8")
        command = [
            BROWSER, *OPTIONS, *(WEBGL if has_webgl else ["--disable-gpu"]), f"--window-size={size[0]},{size[1]}", f"--force-device-scale-factor={scale}",
            f"--screenshot={picture}", "--dump-dom", page.as_uri(),
        ]  # fmt: skip
        output, errors = printed(command, tmp_path)
        root = re.search(r"<html ([^>]*)>", output.decode("utf-8"))
        assert root, errors.decode("utf-8", "replace")[-500:]
        return {name: html.unescape(value) for name, value in re.findall(r'data-([\w-]+)="([^"]*)"', root[1])}, picture

    return browse
