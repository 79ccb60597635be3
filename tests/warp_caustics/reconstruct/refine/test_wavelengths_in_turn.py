"""One wavelength at a time: the same objective in sum, the same photons, and a descent that arrives."""

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.pyramid import measurement_at, simulator_at
from warp_caustics.reconstruct.refine.height_descent import HeightDescent
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.refine.relief_objective import ReliefObjective
from warp_caustics.reconstruct.refine.wavelengths_in_turn import WavelengthsInTurn, single_wavelengths
from warp_caustics.resampling import blur_matrices

SCENE = Scene(height_samples=16, image_pixels=32)
CPU = torch.device("cpu")


def bump(height_m):
    x = np.linspace(-1, 1, 16)
    return height_m * np.exp(-20 * (x[None] ** 2 + x[:, None] ** 2))


def measured(heights, scene=SCENE, noise=1e-5, mask=None):
    with torch.no_grad():
        irradiance = CausticSimulator(scene)(torch.tensor(heights, dtype=torch.float32)).numpy()
    return measurement_at(CausticImage(irradiance, np.full(3, noise), mask=mask), scene, 32, CPU, 1)


def options(**wished):
    return RefineOptions(**wished).resolved("height", False, SCENE, "cpu")


def test_the_first_look_is_at_all_wavelengths():
    simulator, measurement = simulator_at(SCENE, 32, CPU), measured(bump(8e-5))
    heights = torch.tensor(bump(5e-5))
    values, gradient = WavelengthsInTurn(single_wavelengths(simulator), measurement, options())(heights)
    expected, whole = ReliefObjective(simulator, measurement, options())(heights)
    torch.testing.assert_close(values[[0, 2]], expected[[0, 2]], rtol=1e-6, atol=0)
    assert float(values[1]) == pytest.approx(float(expected[1]), rel=0.02)  # norms of the three images differ
    torch.testing.assert_close(gradient, whole, rtol=1e-3, atol=1e-5 * float(whole.abs().max()))


def test_each_wavelength_has_its_own_blur():
    simulator, measurement = simulator_at(SCENE, 32, CPU), measured(bump(8e-5))
    heights, blur = torch.tensor(bump(5e-5)), blur_matrices(32, np.array([0.0, 0.7, 2.0]), "cpu")
    values, gradient = WavelengthsInTurn(single_wavelengths(simulator), measurement, options(), blur)(heights)
    expected, whole = ReliefObjective(simulator, measurement, options(), blur)(heights)
    torch.testing.assert_close(values[[0, 2]], expected[[0, 2]], rtol=1e-6, atol=0)
    torch.testing.assert_close(gradient, whole, rtol=1e-3, atol=1e-5 * float(whole.abs().max()))
    _, sharp = ReliefObjective(simulator, measurement, options())(heights)
    assert float((gradient - sharp).abs().max()) > 0.01 * float(sharp.abs().max())


def test_then_each_has_its_turn():
    simulator, measurement = simulator_at(SCENE, 32, CPU), measured(bump(8e-5))
    singles = single_wavelengths(simulator)
    in_turn, heights = WavelengthsInTurn(singles, measurement, options()), torch.tensor(bump(5e-5))
    _, mean = in_turn(heights)
    gradients = [in_turn(heights).gradient for _ in range(6)]
    torch.testing.assert_close(torch.stack(gradients[:3]).mean(0), mean)
    for first, again in zip(gradients[:3], gradients[3:], strict=True):
        torch.testing.assert_close(first, again)
    assert not torch.allclose(gradients[0], gradients[2], rtol=1e-3)


def test_a_wavelength_that_shows_nothing_has_none():
    """Switched off, or masked everywhere: then its misfit is no number."""
    dark = SCENE.model_copy(update={"radiosity_W_m2": (1.0, 0.0, 1.0)})
    assert list(single_wavelengths(simulator_at(dark, 32, CPU))) == [0, 2]
    mask = np.ones((3, 32, 32), dtype=bool)
    mask[1] = False
    in_turn = WavelengthsInTurn(
        single_wavelengths(simulator_at(SCENE, 32, CPU)), measured(bump(8e-5), mask=mask), options()
    )
    assert len(in_turn.objectives) == 2
    for _ in range(4):
        values, gradient = in_turn(torch.tensor(bump(5e-5)))
        assert values.isfinite().all() and gradient.isfinite().all()


@pytest.mark.parametrize("scene", [SCENE, SCENE.model_copy(update={"radiosity_W_m2": (1.0, 0.0, 0.5)})])
def test_a_descent_arrives_as_with_all_at_once(scene):
    """Steps of one wavelength explain the image as steps of all do; the second image owes nothing to the first."""
    simulator, truth, start = simulator_at(scene, 32, CPU), bump(8e-4), bump(7e-4)
    wished, measurement = options(max_iterations=60, total_variation=0.0), measured(truth, scene)
    judge = ReliefObjective(simulator, measurement, wished)
    left = {}
    for in_turn in (False, True):
        descent = HeightDescent(simulator, wished, in_turn)
        for target in (measured(bump(2e-4), scene), measurement):
            descent.run(target, start, lambda evaluation: None)
        assert isinstance(descent.objective, WavelengthsInTurn) == in_turn
        left[in_turn] = float(judge(torch.tensor(descent.best_heights())).values[1])
    before = float(judge(torch.tensor(start)).values[1])
    assert left[False] < 0.3 * before
    assert left[True] < 1.05 * left[False]


def test_the_lowest_objective_is_kept():
    """A step so large that it only does harm."""
    wished = options(max_iterations=12, step_m=2e-4)
    descent, start, notes = HeightDescent(simulator_at(SCENE, 32, CPU), wished, in_turn=True), bump(7.9e-5), []
    descent.run(measured(bump(8e-5)), start, notes.append)
    assert min(note.objective for note in notes) == notes[0].objective
    np.testing.assert_array_equal(descent.best_heights(), start)
