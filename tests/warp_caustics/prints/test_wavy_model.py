"""Lines that vary along their way, against printed ones and against differences."""

import numpy as np
import pytest
import torch

from warp_caustics.determinism import VARIABLE
from warp_caustics.prints.chains import chains_of
from warp_caustics.prints.imperfections import WEIGHTS, wavy
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel, lines_of
from warp_caustics.prints.paths import PrintedPath, paths_relief
from warp_caustics.prints.wavy_model import KNOT_M, WavyModel, knot_counts
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=64, image_pixels=64, plate_size_m=(0.05, 0.04))
LINES = 1e-3 * torch.tensor([[-10.0, 3.0, 12.0, -7.0, 2.9, 0.8], [1.0, 2.0, 5.0, 5.0, 1.3, 1.0]], dtype=torch.float64)
COUNTS = knot_counts(LINES)
SHAPES = (Shape(), Shape(1.2, 0.3, 0.5, 0.3, 2e-3), Shape(is_cap=True), Shape(overlap=0.0), Shape(5.0, cut=0.08))


def model_of(shape, device="cpu"):
    model = LineModel(SCENE, device=device, supersampling=8)
    model.shape = shape
    return model


def waves(seed=0):
    """Smooth ones of 4 % and 50 um."""
    rng = np.random.default_rng(seed)
    at = np.linspace(0, 1, int(COUNTS.max()))
    turns = rng.uniform(0, 2 * np.pi, (len(LINES), 2, 1))
    knots = np.sin(2 * np.pi * 3 * at + turns) * np.array([0.04, 5e-5])[:, None]
    return torch.from_numpy(knots.transpose(0, 2, 1).copy())


def test_knots_are_as_far_apart_as_was_said():
    lengths = (LINES[:, 2:4] - LINES[:, :2]).norm(dim=1)
    apart = lengths / (COUNTS - 1)
    assert (apart <= KNOT_M).all() and (apart > 0.8 * KNOT_M).all()
    assert knot_counts(torch.zeros(1, 6)).tolist() == [2]


@pytest.mark.parametrize("shape", SHAPES)
def test_without_waves_lines_are_straight(shape):
    model = model_of(shape)
    still = torch.zeros(len(LINES), int(COUNTS.max()), 2)
    torch.testing.assert_close(WavyModel(model, COUNTS).heights(LINES, still), model.heights(LINES), rtol=0, atol=1e-9)


def test_waves_are_those_that_are_printed():
    """Beside a path of many points, which looks for the nearest part of the line that turns."""
    share, sideways, length = np.full(2, 0.04), np.full(2, 5e-5), np.full(2, 6e-3)
    phases = np.random.default_rng(0).uniform(0, 2 * np.pi, (2, 4))
    lines = lines_of(LINES)
    ends = [np.array([line.start_m, line.end_m]) for line in lines]
    meant = chains_of(ends, [line.width_m for line in lines], [line.height_m for line in lines])
    chains = wavy(meant, share, sideways, length, phases)
    last = np.append(chains.first[1:], len(chains.points_m))
    paths = [
        PrintedPath(chains.points_m[a:b], chains.widths_m[a:b], chains.heights_m[a:b])
        for a, b in zip(chains.first, last, strict=True)
    ]
    expected = paths_relief(paths, 64, SCENE.plate_size_m)
    knots = np.zeros((2, int(COUNTS.max()), 2))
    for k, count in enumerate(COUNTS.tolist()):
        arc = np.linspace(0, float((LINES[k, 2:4] - LINES[k, :2]).norm()), count)
        for which, amplitude in ((0, share[k]), (1, sideways[k])):
            for wave, weight in enumerate(WEIGHTS):
                turns = 2 * np.pi * arc / (length[k] / (1.0, 1.6180339887498949)[wave])
                knots[k, :count, which] += amplitude * weight * np.sin(turns + phases[k, 2 * which + wave])
    model = model_of(Shape())
    found = WavyModel(model, COUNTS).heights(LINES, torch.from_numpy(knots)).double().numpy()
    plain = np.linalg.norm(model.heights(LINES).numpy() - expected)
    assert plain > 0.02 * np.linalg.norm(expected), "as these lines are without"
    assert np.linalg.norm(found - expected) < 0.08 * plain


@pytest.mark.parametrize("shape", SHAPES)
def test_gradient_by_lines_and_knots(shape):
    """Against differences of a weighted sum of heights, which few points of a cap's steep edge decide."""
    exact = 0.06 if shape.is_cap else 0.02
    wavy_model, knots = WavyModel(model_of(shape), COUNTS), waves()
    weight = torch.randn(64, 64, generator=torch.Generator().manual_seed(1))
    alone = wavy_model.alone(LINES, knots)
    by_line, by_knot = wavy_model.gradient(LINES, knots, alone, weight)

    def value(lines, knots):
        return float((wavy_model.heights(lines, knots).double() * weight.double()).sum())

    scale = float(by_line.abs().max())
    for number in range(6):
        step = torch.zeros_like(LINES)
        step[0, number] = 5e-6
        expected = (value(LINES + step, knots) - value(LINES - step, knots)) / 1e-5
        assert float(by_line[0, number]) == pytest.approx(expected, abs=exact * scale)
    for which, size in ((0, 2e-3), (1, 2e-6)):
        scale = float(by_knot[..., which].abs().max())
        for line, knot in ((0, 0), (0, 20), (0, int(COUNTS[0]) - 1), (1, 4)):
            step = torch.zeros_like(knots)
            step[line, knot, which] = size
            expected = (value(LINES, knots + step) - value(LINES, knots - step)) / (2 * size)
            assert float(by_knot[line, knot, which]) == pytest.approx(expected, abs=exact * scale)
    assert not by_knot[1, int(COUNTS[1]) :].any(), "a shorter line has fewer"


def test_gradient_of_steep_edges():
    """Of half ellipses single points at the edge jump, and not all of them together: all knots move alike."""
    wavy_model, knots = WavyModel(model_of(Shape(0.5, 1.0)), COUNTS), waves()
    weight = torch.ones(64, 64)
    _, by_knot = wavy_model.gradient(LINES, knots, wavy_model.alone(LINES, knots), weight)
    step = torch.zeros_like(knots)
    step[..., 0] = 0.01
    ahead, behind = (float(wavy_model.heights(LINES, knots + sign * step).double().sum()) for sign in (1, -1))
    assert float((by_knot * step).sum()) == pytest.approx((ahead - behind) / 2, rel=0.02)


@pytest.mark.gpu
@pytest.mark.parametrize("is_deterministic", [False, True])
def test_a_gpu_agrees(monkeypatch, is_deterministic):
    if not torch.cuda.is_available():
        pytest.skip("needs a CUDA device")
    monkeypatch.setenv(VARIABLE, str(int(is_deterministic)))
    weight, found = torch.randn(64, 64, generator=torch.Generator().manual_seed(1)), []
    for device in ("cpu", "cuda"):
        wavy_model = WavyModel(model_of(SHAPES[1], device), COUNTS)
        alone = wavy_model.alone(LINES, waves())
        assert alone.device.type == device
        found.append((alone.cpu(), *wavy_model.gradient(LINES, waves(), alone, weight.to(device))))
    # Roots and powers of a GPU are good to two units in the last place; single points at an edge decide otherwise.
    for one, other in zip(*found, strict=True):
        assert float((one - other).norm()) <= 2e-3 * float(one.norm())
