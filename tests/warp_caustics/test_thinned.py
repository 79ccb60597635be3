"""Few light paths in place of many: what must be the same, mean, noise, gradient; and what is refused."""

import math

import pytest
import torch

from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.thinned import ThinnedSimulator, random_weight, stratified_noise

SCENE = Scene(height_samples=32, image_pixels=96, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,))
N, TRACED, S = 40_000, 10_000, 12.0


def bump() -> torch.Tensor:
    """A relief that folds nothing, shape [32, 32] [m]."""
    x = torch.linspace(-1, 1, 32)
    return 2e-4 * torch.exp(-6 * (x[:, None] ** 2 + x[None] ** 2))


def images(simulator: CausticSimulator | ThinnedSimulator, heights: torch.Tensor, count: int) -> torch.Tensor:
    """Of as many seeds, shape [count, 1, m, m] [W/m^2]."""
    found = []
    for seed in range(count):
        simulator.reseed(seed)
        found.append(simulator(heights))
    return torch.stack(found)


@pytest.fixture(scope="module")
def both() -> tuple[torch.Tensor, torch.Tensor]:
    """Images of the bump from all paths and from few, 48 seeds each."""
    full = CausticSimulator(SCENE, "paper", n_photons=N, smoothing=S)
    few = ThinnedSimulator(SCENE, n_photons=N, smoothing=S, traced=TRACED)
    return images(full, bump(), 48), images(few, bump(), 48)


def test_the_mean_is_that_of_all_paths(both: tuple[torch.Tensor, torch.Tensor]) -> None:
    full, few = both
    spread = full.std(dim=0).square().mean().sqrt()
    difference = (full.mean(dim=0) - few.mean(dim=0)).square().mean().sqrt()
    # Two means of 48 differ by sqrt(2 / 48) of one image's noise.
    assert float(difference / spread) < 1.25 * math.sqrt(2 / 48)


def test_the_noise_is_that_of_all_paths(both: tuple[torch.Tensor, torch.Tensor]) -> None:
    full, few = (images.std(dim=0).square().mean().sqrt() for images in both)
    assert float(few / full) == pytest.approx(1, abs=0.05)


def test_noise_goes_as_far_as_that_of_all_paths(both: tuple[torch.Tensor, torch.Tensor]) -> None:
    def correlation(images: torch.Tensor) -> float:
        noise = images - images.mean(dim=0)
        return float((noise[..., 2:] * noise[..., :-2]).mean() / noise.square().mean())

    full, few = map(correlation, both)
    assert full > 0.4
    assert few == pytest.approx(full, abs=0.12)  # a quarter of the paths: a little finer


def test_energy_is_that_of_all_paths(both: tuple[torch.Tensor, torch.Tensor]) -> None:
    full, few = (float(images.mean()) for images in both)
    assert few == pytest.approx(full, rel=2e-3)


def test_the_gradient_is_that_of_its_image() -> None:
    few = ThinnedSimulator(SCENE, n_photons=N, smoothing=S, traced=TRACED)
    weight = torch.linspace(-1, 1, 96)[None, :, None]
    heights = bump().requires_grad_()
    (few(heights) * weight).sum().backward()
    assert heights.grad is not None
    way = torch.zeros_like(bump())
    way[9, 20] = 1.0
    step = 2e-6
    with torch.no_grad():
        change = ((few(bump() + step * way) - few(bump() - step * way)).double() * weight).sum() / (2 * step)
    assert float(heights.grad[9, 20]) == pytest.approx(float(change), rel=0.02)


def test_seeds_are_other_paths_and_the_same_again() -> None:
    few = ThinnedSimulator(SCENE, n_photons=N, smoothing=S, traced=TRACED, seed=3)
    first = few(bump())
    few.reseed(4)
    other = few(bump())
    few.reseed(3)
    assert not torch.equal(first, other)
    assert torch.equal(first, few(bump()))


def test_noise_of_stratified_paths_is_the_measured_one() -> None:
    sets = [
        CausticSimulator(SCENE, "paper", n_photons=2500, smoothing=6.0, placement=placement)
        for placement in ("stratified", "random")
    ]
    inside = slice(20, 76)
    one, all_random = (images(each, torch.zeros(32, 32), 48)[..., inside, inside].var(dim=0).mean() for each in sets)
    assert float(one / all_random) == pytest.approx(stratified_noise(6.0), rel=0.15)


def test_weights_add_up_to_the_wanted_variance() -> None:
    a = random_weight(N, 6667, 3333, S)
    first = stratified_noise(S * math.sqrt(6667 / N)) / 6667
    assert (1 - a) ** 2 * first + a**2 / 3333 == pytest.approx(1 / N)
    assert 0 < a < 1


@pytest.mark.parametrize(
    ("traced", "said"), [(N, "is not between 2"), (1, "is not between 2"), (40, "have more noise")]
)
def test_refused(traced: int, said: str) -> None:
    with pytest.raises(InputError, match=said):
        ThinnedSimulator(SCENE, n_photons=N, smoothing=S, traced=traced)


@pytest.mark.parametrize(("n", "smoothing"), [(10_000, 4.0), (10_000, 2.0), (400, 16.0), (1_000_000, 16.0)])
def test_what_is_offered_to_trace_is_enough(n: int, smoothing: float) -> None:
    """As many as the message says are not refused again, and a third fewer are."""
    with pytest.raises(InputError, match="trace more, such as") as refused:
        ThinnedSimulator(Scene(), traced=20, n_photons=n, smoothing=smoothing)
    offered = int(str(refused.value).rsplit(" ", 1)[1])
    weight = ThinnedSimulator(Scene(), traced=offered, n_photons=n, smoothing=smoothing).weight
    assert 0 < weight < 1
    with pytest.raises(InputError, match="more noise"):
        ThinnedSimulator(Scene(), traced=2 * offered // 3, n_photons=n, smoothing=smoothing)


def test_where_no_number_is_enough_all_are_to_be_traced() -> None:
    with pytest.raises(InputError, match="leave it out to trace all"):
        ThinnedSimulator(Scene(), traced=900, n_photons=1000, smoothing=1.0)
