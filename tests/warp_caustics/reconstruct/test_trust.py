"""One line on how far a result is to be believed."""

import dataclasses

import numpy as np
import pytest
import torch

from warp_caustics.fold_fraction import fold_fraction
from warp_caustics.inspection.compare import inspect_plate
from warp_caustics.inspection.judge import doubted
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.image_noise import estimated_noise
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.refine.refine import Refine
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.trust import Seen, image_trust
from warp_caustics.resampling import blur_matrices, blurred
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

SCENE = Scene(height_samples=64, image_pixels=128, screen_position_m=(0, 0, -1e-6))
LINES = [Line((-0.02, -0.015), (0.02, -0.01), 4e-3, 3e-4), Line((-0.015, 0.018), (0.01, 0.01), 6e-3, 4e-4)]
SMALL = Line((0.012, 0.008), (0.018, 0.016), 3e-3, 1.5e-4)


def relief(*lines):
    return line_relief(lines, 64, SCENE.plate_size_m)


def light(heights, blur_px=0.0):
    simulator = CausticSimulator(SCENE, "lattice", n_photons=64 * 128**2)
    image = simulator(torch.tensor(heights, dtype=torch.float32))
    if blur_px:
        image = blurred(image, blur_matrices(128, np.full(3, blur_px), image.device))
    return image.numpy()


def trust(clean, heights, noise=0.0, known=True, mask=None, found_at=None):
    rng = np.random.default_rng(0)
    noisy = clean + noise * np.sqrt(np.maximum(clean, 0.05)) * rng.standard_normal(clean.shape)
    image = CausticImage(noisy.astype(np.float32), np.full(3, noise) if known and noise else None, mask)
    return Resimulation(CausticSimulator(SCENE), image).trust(heights, found_at)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1, 0.3])
@pytest.mark.parametrize("known", [True, False])
def test_the_truth_is_explained_whatever_the_noise(noise, known):
    """0.3 of noise leaves almost 30 % of the image, which no fixed percentage would call explained."""
    heights = relief(*LINES)
    found = trust(light(heights), heights, noise, known)
    assert found.is_explained and not found.is_beyond_relief and found.places == 0
    assert found.line.startswith("explained within noise: ")
    assert found.left == pytest.approx(np.hypot(found.noise, found.simulation), rel=0.5, abs=0.005)
    assert found.noise_source == ("given" if known and noise else "estimated")


def test_what_a_flat_plate_explains_as_well_is_not_believed():
    found = trust(light(relief(*LINES)), relief(), 0.02)
    assert found.is_explained is False and found.is_beyond_relief
    assert "heights may be wrong by more than the relief" in found.line
    assert found.left == pytest.approx(found.flat, rel=0.01)


def test_a_small_line_that_is_missing_does_not_drown_in_the_noise_of_the_rest():
    heights = relief(*LINES)
    found = trust(light(relief(*LINES, SMALL)), heights, 0.05)
    assert found.is_explained is False and 0 < found.places < 0.1 and not found.is_beyond_relief
    assert found.line.startswith(f"explained but for {100 * found.places:.2g} % of its area: ")


def test_what_errs_by_a_little_is_explained_in_part():
    found = trust(light(relief(*LINES)), 0.75 * relief(*LINES), 0.005)
    assert found.is_explained is False and not found.is_beyond_relief
    assert found.line.startswith("explained in part: ") and "a flat plate" in found.line


def fine_ripple():
    """A ripple of two samples, 1.5 um high, of which 32 pixels hardly tell [m], shape [64, 64]."""
    sign = (-1.0) ** np.arange(64)
    return 1.5e-6 * sign[:, None] * sign


def test_what_was_found_on_a_coarse_image_is_judged_there():
    """By means over its pixels, with their noise and the coarse simulation's error."""
    heights = relief(*LINES)
    clean = light(heights)
    whole, coarse = (trust(clean, heights, 0.05, found_at=pixels) for pixels in (128, 64))
    assert whole.pixels is None and whole == trust(clean, heights, 0.05)
    assert coarse.pixels == 64 and " of the image left at 64 of 128 pixels, noise and simulation leave " in coarse.line
    assert coarse.is_explained and coarse.noise == pytest.approx(whole.noise / 2, rel=0.1)
    assert coarse.simulation != whole.simulation
    # What noise and simulation leave of all pixels, where finer ones had no say, is told beside it.
    assert (
        (coarse.left_at_all, coarse.floor_at_all)
        == (whole.left, whole.floor)
        == (whole.left_at_all, whole.floor_at_all)
    )


@pytest.mark.parametrize("found_at", [None, 64, 32, 4])
def test_no_heights_escape_by_the_pixels_they_were_found_with(found_at):
    """32 pixels do not tell of the ripple; heights that were found with so few are judged with as many as there are."""
    found = trust(light(relief(*LINES)), relief(*LINES) + fine_ripple(), 0.01, found_at=found_at)
    assert found.is_explained is False and found.pixels == (None if found_at is None else 64)


@pytest.mark.parametrize(
    ("found", "begins"),
    [
        (relief(), "not explained: "),
        (0.7 * relief(*LINES), "explained in part: "),
        (relief(LINES[0]), ("not explained: ", "explained in part: ")),
    ],
    ids=["flat", "too low", "a line is missing"],
)
def test_a_coarse_image_tells_wrong_heights_as_well(found, begins):
    seen = trust(light(relief(*LINES)), found, 0.01, found_at=64)
    assert seen.is_explained is False and seen.line.startswith(begins)


def test_a_coarse_image_is_seen_through_the_camera_too():
    heights = relief(*LINES)
    found = trust(light(heights, 0.7), heights, 0.01, found_at=64)
    assert found.is_explained and found.pixels == 64 and found.line.startswith("explained within noise")


def test_a_blur_that_no_model_knows_is_named_and_the_truth_stays_believed():
    """A lens out of focus by 0.7 px leaves a large part of the image though the heights are right."""
    heights = relief(*LINES)
    found = trust(light(heights, 0.7), heights, 0.01)
    assert (
        found.is_explained and "by a camera (blur of 0.7" in found.line and "that the method leaves out" in found.line
    )


@pytest.mark.parametrize(("share", "is_told"), [(0.02, False), (0.04, True)])
def test_an_explained_image_whose_light_paths_cross_says_so(share, is_told):
    """Other reliefs may explain it too; one that is not explained has more to say."""
    measured = Measurement(torch.ones(3, 64, 64), torch.ones(3, 64, 64), torch.full((3, 64, 64), 0.01))
    right, wrong = (Seen(value * measured.irradiance, value * measured.irradiance) for value in (1.0, 1.1))
    assert (
        "light paths cross on 4 % of the plate" in image_trust(measured, right, "given", lambda: share).line
    ) == is_told
    assert "cross" not in image_trust(measured, wrong, "given", lambda: share).line


def test_folds_are_counted_on_the_plate_itself():
    """A line that focuses light before the screen."""
    far = SCENE.model_copy(update={"screen_position_m": (0, 0, -0.05)})
    heights = relief(*LINES)
    image = CausticSimulator(far, "lattice")(torch.tensor(heights, dtype=torch.float32)).numpy()
    found = Resimulation(CausticSimulator(far), CausticImage(image, np.full(3, 0.01))).trust(heights)
    crossing = fold_fraction(heights, far)
    assert crossing > 0.03 and found.is_explained
    assert f"light paths cross on {100 * crossing:.2g} % of the plate" in found.line


def test_masked_pixels_do_not_count():
    heights = relief(*LINES)
    clean, mask = light(heights), np.ones((3, 128, 128), bool)
    clean[:, 30:40, 30:40], mask[:, 30:40, 30:40] = 100.0, False
    assert trust(clean, heights, 0.02, mask=mask).is_explained


def test_an_image_without_noise_is_not_judged_by_noise_that_is_not_there():
    image = CausticImage(light(relief(*LINES)))
    assert 0 < estimated_noise(image, SCENE).max() < 0.05
    tiny = Scene(height_samples=4, image_pixels=6)
    assert estimated_noise(CausticImage(np.ones((3, 6, 6))), tiny) is None


def test_no_plate_passes_by_heights_that_are_not_believed():
    nominal = relief(*LINES)
    passed = inspect_plate(nominal, nominal, SCENE, 5e-5, sigma_m=np.full((64, 64), 2e-6))
    bad = trust(light(nominal), relief(), 0.02)
    good = dataclasses.replace(bad, is_beyond_relief=False)
    assert doubted(passed, bad).verdict == "uncertain" and "not explained" in doubted(passed, bad).reasons[0]
    assert doubted(passed, good) is passed and doubted(passed, None) is passed


def test_fewer_pixels_than_heights_do_not_judge_them():
    """A descent at 16 pixels explains those by heights that the image refutes."""
    fine = Scene(height_samples=32, image_pixels=128, screen_position_m=(0, 0, -1e-6))
    truth = line_relief(LINES, 32, fine.plate_size_m)
    clean = CausticSimulator(fine, "lattice", n_photons=16 * 128**2)(torch.tensor(truth, dtype=torch.float32)).numpy()
    image = CausticImage(clean, np.full(3, 0.003))
    options = {"finest_pixels": 16, "coarsest_pixels": 16, "max_iterations": 150, "metric": "height"}
    found = Refine(fine, RefineOptions(**options), "cpu").reconstruct(image)
    assert np.sqrt(np.mean((found.heights_m - truth) ** 2)) > 0.3 * np.sqrt(np.mean(truth**2))
    assert found.trust.is_explained is False and found.trust.pixels == 32
