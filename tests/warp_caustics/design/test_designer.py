"""Designs obey physics: light goes where it is asked, no more than there is, within the limits of the relief."""

import numpy as np
import pytest
import torch

from warp_caustics.design.designer import CHECK_PATHS_PER_PIXEL, Designer
from warp_caustics.design.options import DesignOptions
from warp_caustics.design.target import target_irradiance
from warp_caustics.errors import InputError
from warp_caustics.reconstruct.base import Progress
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

N, M = 32, 64
SCENE = Scene(height_samples=N, image_pixels=M)


def options(**changes):
    return DesignOptions(
        **({"start_cells": 32, "start_steps": 6, "max_iterations": 15, "coarsest_pixels": 32} | changes)
    )


def letter_f():
    """No mirror image or turn of it looks like it; drawn row by row from the top."""
    picture = np.zeros((M, M))
    picture[10:54, 20:27] = 1
    picture[10:17, 20:46] = 1
    picture[28:35, 20:40] = 1
    return picture


def disc(row, column, radius):
    i, j = np.mgrid[:M, :M]
    return ((i - row) ** 2 + (j - column) ** 2 < radius**2).astype(float)


def centroid(light):
    i, j = np.mgrid[:M, :M]
    return np.array([(light * i).sum(), (light * j).sum()]) / light.sum()


@pytest.fixture(scope="module")
def letter():
    return Designer(SCENE, options()).design(target_irradiance(letter_f(), SCENE, floor=0.3))


def relative(design):
    return design.image.mean(axis=0)


def test_even_picture_needs_no_relief():
    design = Designer(SCENE, options(max_iterations=60)).design(np.ones((M, M)))
    assert np.ptp(design.heights_m) < 20e-9
    assert design.stop_reason == "converged"


def test_letter_is_readable_and_not_mirrored(letter):
    image, target = relative(letter), letter.target
    agreement = np.corrcoef(image.ravel(), target.ravel())[0, 1]
    assert agreement > 0.9
    for turned in (image[:, ::-1], image[::-1], image[::-1, ::-1], image.T, image.T[::-1]):
        assert np.corrcoef(turned.ravel(), target.ravel())[0, 1] < agreement - 0.3


def test_descent_improves_on_transport(letter):
    """The same start without descent, through a time limit that the transport just outlasts, is farther off."""
    start = Designer(SCENE, options(max_time_s=1e-9)).design(letter.target)
    assert start.stop_reason == "max_time"
    assert start.counters["evaluations"] == 0
    assert letter.figures["picture"]["residual"] < 0.8 * start.figures["picture"]["residual"]


def test_light_is_conserved(letter):
    energy = letter.counters["energy"]
    for k in range(SCENE.n_wavelengths):
        fates = [energy[name][k] for name in energy if name not in ("wavelengths_m", "emitted_W")]
        assert sum(fates) == pytest.approx(1, abs=1e-6)
    lost = 1 - np.mean(energy["landed"])
    assert relative(letter).mean() == pytest.approx(1 - lost, abs=3e-3)
    assert letter.figures["picture"]["light_in_bright"] > 2 * letter.figures["picture"]["bright_area"]


def test_disc_gets_its_light_where_it_is():
    target = target_irradiance(disc(20, 44, 9), SCENE, floor=0.3)
    design = Designer(SCENE, options()).design(target)
    spot, wanted = np.maximum(relative(design) - 1, 0), np.maximum(target - 1, 0)
    assert np.abs(centroid(spot) - centroid(wanted)).max() < 1
    assert centroid(wanted) == pytest.approx([20, 44], abs=0.1)
    assert spot.sum() == pytest.approx(wanted.sum(), rel=0.15)


@pytest.mark.parametrize("limit_m", [1e-3, 1e-4])
def test_height_limit_is_exact(limit_m):
    target = target_irradiance(disc(20, 44, 9), SCENE, floor=0.3)
    design = Designer(SCENE, options(max_height_m=limit_m, screen_distance_m=0.1, max_iterations=8)).design(target)
    assert design.heights_m.min() == 0
    assert design.heights_m.max() <= limit_m
    needs_more = design.counters["start_height_range_m"] > limit_m
    assert any("keeps light back" in warning for warning in design.warnings) == needs_more
    if needs_more:
        assert design.heights_m.max() > 0.9 * limit_m, "the limit is used"


def test_farther_screen_takes_a_flatter_relief(letter):
    near, far = (
        Designer(SCENE, options(screen_distance_m=d, max_iterations=8, max_height_m=10e-3)).design(letter.target)
        for d in (0.2, 0.4)
    )
    assert np.ptp(near.heights_m) / np.ptp(far.heights_m) == pytest.approx(2, rel=0.1)


def test_nothing_is_random(letter):
    torch.manual_seed(77)
    np.random.seed(77)
    again = Designer(SCENE, options()).design(letter.target)
    np.testing.assert_allclose(again.heights_m, letter.heights_m, atol=1e-9)


def test_check_uses_other_light_paths(letter):
    """None of its paths is one of the descent's, and the picture is there all the same."""
    simulator = CausticSimulator(letter.scene, **letter.check)
    columns = simulator.plan.columns
    assert columns == CHECK_PATHS_PER_PIXEL * M + 1
    used = CausticSimulator(letter.scene, "lattice").plan.grid_x
    assert np.abs(simulator.plan.grid_x[:, None] - used[None, :]).min() > 1e-7
    heights = torch.tensor(letter.heights_m, dtype=torch.float32)
    np.testing.assert_allclose(simulator(heights).numpy(), letter.image, atol=1e-5)


def test_random_paths_show_the_same_picture(letter):
    """Photons that share nothing with a lattice: the design does not hang on where its light paths start."""
    simulator = CausticSimulator(letter.scene, "paper", n_photons=400_000, smoothing=4.0, seed=5)
    image = simulator(torch.tensor(letter.heights_m, dtype=torch.float32)).numpy().mean(axis=0)
    assert np.linalg.norm(image - relative(letter)) / np.linalg.norm(letter.image.mean(axis=0)) < 0.08


def test_result_says_what_was_done(letter):
    assert letter.settings["distance_was_chosen"]
    assert letter.scene.screen_position_m[2] == -letter.settings["screen_distance_m"]
    assert letter.history[-1]["iteration"] == len(letter.history)
    assert letter.history[-1]["residual"] < letter.history[len(letter.history) // 2]["residual"]
    assert {"transport", "descent", "check"} == set(letter.timings_s)


def test_interrupted_search_returns_the_best_so_far():
    target = target_irradiance(letter_f(), SCENE, floor=0.3)

    def stop(state: Progress) -> None:
        if state.stage.startswith("descent") and state.iteration % 5 == 0:
            raise KeyboardInterrupt

    design = Designer(SCENE, options()).design(target, stop)
    assert design.stop_reason == "interrupted"
    assert 0 < design.counters["evaluations"] <= 5
    assert np.corrcoef(relative(design).ravel(), target.ravel())[0, 1] > 0.7


def test_plate_that_is_not_square():
    wide = SCENE.model_copy(update={"plate_size_m": (0.06, 0.04)})
    target = target_irradiance(disc(20, 44, 9), wide, floor=0.3, fit="stretch")
    design = Designer(wide, options()).design(target)
    spot, wanted = np.maximum(relative(design) - 1, 0), np.maximum(target - 1, 0)
    assert np.abs(centroid(spot) - centroid(wanted)).max() < 1


def test_screen_beside_the_plate_gets_the_picture_too():
    aside = SCENE.model_copy(update={"screen_position_m": (2e-3, -1e-3, -1e-6)})
    target = target_irradiance(disc(32, 32, 12), aside, floor=0.4)
    design = Designer(aside, options(screen_distance_m=0.2)).design(target)
    assert design.scene.screen_position_m == (2e-3, -1e-3, -0.2)
    assert design.figures["picture"]["psnr_dB"] > 17  # 17.7 to 18.8 by rounding and floor, after so few steps


def test_pixels_that_no_grid_divides():
    odd = SCENE.model_copy(update={"image_pixels": 51})
    target = target_irradiance(letter_f(), odd, floor=0.3)
    design = Designer(odd, options()).design(target)
    assert np.corrcoef(relative(design).ravel(), target.ravel())[0, 1] > 0.85


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        (np.ones((M, M + 1)), "shape"),
        (np.full((M, M), 2.0), "mean 2"),
        (np.where(disc(9, 9, 4) > 0, np.nan, 1.0), "not finite"),
        (1 - 3 * (disc(9, 9, 4) - disc(9, 9, 4).mean()), "negative"),
    ],
)
def test_what_is_no_target_is_refused(target, reason):
    with pytest.raises(InputError, match=reason):
        Designer(SCENE, options()).design(target)


def test_light_that_is_not_collimated_is_refused():
    with pytest.raises(InputError, match="collimated"):
        Designer(SCENE.model_copy(update={"emission_half_angle_rad": 0.1}))
