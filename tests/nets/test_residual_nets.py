"""This project's own networks, direct and unrolled, and the blocks and encodings that they share."""

import pytest
import torch

from nets.architecture import build
from nets.backbone import ResidualBlock, SelfAttention
from nets.direct_net import DirectNet
from nets.encoding import clipped_image, log_image, scaled_gradient, slopes
from nets.residual_config import BackboneConfig, DirectConfig, UnrolledConfig
from nets.unrolled_net import UnrolledUpdater, warm_start
from tests.nets.conftest import BACKBONE, KINDS, SCENE, inputs, scramble, unreached
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.scene import Scene


def two_steps(updater, scene=SCENE):
    target, simulated, heights, gradient = inputs(scene)
    first = updater(target, simulated, heights, gradient)
    return updater(target, simulated * 0.8, first.heights, gradient, first.hidden, 1)


def test_fresh_networks_answer_flat_and_change_nothing():
    target, simulated, heights, gradient = inputs()
    assert torch.equal(build(KINDS["direct"], SCENE)(target), torch.zeros_like(heights))
    assert torch.equal(build(KINDS["unrolled"], SCENE)(target, simulated, heights, gradient).heights, heights)


@pytest.mark.parametrize("n", [1 + 2**k for k in range(1, 5)])
def test_any_size_of_plate_fits(n):
    """Sizes that do not halve twice are padded, and the padding is removed."""
    scene = Scene(height_samples=n, image_pixels=3 * n)
    target, simulated, heights, gradient = inputs(scene)
    assert scramble(build(KINDS["direct"], scene))(target).shape == heights.shape
    assert (
        scramble(build(KINDS["unrolled"], scene))(target, simulated, heights, gradient).heights.shape == heights.shape
    )


def test_gradients_reach_every_parameter():
    direct = scramble(build(KINDS["direct"], SCENE))
    direct(inputs()[0]).mul(1e3).square().sum().backward()
    assert unreached(direct) == []
    updater = scramble(build(KINDS["unrolled"], SCENE))
    two_steps(updater).heights.mul(1e3).square().sum().backward()
    assert unreached(updater) == []


@pytest.mark.parametrize("kind", ["direct", "unrolled"])
def test_a_fresh_network_learns_from_its_first_step(kind):
    """Layers that start at zero must not hold each other at zero."""
    module, (target, simulated, heights, gradient) = build(KINDS[kind], SCENE), inputs()
    optimiser = torch.optim.Adam(module.parameters(), lr=1e-2)
    losses = []
    for _ in range(8):
        answer = module(target) if kind == "direct" else module(target, simulated, heights * 0, gradient).heights
        loss = (answer - heights).mul(1e3).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < 0.5 * losses[0]


def test_autocast_keeps_heights_in_float32():
    updater = scramble(build(KINDS["unrolled"], SCENE)).to(memory_format=torch.channels_last)
    with torch.no_grad():
        exact = two_steps(updater)
        with torch.autocast("cpu", torch.bfloat16):
            rough = two_steps(updater)
            direct = scramble(build(KINDS["direct"], SCENE))(inputs()[0])
    assert rough.heights.dtype == direct.dtype == torch.float32
    assert 0 < (rough.heights - exact.heights).abs().max() < 0.02 * exact.heights.std()
    # Were the head in bfloat16, its answers would survive the round trip.
    assert not torch.equal(direct, direct.bfloat16().float())


def test_small_updates_survive_on_large_heights():
    updater = scramble(build(KINDS["unrolled"], SCENE))
    with torch.no_grad():
        updater.head.conv.weight.zero_()
        updater.head.conv.bias.fill_(1e-4)
        target, simulated, heights, gradient = inputs()
        with torch.autocast("cpu", torch.bfloat16):
            answer = updater(target, simulated, heights + 2e-3, gradient).heights
    assert torch.allclose(answer - (heights + 2e-3), torch.tensor(1e-7), atol=5e-10)


@pytest.mark.slow
def test_compiles_as_one_graph():
    updater = scramble(build(KINDS["unrolled"], SCENE))
    compiled = torch.compile(updater, fullgraph=True, backend="aot_eager")
    with torch.no_grad():
        assert torch.allclose(two_steps(compiled).heights, two_steps(updater).heights, atol=1e-8)


def test_memory_and_step_number_matter():
    updater, (target, simulated, heights, gradient) = scramble(build(KINDS["unrolled"], SCENE)), inputs()
    with torch.no_grad():
        first = updater(target, simulated, heights, gradient)
        assert first.hidden.shape == (2, 3, 16, 16)
        with_memory = updater(target, simulated, heights, gradient, first.hidden)
        later, last, beyond = (updater(target, simulated, heights, gradient, step=step) for step in (1, 3, 99))
    assert not torch.equal(with_memory.heights, first.heights)
    assert not torch.equal(later.heights, first.heights)
    assert torch.equal(last.heights, beyond.heights)


def test_scale_of_the_gradient_does_not_matter():
    updater, (target, simulated, heights, gradient) = scramble(build(KINDS["unrolled"], SCENE)), inputs()
    with torch.no_grad():
        answers = [updater(target, simulated, heights, gradient * scale).heights for scale in (1.0, 1e-30, 1e30)]
        other = updater(target, simulated, heights, gradient.flip(-1)).heights
    assert torch.allclose(answers[0], answers[1], atol=1e-9) and torch.allclose(answers[0], answers[2], atol=1e-9)
    assert not torch.allclose(answers[0], other, atol=1e-9)


def test_updater_without_gradient_needs_none():
    config = KINDS["unrolled"].model_copy(update={"use_gradient": False})
    updater, (target, simulated, heights, gradient) = scramble(build(config, SCENE)), inputs()
    with torch.no_grad():
        assert torch.equal(
            updater(target, simulated, heights).heights, updater(target, simulated, heights, gradient).heights
        )


def test_warm_start_repeats_the_direct_network():
    direct = scramble(build(KINDS["direct"], SCENE))
    target, simulated, heights, gradient = inputs()
    updater = scramble(build(KINDS["unrolled"], SCENE), seed=1)
    with torch.no_grad():
        expected = direct(target)
        warm_start(updater, direct, keep_head=True)
        assert torch.allclose(updater(target, simulated, heights * 0, gradient).heights, expected, atol=1e-8)
        warm_start(updater, direct, keep_head=False)
        assert torch.equal(updater(target, simulated, heights, gradient).heights, heights)


def test_warm_start_refuses_another_backbone():
    other = BACKBONE.model_copy(update={"depths": (1, 1, 1)})
    direct = DirectNet(DirectConfig(backbone=other), SCENE)
    with pytest.raises(MismatchError, match="backbones .* differ"):
        warm_start(UnrolledUpdater(UnrolledConfig(backbone=BACKBONE), SCENE), direct, keep_head=True)


@pytest.mark.parametrize("shape", [(2, 1, 64, 64), (2, 3, 32, 32), (3, 64, 64)])
def test_direct_refuses_other_images(shape):
    with pytest.raises(MismatchError, match=r"\[B, 3, 64, 64\]"):
        build(KINDS["direct"], SCENE)(torch.rand(shape))


def test_ratio_must_be_whole():
    with pytest.raises(InputError, match="no multiple of 16"):
        build("direct-small", Scene(height_samples=16, image_pixels=40))


def test_light_is_measured_against_a_flat_plate():
    """Twice the lamp and twice the image are the same plate; a wavelength without light does no harm."""
    scenes = [SCENE, SCENE.model_copy(update={"radiosity_W_m2": (2.0, 2.0, 2.0)})]
    networks = [scramble(build(KINDS["direct"], scene)) for scene in scenes]
    image = inputs()[0]
    with torch.no_grad():
        assert torch.allclose(networks[0](image), networks[1](2 * image), atol=1e-9)
        dark = scramble(build(KINDS["direct"], SCENE.model_copy(update={"radiosity_W_m2": (0.0, 1.0, 1.0)})))
        assert dark(image).isfinite().all()


def test_images_are_encoded_by_their_logarithm():
    image = torch.tensor([-0.1, 0.0, 1.0, 50.0])
    encoded = log_image(image, 0.02)
    assert torch.allclose(encoded, torch.tensor([-3.9318, -3.9318, 0.0, 3.8926]), atol=1e-4)
    assert clipped_image(image, 4.0).tolist() == [-1.0, -1.0, 0.0, 3.0]


def test_slopes_of_a_ramp_are_its_slopes():
    pitch = (2e-3, 1e-3)
    x, y = torch.meshgrid(torch.arange(8.0) * pitch[0], torch.arange(8.0) * pitch[1], indexing="xy")
    found = slopes((0.5 * x - 0.25 * y)[None, None], pitch, 4.0)
    assert torch.allclose(found[0, 0, :, 1:-1], torch.tensor(0.5)) and torch.allclose(
        found[0, 1, 1:-1], torch.tensor(-0.25)
    )
    assert slopes((100 * x)[None, None], pitch, 4.0).max() == 4.0


def test_zero_gradient_stays_zero():
    assert torch.equal(scaled_gradient(torch.zeros(1, 1, 4, 4)), torch.zeros(1, 1, 4, 4))


def test_blocks_start_as_the_identity():
    x = torch.rand(1, 16, 8, 8)
    assert torch.equal(ResidualBlock(16, 16)(x), x)
    assert torch.equal(SelfAttention(16, 8)(x), x)


def test_attention_sees_everything():
    attention, x = scramble(SelfAttention(16, 8)), torch.rand(1, 16, 6, 6, requires_grad=True)
    attention(x)[0, 0, 0, 0].backward()
    assert x.grad[0].abs().sum(0).min() > 0


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"widths": (8, 8), "depths": (1,)}, "1 depths for 2 widths"),
        ({"widths": (8,), "depths": (1,), "attention_levels": {1}}, "attention at level 1"),
        ({"widths": (0,), "depths": (1,)}, "greater than or equal to 1"),
        ({"widths": (8,), "depths": (1,), "width": 3}, "Extra inputs"),
    ],
)
def test_impossible_backbones_are_refused(values, reason):
    with pytest.raises(ValueError, match=reason):
        BackboneConfig.model_validate(values)
