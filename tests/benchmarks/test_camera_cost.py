"""What cameras cost is measured on the device that was named, and nothing runs on another."""

import sys

import pytest
import warp as wp

from benchmarks import camera
from benchmarks.plot_cameras import caustic
from warp_caustics.errors import ResourceError
from warp_caustics.scene import Scene


def table(monkeypatch, capsys, device):
    """Rows that the program prints for small images."""
    monkeypatch.setattr(camera, "REPEATS", 1)
    monkeypatch.setattr(camera, "CAMERAS", {"careful": camera.CAMERAS["careful"]})
    monkeypatch.setattr(sys, "argv", ["camera", "--device", device, "--pixels", "64"])
    camera.main()
    return capsys.readouterr().out.splitlines()[2:]


def launches(monkeypatch):
    """Devices that kernels are launched on from now on."""
    found, launch = set(), wp.launch

    def noted(*arguments, **named):
        found.add(str(named.get("device")))
        return launch(*arguments, **named)

    monkeypatch.setattr(wp, "launch", noted)
    return found


def test_every_camera_gets_a_row(monkeypatch, capsys):
    found = launches(monkeypatch)
    rows = table(monkeypatch, capsys, "cpu")
    assert [row.split(" | ")[0].strip("| ") for row in rows] == ["perfect", "careful", "from the side"]
    assert found == {"cpu"}


def test_a_device_that_is_not_there_is_refused_before_anything_is_simulated(monkeypatch, capsys):
    found = launches(monkeypatch)
    with pytest.raises(ResourceError, match="cuda:99"):
        table(monkeypatch, capsys, "cuda:99")
    assert not found


@pytest.mark.gpu
def test_on_a_gpu_no_kernel_runs_on_the_cpu(monkeypatch, capsys, device):
    found = launches(monkeypatch)
    assert len(table(monkeypatch, capsys, device)) == 3
    assert found and not any("cpu" in name for name in found)
    assert caustic(Scene(image_pixels=64), device)[0].device.type == "cuda"
