"""What noise leaves to be known: against textbook cases, drawn noise, and plates with known trade-offs."""

import numpy as np
import pytest
import torch

from warp_caustics.camera.config import CameraConfig
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.setup.information import (
    conditional_deviations,
    correlations,
    covariance,
    directions,
    fisher_information,
    marginal_deviations,
    with_priors,
    without,
)
from warp_caustics.setup.knowledge import HEIGHTS, knowledge
from warp_caustics.setup.model import SetUpModel
from warp_caustics.setup.set_up import SetUp
from warp_caustics.setup.trades import partners
from warp_caustics.setup.unknown_heights import smooth_heights

from .conftest import bump

SCENE = Scene(height_samples=16, image_pixels=32, screen_position_m=(0, 0, -2e-3), lamp_half_angle_rad=0.01)


def line_fit(count=50, sigma=0.3):
    """Derivatives of a x + b at points from 1 to 2, [2, count], and their noise."""
    x = torch.linspace(1, 2, count, dtype=torch.float64)
    return torch.stack((x, torch.ones_like(x))), sigma, x


def test_a_straight_line_has_the_textbooks_deviations():
    """sigma / sqrt(sum (x - mean)^2) for the slope, sigma / sqrt(sum x^2) while the offset is known."""
    jacobian, sigma, x = line_fit()
    information = fisher_information(jacobian, sigma)
    spread = (x - x.mean()).square().sum()
    assert float(marginal_deviations(information)[0]) == pytest.approx(float(sigma / spread.sqrt()), rel=1e-12)
    assert float(conditional_deviations(information)[0]) == pytest.approx(float(sigma / x.norm()), rel=1e-12)
    expected = -float(x.mean() / x.square().mean().sqrt())
    assert float(correlations(information)[0, 1]) == pytest.approx(expected, rel=1e-10)
    torch.testing.assert_close(covariance(information), torch.linalg.inv(information), rtol=1e-9, atol=0)


def test_noise_may_differ_between_pixels():
    jacobian, _, x = line_fit()
    torch.testing.assert_close(
        fisher_information(jacobian, 0.1 * x), fisher_information(jacobian / (0.1 * x), 1.0), rtol=1e-12, atol=0
    )


def test_an_estimate_scatters_as_the_bound_says():
    """2,000 noisy images of a bump: least squares for gap, base and gain scatter as their marginal deviations.

    The scatter of 2,000 estimates is known to 1.6 %; four times that is allowed, and bounds apart differ by more.
    """
    setup = SetUp.of(SCENE, CameraConfig(psf_px=0.5), ["gap_m", "base_thickness_m", "gain.1"])
    model, heights, noise = SetUpModel(setup), bump(16, height_m=1e-3), 1e-4
    jacobian = model.jacobian(heights)
    bound = marginal_deviations(fisher_information(jacobian, noise))
    alone = conditional_deviations(fisher_information(jacobian, noise))
    assert float((bound / alone).max()) > 1.2
    # The image moves with theta, not its tangent: a true set-up one bound away, exactly simulated.
    truth = setup.nominal + bound
    image = model.image(heights, truth) - model.image(heights)
    generator = torch.Generator().manual_seed(0)
    drawn = noise * torch.randn(2000, image.numel(), generator=generator, dtype=torch.float64)
    flat = jacobian.flatten(1)
    estimates = (image.reshape(1, -1) + drawn) @ torch.linalg.pinv(flat)
    np.testing.assert_allclose((estimates.std(0) / bound).numpy(), 1.0, atol=0.065)
    np.testing.assert_allclose(((estimates.mean(0) - (truth - setup.nominal)) / bound).numpy(), 0.0, atol=0.12)


def test_priors_and_images_together_scatter_as_the_bound_says():
    """Truths drawn from the prior and the estimate of least risk: errors as the van Trees bound says, which both need."""
    jacobian, _, _ = line_fit(5, 0.3)
    priors = torch.tensor([0.2, 0.5], dtype=torch.float64)
    information = fisher_information(jacobian, 0.3)
    both = with_priors(information, priors)
    generator = torch.Generator().manual_seed(1)
    truth = priors * torch.randn(20_000, 2, generator=generator, dtype=torch.float64)
    data = truth @ jacobian + 0.3 * torch.randn(20_000, 5, generator=generator, dtype=torch.float64)
    estimate = data @ (jacobian.T / 0.3**2) @ torch.linalg.inv(both)
    np.testing.assert_allclose((estimate - truth).std(0) / marginal_deviations(both), 1.0, atol=0.02)
    assert bool((marginal_deviations(both) < priors).all())
    assert bool((marginal_deviations(both) < marginal_deviations(information)).all())


def test_what_an_image_does_not_show_is_infinitely_uncertain():
    """Two numbers that do the same, one that does nothing, and one that is told."""
    x = torch.linspace(0, 1, 20, dtype=torch.float64)
    jacobian = torch.stack((x, 3 * x, torch.zeros_like(x), x**2))
    information = fisher_information(jacobian, 0.1)
    marginal = marginal_deviations(information)
    assert torch.isinf(marginal[:3]).all() and torch.isfinite(marginal[3])
    assert torch.isinf(conditional_deviations(information)[2])
    known = marginal_deviations(with_priors(information, torch.ones(4, dtype=torch.float64)))
    assert torch.isfinite(known).all() and float(known[2]) == pytest.approx(1.0, rel=1e-14)
    kept = marginal_deviations(fisher_information(jacobian[[0, 3]], 0.1))
    assert float(marginal[3]) == pytest.approx(float(kept[1]), rel=1e-6)


def test_nuisance_parameters_leave_what_they_leave_in_the_whole():
    jacobian = torch.randn(6, 40, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    information = fisher_information(jacobian, 0.5)
    nuisance = torch.tensor([False, True, False, True, True, False])
    left = without(information, nuisance)
    whole = covariance(information)[~nuisance][:, ~nuisance]
    torch.testing.assert_close(covariance(left), whole, rtol=1e-9, atol=1e-12)
    assert torch.equal(without(information, torch.zeros(6, dtype=torch.bool)), information)
    with pytest.raises(InputError, match="nuisance parameters are not determined"):
        without(torch.zeros(2, 2, dtype=torch.float64), torch.tensor([True, False]))


def test_directions_are_sorted_by_what_is_left():
    """A sum that is told ten times better than its prior, and a difference that is not told."""
    jacobian = torch.tensor([[1.0], [2.0]], dtype=torch.float64)
    priors = torch.tensor([1.0, 0.5], dtype=torch.float64)
    best, worst = directions(fisher_information(jacobian, 0.1), priors)
    assert best.remaining == pytest.approx((1 + 2 * 100) ** -0.5)
    torch.testing.assert_close(best.weights, torch.tensor([0.5, 0.5], dtype=torch.float64).sqrt())
    assert worst.remaining == 1 and float(worst.weights.sum()) == pytest.approx(0, abs=1e-12)


def test_partners_are_those_that_would_tell():
    """a + b + c is measured: of a, both others have to be known; d is told alone."""
    generator = torch.Generator().manual_seed(3)
    x, noise = torch.randn(2, 50, generator=generator, dtype=torch.float64), 1e-3
    jacobian = torch.stack((x[0], x[0], x[0], x[1]))
    information = with_priors(fisher_information(jacobian, noise), torch.ones(4, dtype=torch.float64))
    assert {i for i, _ in partners(information, 0)} == {1, 2}
    assert all(value < -0.3 for _, value in partners(information, 0))
    assert partners(information, 3) == []


@pytest.fixture(scope="module")
def told():
    """What images of a bump tell, with heights known and unknown, without the plate's border."""
    camera = CameraConfig(psf_px=0.5)
    setup = SetUp.of(SCENE, camera, ("screen_x_m", *SetUp.of(SCENE, camera).names))
    model, heights = SetUpModel(setup), bump(16, height_m=1e-3)
    jacobian = model.derivatives(heights)
    inner = (..., slice(4, -4), slice(4, -4))
    jacobian = jacobian._replace(values=jacobian.values[inner])
    smooth = smooth_heights(SCENE, 4)
    columns = model.by_heights(heights, smooth.modes)[inner]
    known = knowledge(setup, jacobian, 3e-4)
    return known, knowledge(setup, jacobian, 3e-4, smooth, columns)


def by_name(found):
    return {known.parameter.name: known for known in found.parameters}


def test_known_trade_offs_are_found(told):
    """Index, base and gap against height, shift of the camera against that of the screen; the blur is fixed."""
    known, unknown = (by_name(found) for found in told)
    for name in ("index_offset", "base_thickness_m", "gap_m"):
        assert HEIGHTS in dict(unknown[name].trades), name
        assert HEIGHTS not in dict(known[name].trades)
    assert dict(known["shift_x_px"].trades)["screen_x_m"] > 0.9
    assert all(unknown[f"psf_px.{c}"].verdict == "fixed" for c in range(3))
    assert not unknown["psf_px.1"].trades


@pytest.mark.parametrize("size", [0.0, 0.004])
def test_at_zero_only_the_square_counts(size):
    """The image changes by the square of the lamp's size and of the blur; a derivative at 0 says nothing, and is told so."""
    scene = SCENE.model_copy(update={"lamp_half_angle_rad": size})
    setup = SetUp.of(scene, CameraConfig(psf_px=100 * size), free=["lamp_half_angle_rad", "psf_px", "gap_m"])
    assert {p.name for p in setup.parameters if p.is_squared} == set(setup.names) - {"gap_m"}
    model, heights = SetUpModel(setup), bump(SCENE.height_samples)
    found = {known.parameter.name: known for known in knowledge(setup, model.derivatives(heights), 1e-3).parameters}
    squared = {name for name, known in found.items() if known.verdict == "only its square"}
    assert squared == (set() if size else set(setup.names) - {"gap_m"})
    if not size:
        at, large, small = (setup.nominal.clone() for _ in range(3))
        number = setup.names.index("lamp_half_angle_rad")
        large[number], small[number] = 2e-3, 1e-3
        plain = model.image(heights, at)
        ratio = (model.image(heights, large) - plain).norm() / (model.image(heights, small) - plain).norm()
        assert float(ratio) == pytest.approx(4, rel=0.05)
        assert found["lamp_half_angle_rad"].alone > 100 * found["lamp_half_angle_rad"].parameter.prior


def test_knowledge_is_ordered(told):
    """Knowing all else is at least as good as knowing it by its priors, and that as not knowing heights."""
    for found in told:
        for known in found.parameters:
            assert known.together <= known.with_heights * (1 + 1e-9) <= known.parameter.prior * (1 + 1e-6)
            assert min(known.alone, known.parameter.prior) <= known.together * 2**0.5
    known, unknown = (by_name(found) for found in told)
    assert all(known[name].with_heights == pytest.approx(known[name].together) for name in known)
    assert any(unknown[name].with_heights > 1.2 * unknown[name].together for name in unknown)
    remaining = [direction.remaining for direction in told[0].directions]
    assert remaining == sorted(remaining) and len(remaining) == len(known)


@pytest.mark.parametrize("noise", [0.0, -1.0, float("nan"), float("inf"), torch.tensor([0.1, 0.0] * 25)])
def test_no_noise_is_no_noise_model(noise):
    jacobian, _, _ = line_fit()
    with pytest.raises(InputError, match="is not above 0 and finite: .* give the camera's, for example 0.01"):
        fisher_information(jacobian, noise)


def test_other_input_that_tells_nothing_is_refused():
    jacobian, _, _ = line_fit()
    with pytest.raises(InputError, match=r"noise has shape \[3\], an image \[50\]"):
        fisher_information(jacobian, torch.ones(3))
    with pytest.raises(InputError, match="derivatives are not finite"):
        fisher_information(jacobian * torch.nan, 0.1)
    with pytest.raises(InputError, match="prior width 0 is not above 0"):
        with_priors(torch.eye(2, dtype=torch.float64), torch.zeros(2))
    setup = SetUp.of(SCENE, free=["gap_m"])
    found = SetUpModel(setup).derivatives(bump(16))
    with pytest.raises(InputError, match="unknown heights and their derivatives belong together"):
        knowledge(setup, found, 0.01, smooth_heights(SCENE, 2))
