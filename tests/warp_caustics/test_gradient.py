"""The gradient: finite differences, oracle, tape, torch, precision, batches."""

import numpy as np
import pytest
import torch
import warp as wp

from warp_caustics import CausticSimulator, Scene
from warp_caustics.chunked import CHUNK_BYTES
from warp_caustics.oracle import oracle_image
from warp_caustics.tape import simulate_on_tape

SCENES = {
    "contact": Scene(height_samples=10, image_pixels=20, exit_medium="glass"),
    "air_near": Scene(height_samples=10, image_pixels=20),
    "air_far": Scene(height_samples=10, image_pixels=20, screen_position_m=(1e-3, -2e-3, -0.02)),
    "point": Scene(
        height_samples=10,
        image_pixels=20,
        plate_size_m=(0.05, 0.04),
        light_position_m=(4e-3, 2e-3, 0.1),
        emission_half_angle_rad=0.9,
        screen_position_m=(0, 0, -5e-3),
    ),
}
EFFECTS = {"fresnel": True, "lamp_half_angle_rad": 0.15, "second_hits": "lost"}
POINT_EFFECTS = {"fresnel": True, "lamp_radius_m": 0.015, "second_hits": "lost"}
TILT = {"light_tilt_rad": (0.1, -0.05)}
SCENES |= {
    **{f"{name}, all effects": SCENES[name].model_copy(update=EFFECTS) for name in ("contact", "air_near", "air_far")},
    "point, all effects": SCENES["point"].model_copy(update=POINT_EFFECTS),
    "tilted": SCENES["contact"].model_copy(update=TILT),
    "tilted air_far, all effects": SCENES["air_far"].model_copy(update=EFFECTS | TILT),
}
PLACEMENTS = ["lattice", "stratified", "sobol", "random"]


def bumpy_heights(n=10, seed=0, amplitude=2e-4):
    """A relief with slopes to about 0.2: folds a far caustic, loses no light to total reflection."""
    generator = torch.Generator().manual_seed(seed)
    return amplitude * torch.randn(n, n, generator=generator, dtype=torch.float64).abs()


def relief_of(name):
    """Steeper where effects depend on the slopes: without their part the gradient would be wrong by a hundredth."""
    return bumpy_heights(amplitude=6e-4 if name.endswith("effects") else 2e-4)


def random_image(scene, seed=1):
    generator = torch.Generator().manual_seed(seed)
    shape = scene.n_wavelengths, scene.image_pixels, scene.image_pixels
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def make(scene, placement="lattice", n_photons=900, smoothing=6.0, **kwargs):
    kwargs.setdefault("dtype", torch.float64)
    return CausticSimulator(scene, placement=placement, n_photons=n_photons, smoothing=smoothing, **kwargs)


def gradient(simulator, heights, weights):
    leaf = heights.clone().requires_grad_()
    image = simulator(leaf)
    (image * weights).sum().backward()
    return image.detach(), leaf.grad


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(("placement", "profile"), [("lattice", "spline"), ("random", "gaussian")])
def test_gradient_matches_central_differences(name, placement, profile):
    """Along 32 random directions, to 1e-5 relative."""
    scene, heights = SCENES[name], relief_of(name)
    simulator, weights = make(scene, placement, profile=profile), random_image(scene)
    _, grad = gradient(simulator, heights, weights)
    generator = torch.Generator().manual_seed(2)
    analytic, numeric = [], []
    step = 1e-9
    for _ in range(32):
        direction = torch.randn(10, 10, generator=generator, dtype=torch.float64)
        plus, minus = (simulator(heights + sign * step * direction) for sign in (1, -1))
        numeric.append(float(((plus - minus) * weights).sum()) / (2 * step))
        analytic.append(float((grad * direction).sum()))
    analytic, numeric = np.array(analytic), np.array(numeric)
    assert np.abs(analytic - numeric).max() <= 1e-5 * np.abs(numeric).max()


PLAIN = ("contact", "air_near", "air_far")
"""Scenes of one kernel, that without any effect."""

PROFILES = {"lattice": "spline"}
"""Of placements; ``gaussian`` elsewhere. Every other pair is a kernel of its own, to be compiled."""

ALONE = [name for name in SCENES if not name.endswith("effects")]
TOGETHER = [name for name in SCENES if name.endswith("effects")]


@pytest.mark.parametrize(
    ("name", "placement", "profile"),
    # No part of a kernel knows both where photons start or how they are spread, and which light there is: every
    # placement with every profile in plain scenes alone, every light with all placements.
    [(name, placement, profile) for name in PLAIN for placement in PLACEMENTS for profile in ("gaussian", "spline")]
    + [(name, "lattice", "spline") for name in ALONE if name not in PLAIN]
    + [(name, placement, "gaussian") for name in ALONE if name not in PLAIN for placement in PLACEMENTS[1:]]
    # The oracle looks for second hits at many points of every path, which takes seconds: the kernels of the
    # differences above.
    + [(name, *way) for name in TOGETHER for way in (("lattice", "spline"), ("random", "gaussian"))],
)
def test_image_and_gradient_match_the_oracle(name, placement, profile):
    """Torch route against the float64 oracle, to 1e-8 of the largest value."""
    scene, heights = SCENES[name], relief_of(name)
    n_photons = 25 if name in TOGETHER else 450
    simulator, weights = make(scene, placement, n_photons=n_photons, profile=profile), random_image(scene)
    image, grad = gradient(simulator, heights, weights)
    ((_, positions),) = simulator.engine.chunks(1)
    leaf = heights.clone().requires_grad_()
    is_squeezed = placement == "lattice" and len(positions) >= scene.image_pixels**2
    expected = oracle_image(leaf, scene, positions, simulator.smoothing, simulator.profile, is_squeezed)
    (expected * weights).sum().backward()
    assert_close(image, expected.detach(), 1e-8)
    assert_close(grad, leaf.grad, 1e-8)


def assert_close(found, expected, relative):
    """Largest difference within a fraction of the largest expected value."""
    assert float((found - expected).abs().max()) <= relative * float(expected.abs().max())


@pytest.mark.parametrize("name", SCENES)
def test_tape_equals_torch(name):
    """Tape and torch routes agree to 1e-12, image and gradient."""
    scene, heights = SCENES[name], relief_of(name)
    simulator, weights = make(scene), random_image(scene)
    image, grad = gradient(simulator, heights, weights)
    on_tape = wp.array(heights[None].numpy(), dtype=wp.float64, device="cpu", requires_grad=True)
    tape = wp.Tape()
    with tape:
        recorded = simulate_on_tape(tape, simulator, on_tape)
    tape.backward(grads={recorded: wp.array(weights[None].numpy(), dtype=wp.float64, device="cpu")})
    assert_close(torch.from_numpy(recorded.numpy()[0]), image, 1e-12)
    assert_close(torch.from_numpy(on_tape.grad.numpy()[0]), grad, 1e-12)


@pytest.mark.parametrize("effects", [{}, EFFECTS], ids=["plain", "all effects"])
def test_torch_gradcheck(effects):
    """torch.autograd.gradcheck through the whole simulation of a 4 x 4 relief."""
    scene = Scene(height_samples=4, image_pixels=6, wavelengths_m=(530e-9,), radiosity_W_m2=(1.0,), **effects)
    simulator = make(scene, n_photons=100, smoothing=4.0)
    heights = (bumpy_heights(4) * 1e3).requires_grad_()  # in millimetres, so that steps of 1e-6 are small
    assert torch.autograd.gradcheck(lambda mm: simulator(mm * 1e-3), heights, eps=1e-6, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("name", [*PLAIN, *TOGETHER])
def test_float32_agrees_with_float64(name):
    """Relative error of image and gradient at most 1e-3. Point and tilted light are in the scenes with all effects."""
    scene, heights, weights = SCENES[name], relief_of(name), random_image(SCENES[name])
    expected = gradient(make(scene), heights, weights)
    found = gradient(make(scene, dtype=torch.float32), heights.float(), weights.float())
    for single, double in zip(found, expected, strict=True):
        assert float((single - double).norm()) <= 1e-3 * float(double.norm())


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("name", ["air_far", "air_far, all effects"])
def test_batch_of_three_equals_three_singles(placement, name):
    """Image and gradient of a batch are those of its members."""
    scene = SCENES[name]
    simulator = make(scene, placement, profile=PROFILES.get(placement, "gaussian"))
    weights = random_image(scene)
    stack = torch.stack([bumpy_heights(seed=k) for k in range(3)])
    images, grads = gradient(simulator, stack, weights)
    for k in range(3):
        image, grad = gradient(simulator, stack[k], weights)
        assert_close(images[k], image, 1e-13)
        assert_close(grads[k], grad, 1e-12)


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("name", ["point", "point, all effects"])
def test_chunks_change_nothing(placement, name, monkeypatch):
    """Many small chunks give what one chunk gives: memory is bounded, the result is not."""
    scene, heights = SCENES[name], relief_of(name)
    weights, profile = random_image(scene), PROFILES.get(placement, "gaussian")
    whole = gradient(make(scene, placement, profile=profile), heights, weights)
    monkeypatch.setitem(CHUNK_BYTES, "cpu", 9 * 8 * 37)
    simulator = make(scene, placement, profile=profile)
    assert len(list(simulator.engine.chunks(1))) > 10
    for found, expected in zip(gradient(simulator, heights, weights), whole, strict=True):
        assert_close(found, expected, 1e-12)


@pytest.mark.parametrize("name", ["contact", "contact, all effects"])
def test_second_backward_equals_first(name):
    """No stale accumulation between calls."""
    scene, heights = SCENES[name], relief_of(name)
    simulator, weights = make(scene, "random", profile="gaussian"), random_image(scene)
    first, second = (gradient(simulator, heights, weights)[1] for _ in range(2))
    assert torch.equal(first, second)


@pytest.mark.parametrize("effects", [{}, EFFECTS], ids=["plain", "all effects"])
def test_gradient_is_finite_where_light_is_lost(effects):
    """Total reflection and paths beside the screen leave no NaN."""
    scene = Scene(height_samples=10, image_pixels=20, screen_position_m=(0, 0, -0.05), **effects)
    heights = bumpy_heights(amplitude=4e-3)
    image, grad = gradient(make(scene), heights, random_image(scene))
    assert torch.isfinite(image).all()
    assert torch.isfinite(grad).all()
    assert grad.abs().max() > 0
