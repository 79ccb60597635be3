"""The published scheme: its energy in closed form, and how far it gets."""

import numpy as np
import pytest
import torch

from nets.reconstruct.methods import create
from warp_caustics import CausticSimulator, Scene
from warp_caustics.metrics import height_errors
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.transport.hcccd import HcccdOptions, vertex_energy, vertex_normals

SMALL = Scene(height_samples=32, image_pixels=64, plate_size_m=(0.02, 0.02))


def caustic(scene=SMALL, height_m=1.5e-4):
    ends = [((-7e-3, -5e-3), (6e-3, 4e-3)), ((-4e-3, 7e-3), (5e-3, -6e-3))]
    truth = line_relief([Line(start, end, 3e-3, height_m) for start, end in ends], 32, scene.plate_size_m)
    image = CausticSimulator(scene, n_photons=397**2)(torch.from_numpy(truth).float()).numpy()
    return truth, CausticImage(image)


def plane(slope_x, slope_y, cells=12):
    """Vertices of a tilted plane at z = 1 in its middle, shape [3, N, N]."""
    axis = (torch.arange(cells, dtype=torch.float64) + 0.5) / cells - 0.5
    x, y = torch.meshgrid(axis, axis, indexing="xy")
    return torch.stack([x, y, 1 + slope_x * x + slope_y * y])


def test_normals_of_a_plane():
    normals = vertex_normals(plane(0.3, -0.2))
    expected = torch.tensor([-0.3, 0.2, 1.0], dtype=torch.float64) / np.sqrt(0.3**2 + 0.2**2 + 1)
    torch.testing.assert_close(normals, expected[:, None, None].expand_as(normals))


def test_energy_term_by_term():
    """Each term alone, on a flat mesh of 12 x 12 vertices: tilted normals, a step off the ray, a bump, a deep base."""
    flat = plane(0.0, 0.0)
    down = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)[:, None, None].expand_as(flat)
    upright = vertex_normals(flat)
    off = {"ray_weight": 0.0, "smoothness": 0.0, "barrier": 0.0}

    def energy(vertices, wanted=upright, lowest=0.5, **weights):
        return float(vertex_energy(vertices, flat, wanted, down, lowest, HcccdOptions(**(off | weights))))

    assert energy(flat, ray_weight=1.0, smoothness=1.0, barrier=1.0) == pytest.approx(0, abs=1e-20)
    assert energy(flat, wanted=-upright) == pytest.approx(4 * 144)
    aside = flat + torch.tensor([0.01, 0.0, 0.5], dtype=torch.float64)[:, None, None]
    assert energy(aside, ray_weight=5e3) == pytest.approx(5e3 * 144 * 1e-4)
    bump = flat.clone()
    bump[2, 5, 5] += 0.01
    assert energy(bump, smoothness=2.0) - energy(bump) == pytest.approx(2.0 * 20e-4)
    assert energy(flat, barrier=1.0, lowest=1.1) == pytest.approx(144 * np.log(0.9) ** 2)


def test_weak_relief_and_the_drift_of_the_base():
    """The shape is found, the base is not: it drifts by about the mean of the relief, which is reported."""
    truth, image = caustic()
    seen = []
    result = create("hcccd", SMALL).reconstruct(image, progress=seen.append)
    errors = height_errors(result.heights_m, truth, SMALL.plate_size_m)
    assert errors["rmse_mean_removed_um"] < 0.4 * errors["reference_rms_um"]
    drift = result.counters["base_drift_m"]
    assert drift < -3e-6
    assert drift == pytest.approx(np.quantile(result.heights_m, 0.1))
    assert any("drifted" in warning for warning in result.warnings)
    outer = [entry for entry in result.history if "base_m" in entry]
    assert len(outer) == result.counters["outer_iterations"] >= 2
    assert outer[-1]["moved_m"] < 0.1 * outer[0]["moved_m"]
    assert result.counters["sideways_m"] < 1e-4
    assert len(seen) == len(result.history)
    assert result.residual < 0.15


def test_smoothness_blunts_the_crests():
    _, image = caustic()
    smooth, sharp = (
        create("hcccd", SMALL, smoothness=weight, max_iterations=3).reconstruct(image) for weight in (5e5, 0.0)
    )
    assert np.ptp(smooth.heights_m) < 0.9 * np.ptp(sharp.heights_m)


def test_interruption_returns_the_last_surface():
    """Ctrl-C after two outer iterations, and Ctrl-C while light is still being carried."""
    _, image = caustic()
    for stage, count in (("normals", 2), ("transport", 30)):
        seen = []

        def interrupt(progress, stage=stage, count=count, seen=seen):
            seen.append(progress.stage.startswith(stage))
            if sum(seen) == count:
                raise KeyboardInterrupt

        result = create("hcccd", SMALL).reconstruct(image, progress=interrupt)
        assert result.stop_reason == "interrupted"
        assert len(result.history) == len(seen)
        assert result.residual < 0.8 * np.linalg.norm(1 - image.irradiance) / np.linalg.norm(image.irradiance)


def test_time_limit_is_kept():
    result = create("hcccd", SMALL, max_time_s=1e-6).reconstruct(caustic()[1])
    assert result.stop_reason == "max_time" and result.counters["outer_iterations"] == 1


def test_single_refraction_is_warned_of():
    """With a screen 5 mm below in air the ray bends again at the bottom face, which the scheme does not know."""
    scene = SMALL.model_copy(update={"screen_position_m": (0.0, 0.0, -5e-3)})
    truth, image = caustic(scene, 3e-5)
    result = create("hcccd", scene, max_iterations=2).reconstruct(image)
    assert any("bottom face" in warning for warning in result.warnings)
    better = create("transport", scene).reconstruct(image)
    rms = [height_errors(r.heights_m, truth, scene.plate_size_m)["rmse_mean_removed_um"] for r in (result, better)]
    assert rms[1] < 0.5 * rms[0]


def test_a_folded_caustic_ends_in_finite_heights():
    """Lines 1.5 mm high: nothing like the truth is found, but the result is finite, and the image's misfit is told."""
    _, image = caustic(height_m=1.5e-3)
    result = create("hcccd", SMALL, max_iterations=3).reconstruct(image)
    assert np.isfinite(result.heights_m).all() and result.heights_m.min() >= -0.5 * SMALL.base_thickness_m
    assert any("light paths cross" in warning for warning in result.warnings)
