"""Light inside the glass that meets the relief again: who meets it, what becomes of it, and what a gradient sees."""

import math

import numpy as np
import pytest
import torch
import warp as wp

from warp_caustics import CausticSimulator, Scene
from warp_caustics.energy import check_reaches, energy_budget
from warp_caustics.errors import InputError
from warp_caustics.height_field import cell_centres
from warp_caustics.kernels.trace import FATE_NAMES
from warp_caustics.oracle import meets_again, oracle_image, spline_coefficients
from warp_caustics.tape import simulate_on_tape

GREEN = {"wavelengths_m": (530e-9,), "radiosity_W_m2": (1.0,)}
SCENE = Scene(
    **GREEN, height_samples=24, image_pixels=20, plate_size_m=(0.01, 0.01), exit_medium="glass", second_hits="lost"
)
POINT = SCENE.model_copy(update={"light_position_m": (1e-3, 0.0, 0.05), "emission_half_angle_rad": 0.3})
TILTED = SCENE.model_copy(update={"light_tilt_rad": (0.2, -0.1), "fresnel": True})


def double(scene, **kwargs):
    return CausticSimulator(scene, dtype=torch.float64, **kwargs)


def ridges(seed=0, n=24, height=2.5e-3):
    """Narrow hills of one sample and three, steep enough for light to leave through their other flanks."""
    generator = torch.Generator().manual_seed(seed)
    rough = torch.rand(1, 1, n, n, generator=generator, dtype=torch.float64)
    return (rough > 0.8).double()[0, 0] * height * rough[0, 0]


def clear_of(simulator, heights):
    engine = simulator.engine
    ((_, positions),) = engine.chunks(1)
    clear = engine.clear_paths(engine.coefficients(heights[None]), engine.photons(positions))
    return clear[0].bool(), positions


@pytest.mark.parametrize("scene", [SCENE, POINT, TILTED], ids=["collimated", "point", "tilted"])
def test_paths_are_those_of_a_dense_search(scene):
    """Against 1500 looks along each path: the same paths, and not few."""
    heights = ridges()
    clear, positions = clear_of(double(scene, placement="random", n_photons=64), heights)
    coefficients = spline_coefficients(heights)
    expected = [
        ~torch.vmap(lambda p, c=c: meets_again(p, coefficients, scene, c), chunk_size=8)(positions) for c in range(1)
    ]
    expected = torch.stack(expected)
    assert 0.02 < float((~expected).double().mean()) < 0.5
    assert torch.equal(clear, expected)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_ridge_loses_its_upper_flanks(axis):
    """A ridge three times as high as it is wide: by Snell's law in its plane, light from high on one flank leaves by the other."""
    scene = SCENE.model_copy(update={"height_samples": 64})
    x = cell_centres(64, 0.01)
    width, height = 0.7e-3, 2.5e-3
    section = height * np.exp(-((x / width) ** 2) * 4)
    heights = np.broadcast_to(section, (64, 64)).copy()
    simulator = double(scene, placement="random", n_photons=4000)
    clear, positions = clear_of(simulator, torch.from_numpy(heights if axis == 0 else heights.T.copy()))
    start = positions[:, axis].numpy()

    def surface(u):
        return height * np.exp(-((u / width) ** 2) * 4)

    def slope(u):
        return surface(u) * -8 * u / width**2

    for channel, index in enumerate(scene.glass_indices):
        theta = np.arctan(-slope(start))  # of the normal, away from the axis on the right
        bent = theta - np.arcsin(np.sin(theta) / index)  # towards the axis
        depth = np.linspace(1e-6, height, 3000)
        side = start[:, None] - np.tan(bent)[:, None] * depth
        leaves = (surface(side) < surface(start)[:, None] - depth).any(1)
        differs = leaves == clear[channel].numpy()
        # The spline is not quite the Gaussian: paths that graze may go either way.
        assert differs.mean() < 0.01
        assert 0.02 < leaves.mean() < 0.3
        assert np.abs(start[leaves]).max() < width


def test_gentle_relief_meets_nothing():
    """Slopes to 0.3: every path is clear, the image the same to the last bit."""
    heights = 1e-4 * ridges() / 2.5e-3
    lost = double(SCENE)
    assert clear_of(lost, heights)[0].all()
    ignored = double(SCENE.model_copy(update={"second_hits": "ignored"}))
    assert torch.equal(lost(heights), ignored(heights))
    assert energy_budget(lost, heights)["met_again"] == [0.0]


@pytest.mark.parametrize(
    ("scene", "placement"),
    # Where photons start is read in one place, which does not know what light falls there.
    [(SCENE, "lattice"), (SCENE, "random"), (POINT, "random"), (TILTED, "random")],
    ids=["collimated lattice", "collimated", "point", "tilted"],
)
def test_image_and_gradient_match_the_oracle_and_differences(scene, placement):
    """Lost paths weigh nothing; the others are differentiated as ever. Tape and torch agree."""
    heights = ridges()
    simulator = double(scene, placement=placement, n_photons=10**2, smoothing=4.0, profile="gaussian")
    weights = torch.randn(1, 20, 20, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    leaf = heights.clone().requires_grad_()
    image = simulator(leaf)
    (image * weights).sum().backward()
    ((_, positions),) = simulator.engine.chunks(1)
    other = heights.clone().requires_grad_()
    expected = oracle_image(other, scene, positions, simulator.smoothing, "gaussian")
    (expected * weights).sum().backward()
    torch.testing.assert_close(image, expected, rtol=0, atol=1e-8 * float(expected.abs().max()))
    torch.testing.assert_close(leaf.grad, other.grad, rtol=0, atol=1e-7 * float(other.grad.abs().max()))
    assert float(double(scene.model_copy(update={"second_hits": "ignored"}))(heights).sum()) > 1.02 * float(image.sum())

    direction = torch.randn(24, 24, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    step = 1e-10
    ends = [(simulator(heights + sign * step * direction) * weights).sum() for sign in (1, -1)]
    numeric = float(ends[0] - ends[1]) / (2 * step)
    assert float((leaf.grad * direction).sum()) == pytest.approx(numeric, rel=1e-4)

    on_tape = wp.array(heights[None].numpy(), dtype=wp.float64, device="cpu", requires_grad=True)
    tape = wp.Tape()
    with tape:
        recorded = simulate_on_tape(tape, simulator, on_tape)
    tape.backward(grads={recorded: wp.array(weights[None].numpy(), dtype=wp.float64, device="cpu")})
    np.testing.assert_allclose(recorded.numpy()[0], image.detach().numpy(), atol=1e-12 * float(image.max()))
    np.testing.assert_allclose(on_tape.grad.numpy()[0], leaf.grad.numpy(), atol=1e-12 * float(leaf.grad.abs().max()))


@pytest.mark.parametrize("light", [SCENE, POINT, TILTED], ids=["collimated", "point", "tilted"])
def test_the_budget_says_what_became_of_it(light):
    """Lost: a fate of its own, all together 1 to 1e-12. Let through: told beside the sum, and as much light as ever."""
    heights = ridges()
    budgets = {}
    for how in ("lost", "passed", "ignored"):
        scene = light.model_copy(update={"second_hits": how})
        budgets[how] = energy_budget(double(scene, placement="random", n_photons=5000), heights)
    lost, passed, ignored = budgets.values()
    assert "met_again" not in ignored
    reflected = "fresnel" in lost
    names = [name for name in FATE_NAMES if name != "unlit"] + ["fresnel"] * reflected
    for channel in range(1):
        total = sum(lost[name][channel] for name in names) + lost["met_again"][channel]
        assert total == pytest.approx(1.0, abs=1e-12)
        assert 0.01 < lost["met_again"][channel] < 0.5
        if reflected:  # what the faces reflect of lost light counts as lost
            assert 0.7 * lost["met_again"][channel] < passed["met_again"][channel] < lost["met_again"][channel]
        else:
            assert passed["met_again"][channel] == pytest.approx(lost["met_again"][channel], rel=1e-9)
        assert passed["landed"] == ignored["landed"]
        assert lost["landed"][channel] < ignored["landed"][channel]


def test_lost_light_is_not_in_the_image():
    """The image holds what landed, to 1e-9: hills in the middle under a cone, so that no footprint leaves the window."""
    relief = torch.zeros(24, 24, dtype=torch.float64)
    relief[10:14, 10:14] = ridges()[10:14, 10:14]
    relief[12, 12] = 2.5e-3
    scene = POINT.model_copy(update={"emission_half_angle_rad": 0.06, "image_pixels": 100, "fresnel": True})
    simulator = double(scene, placement="stratified", n_photons=150**2)
    image = simulator(relief)
    budget = energy_budget(simulator, relief, image)
    held = image.sum(dim=(1, 2)).numpy() * scene.pixel_size_m[0] * scene.pixel_size_m[1]
    np.testing.assert_allclose(held, np.array(budget["landed"]) * budget["emitted_W"], rtol=1e-9)
    assert min(budget["met_again"]) > 1e-3


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_batches_chunks_and_precisions_agree(dtype, monkeypatch):
    """A batch is its members; float32 finds the paths that float64 finds but for a few that graze."""
    stack = torch.stack([ridges(seed) for seed in range(3)]).to(dtype)
    simulator = CausticSimulator(SCENE, dtype=dtype)
    images = simulator(stack)
    for image, heights in zip(images, stack, strict=True):
        torch.testing.assert_close(
            image, simulator(heights), rtol=0, atol=20 * torch.finfo(dtype).eps * float(image.max())
        )
    exact = double(SCENE)(stack.double())
    assert float((images - exact).norm()) < 5e-3 * float(exact.norm())


def test_what_is_told_where_all_is_lost():
    """The message of a black image counts light that met the relief again."""
    budget = {name: [0.0] for name in FATE_NAMES} | {"met_again": [0.97]}
    with pytest.raises(InputError, match="97 % met again"):
        check_reaches(budget)
    assert math.isfinite(sum(budget["met_again"]))
