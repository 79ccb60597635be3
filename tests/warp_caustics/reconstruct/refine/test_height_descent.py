"""Adam on the device, against torch's own; which relief is kept; one object for many images."""

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.objective import Evaluation
from warp_caustics.reconstruct.pyramid import measurement_at, simulator_at
from warp_caustics.reconstruct.refine.height_descent import HeightDescent
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.refine.relief_objective import ReliefObjective
from warp_caustics.reconstruct.run_log import RunLog, StopRun, note_evaluation
from warp_caustics.resampling import blur_matrices

SCENE = Scene(height_samples=16, image_pixels=32)
CPU = torch.device("cpu")
DEVICES = [
    "cpu",
    pytest.param(
        "cuda",
        marks=[pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")],
    ),
]


def bump(height_m):
    x = np.linspace(-1, 1, 16)
    return height_m * np.exp(-20 * (x[None] ** 2 + x[:, None] ** 2))


def image_of(heights, noise=None, device="cpu"):
    relief = torch.tensor(heights, dtype=torch.float32, device=device)
    with torch.no_grad():
        irradiance = CausticSimulator(SCENE, device=device)(relief).cpu().numpy()
    return CausticImage(irradiance, None if noise is None else np.full(3, noise))


def made(device="cpu", **options):
    resolved = RefineOptions(**options).resolved("height", False, SCENE, "cuda")
    return HeightDescent(simulator_at(SCENE, 32, torch.device(device)), resolved)


def measured(image, device="cpu"):
    return measurement_at(image, SCENE, 32, torch.device(device), 1)


@pytest.mark.parametrize("device", DEVICES)
def test_steps_are_those_of_adam_with_a_cosine(device):
    """Relief and objectives of 25 steps, in float64 but for the simulation."""
    descent, start = made(device, max_iterations=25), bump(5e-5)
    measurement, notes = measured(image_of(bump(8e-5), device=device), device), []
    descent.run(measurement, start, notes.append)
    objective = ReliefObjective(descent.simulator, measurement, descent.options)
    variable = torch.tensor(start, device=device)
    adam = torch.optim.Adam([variable], lr=5e-6)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(adam, 25, eta_min=5e-6 / 20)
    expected = []
    for _ in range(25):
        values, variable.grad = objective(variable)
        expected.append(Evaluation.read(values.tolist()))
        adam.step()
        schedule.step()
    # A GPU adds in any order, and Adam's first step goes by the sign of what is left where nothing is to be learned.
    tolerance = 1e-5 if device == "cpu" else 0.3
    np.testing.assert_allclose([n.objective for n in notes], [e.objective for e in expected], rtol=tolerance)
    np.testing.assert_allclose([n.residual for n in notes], [e.residual for e in expected], rtol=tolerance)
    assert notes[0].objective == pytest.approx(expected[0].objective, rel=1e-4)
    assert all(note.noise is None for note in notes)
    if device == "cpu":
        np.testing.assert_allclose(descent.heights, variable, atol=2e-9)


@pytest.mark.parametrize("device", DEVICES)
def test_the_lowest_objective_is_kept(device):
    """A step so large that it only does harm."""
    descent, start, notes = made(device, max_iterations=12, step_m=2e-4), bump(7.9e-5), []
    descent.run(measured(image_of(bump(8e-5), device=device), device), start, notes.append)
    assert min(note.objective for note in notes) == notes[0].objective
    np.testing.assert_array_equal(descent.best_heights(), start)
    assert not np.allclose(descent.heights.cpu(), start, atol=1e-6)


@pytest.mark.parametrize("device", DEVICES)
def test_the_first_relief_that_leaves_only_noise_is_kept(device):
    """Whatever is stepped on until the host reads of it."""
    image = image_of(bump(8e-4), 0.0012, device)
    descent, start = made(device, max_iterations=40, total_variation=0.0), bump(7e-4)
    log = RunLog(40, discrepancy=1.0)
    with pytest.raises(StopRun) as stopped:
        descent.run(measured(image, device), start, lambda evaluation: note_evaluation(log, "here", evaluation))
    assert stopped.value.reason == "discrepancy"
    noises = [entry["discrepancy"] for entry in log.history]
    assert noises[-1] <= 1 < min(noises[:-1])
    objective = ReliefObjective(descent.simulator, measured(image, device), descent.options)
    at_best = Evaluation.read(objective(torch.tensor(descent.best_heights(), device=device)).values.tolist())
    assert at_best.noise == pytest.approx(noises[-1], rel=1e-5)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("noises", [(None, None), (0.001, 0.001), (None, 0.001), (0.001, None)])
def test_a_second_image_owes_nothing_to_the_first(device, noises):
    used = made(device, max_iterations=15)
    first = measured(image_of(bump(2e-4), noises[0], device), device)
    kept = first.irradiance.clone()
    used.run(first, bump(1e-4), lambda evaluation: None)
    fresh, found = made(device, max_iterations=15), []
    second = image_of(bump(8e-5), noises[1], device)
    for descent in (used, fresh):
        notes = []
        descent.run(measured(second, device), bump(5e-5), notes.append)
        found.append((descent.best_heights(), [note.objective for note in notes]))
        assert all((note.noise is None) == (noises[1] is None) for note in notes)
    assert torch.equal(first.irradiance, kept), "what is given stays what it is"
    assert found[0][1][0] == pytest.approx(found[1][1][0], rel=1e-4)
    # On the way a GPU's sums led two runs a third apart, in one of four steps.
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-6 if device == "cpu" else 0.6)
    if device == "cpu":
        np.testing.assert_allclose(found[0][0], found[1][0], atol=1e-10)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("blurs", [(0.0, 1.0), (1.0, 0.0), (2.0, 0.7)])
def test_a_second_camera_owes_nothing_to_the_first(device, blurs):
    """Its blur is copied over the first one's, which a recorded step reads, or recorded anew."""

    def matrices(blur):
        return blur_matrices(32, np.full(3, blur), device) if blur else None

    used, fresh, found = made(device, max_iterations=15), made(device, max_iterations=15), []
    first = matrices(blurs[0])
    kept = None if first is None else first.clone()
    image = measured(image_of(bump(8e-5), device=device), device)
    used.run(image, bump(1e-4), lambda evaluation: None, first)
    for descent in (used, fresh):
        notes = []
        descent.run(image, bump(5e-5), notes.append, matrices(blurs[1]))
        found.append([note.objective for note in notes])
    assert kept is None or torch.equal(first, kept), "what is given stays what it is"
    np.testing.assert_allclose(found[0], found[1], rtol=1e-6 if device == "cpu" else 0.3)
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-4)


def test_the_gradient_goes_through_the_blur():
    """Against differences of the objective along one direction."""
    measurement = measured(image_of(bump(8e-4)))
    options = RefineOptions(max_iterations=1).resolved("height", False, SCENE, "cuda")
    blur = blur_matrices(32, np.array([0.5, 1.0, 2.0]), "cpu")
    objective = ReliefObjective(simulator_at(SCENE, 32, CPU), measurement, options, blur)
    heights, along, step = torch.tensor(bump(6e-4)), torch.tensor(bump(1.0)), 2e-6
    slope = float((objective(heights).gradient * along).sum())
    ahead, behind = (float(objective(heights + sign * step * along).values[0]) for sign in (1, -1))
    assert slope == pytest.approx((ahead - behind) / (2 * step), rel=0.02)
    sharp = ReliefObjective(objective.simulator, measurement, options)
    assert float(sharp(heights).values[0]) != pytest.approx(float(objective(heights).values[0]), rel=0.05)


def test_no_step_cuts_through_the_plate():
    deep = np.full((16, 16), -2.69e-3)
    descent = made(max_iterations=3, step_m=1e-3, nonnegativity=0.0)
    descent.run(measured(image_of(bump(8e-5))), deep, lambda evaluation: None)
    assert float(descent.heights.min()) >= -0.9 * SCENE.base_thickness_m
