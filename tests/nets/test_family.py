"""The paper's family: every row of Tab. 2, on whole ranges where nothing is computed, on small members where it is."""

import math

import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from nets.architecture import build
from nets.config import BEST_UPDATER, RANGES, Choice, DenoiserConfig, UpdaterConfig
from nets.denoiser import Denoiser
from nets.padding import crop_padding, pad_to_multiple
from nets.receptive import receptive_field
from nets.unet import ConvBlock, DownBlock, UpBlock
from nets.updater import Updater, output_strides
from tests.nets.conftest import KINDS, SCENE, SMALL, inputs, members, positive, scramble, unreached
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.scene import Scene

QUICK = settings(max_examples=50, deadline=None)
MAX_REAL = 300_000
"""Parameters of networks that are computed with."""


def weights(module):
    return sum(parameter.numel() for parameter in module.parameters())


def unreached_but_slopes(module):
    """As ``unreached``, without PReLU's slopes, which take no part where everything is positive."""
    return [name for name in unreached(module) if not name.endswith("nonlinearity.weight")]


@QUICK
@given(members(), st.integers(1, 70), st.integers(1, 70), st.integers(1, 4))
def test_every_denoiser_keeps_the_shape_of_any_image(network, rows, columns, channels):
    """On the meta device, which computes shapes only, so that the largest members take part."""
    with torch.device("meta"):
        image = torch.empty(2, channels, rows, columns)
        assert Denoiser(DenoiserConfig(network=network))(image).shape == image.shape


@QUICK
@given(members(), st.integers(2, 40), st.integers(1, 9), st.booleans())
def test_every_updater_brings_any_whole_ratio_to_the_heights(network, n, ratio, use_gradient):
    scene = Scene(height_samples=n, image_pixels=n * ratio)
    with torch.device("meta"):
        updater = Updater(UpdaterConfig(network=network, use_gradient=use_gradient), scene)
        image, heights = torch.empty(2, 3, n * ratio, n * ratio), torch.empty(2, n, n)
        assert updater(image, image, heights, heights if use_gradient else None).shape == heights.shape


@settings(max_examples=40, deadline=None)
@given(members(c_init=st.integers(1, 4)), st.integers(7, 20))
def test_gradients_reach_every_parameter_of_a_denoiser(network, size):
    with torch.device("meta"):
        assume(weights(Denoiser(DenoiserConfig(network=network))) < MAX_REAL)
    denoiser = positive(Denoiser(DenoiserConfig(network=network)))
    denoiser(torch.rand(1, 2, size, size + 1) + 0.1).square().sum().backward()
    assert unreached_but_slopes(denoiser) == []


@settings(max_examples=40, deadline=None)
@given(members(), st.booleans())
def test_gradients_reach_every_parameter_of_an_updater(network, use_gradient):
    config, scene = UpdaterConfig(network=network, use_gradient=use_gradient), Scene(height_samples=6, image_pixels=24)
    with torch.device("meta"):
        assume(weights(Updater(config, scene)) < MAX_REAL)
    updater = positive(Updater(config, scene))
    target, simulated, heights, gradient = inputs(scene)
    updater(target, simulated, heights, gradient.abs()).mul(1e3).square().sum().backward()
    assert unreached_but_slopes(updater) == []


def test_gradients_reach_the_slopes_of_prelu():
    target, simulated, heights, gradient = inputs()
    for module, arguments in (
        (build(DenoiserConfig(network=SMALL), SCENE), (target - 1,)),
        (build(UpdaterConfig(network=SMALL), SCENE), (target - 1, simulated, heights, gradient)),
    ):
        scramble(module)(*arguments).mul(1e3).square().sum().backward()
        assert unreached(module) == []


ENDS = [
    (key, value)
    for key, limits in RANGES.items()
    for value in (limits.values if isinstance(limits, Choice) else (limits.low, limits.high))
]


@pytest.mark.parametrize(("key", "value"), ENDS)
def test_both_ends_of_every_row_work(key, value):
    """One row at its limit, the others small; computed for real, forward and backward."""
    value = (
        value
        if isinstance(value, str | float) and key in ("nonlinearity", "learning_rate", "lambda_tv")
        else int(value)
    )
    network = type(SMALL).model_validate(SMALL.model_dump() | {"n_s": 1, key: value})
    scene = Scene(height_samples=5, image_pixels=20)
    target, simulated, heights, gradient = inputs(scene, batch=1)
    for module, arguments in (
        (build(DenoiserConfig(network=network), scene), (target,)),
        (build(UpdaterConfig(network=network), scene), (target, simulated, heights, gradient)),
    ):
        answer = module(*arguments)
        answer.square().sum().backward()
        assert answer.shape == (target if module.config.kind == "denoiser" else heights).shape
        assert answer.isfinite().all()
        assert all(parameter.grad.isfinite().all() for parameter in module.parameters())


@pytest.mark.parametrize("kernel", range(2, 12))
def test_down_and_up_change_sizes_exactly_and_shift_nothing(kernel):
    """An impulse on an even sample comes back centred on where it was (half a sample off for even kernels at most)."""
    down, up = DownBlock(1, 1, kernel, "ReLU"), UpBlock(1, 1, kernel, "ReLU")
    with torch.no_grad():
        for block in (down, up):
            block.conv.weight.fill_(1.0)
            block.conv.bias.zero_()
        x = torch.zeros(1, 1, 64, 64)
        x[..., 32:34, 32:34] = 1.0
        half = down(x)
        assert half.shape == (1, 1, 32, 32)
        back = up(half)
    assert back.shape == x.shape
    rows = torch.arange(64.0)
    centre = (back.sum((0, 1, 3)) * rows).sum() / back.sum()
    assert centre == pytest.approx(32.5, abs=0.51)


@pytest.mark.parametrize("kernel", range(2, 12))
def test_blocks_of_even_and_odd_kernels_keep_odd_sizes(kernel):
    assert ConvBlock(1, 2, kernel, "ELU")(torch.rand(1, 1, 17, 3)).shape == (1, 2, 17, 3)


@given(st.integers(1, 100), st.integers(1, 100), st.sampled_from([1, 2, 4, 8, 16]))
def test_padding_is_removed_exactly(rows, columns, multiple):
    x = torch.arange(float(rows * columns)).reshape(1, 1, rows, columns)
    padded = pad_to_multiple(x, multiple)
    assert padded.shape[-2] % multiple == padded.shape[-1] % multiple == 0
    assert padded.shape[-2] < rows + multiple and padded.shape[-1] < columns + multiple
    assert torch.equal(crop_padding(padded, (rows, columns), multiple), x)
    assert padded.min() == x.min() and padded.max() == x.max()


@given(st.integers(1, 64), st.sampled_from([2, 4, 8, 16]))
def test_strides_of_output_blocks_multiply_to_the_ratio(ratio, k_dec):
    assert math.prod(output_strides(ratio, k_dec)) == ratio


@pytest.mark.parametrize(
    ("ratio", "k_dec", "strides"),
    [
        (4, 2, (2, 2)),
        (4, 4, (4,)),
        (4, 8, (4,)),
        (4, 16, (4,)),
        (1, 8, (1,)),
        (3, 2, (3,)),
        (6, 4, (2, 3)),
        (16, 4, (4, 4)),
    ],
)
def test_strides_are_those_documented(ratio, k_dec, strides):
    assert output_strides(ratio, k_dec) == strides


def test_denoiser_treats_channels_alike_and_apart():
    denoiser = Denoiser(DenoiserConfig(network=SMALL)).eval()
    image = torch.rand(2, 3, 21, 18)
    with torch.no_grad():
        answer = denoiser(image)
        order = [2, 0, 1]
        assert torch.allclose(denoiser(image[:, order]), answer[:, order], atol=1e-6)
        changed = image.clone()
        changed[:, 1] += 1.0
        again = denoiser(changed)
    assert torch.allclose(again[:, [0, 2]], answer[:, [0, 2]], atol=1e-6)
    assert not torch.allclose(again[:, 1], answer[:, 1], atol=1e-3)


def test_denoiser_keeps_pixels_where_they_are():
    """A change of one pixel of an image that is not square shows around that pixel only."""
    denoiser, config = Denoiser(DenoiserConfig(network=SMALL)), DenoiserConfig(network=SMALL)
    reach = receptive_field(config, SCENE).image_pixels
    image = torch.rand(1, 1, 16, 96)
    changed = image.clone()
    changed[0, 0, 3, 80] += 1.0
    with torch.no_grad():
        difference = (denoiser(changed) - denoiser(image)).abs()[0, 0]
    assert difference[3, 80] > 0.1
    assert difference[:, : 80 - reach].max() < 1e-6


def test_units_scale_what_goes_in_and_out():
    """A thousand times the light in a thousand times the unit is the same network."""
    bright = Denoiser(DenoiserConfig(network=SMALL, irradiance_unit_W_m2=1000.0))
    plain = Denoiser(DenoiserConfig(network=SMALL))
    bright.load_state_dict(plain.state_dict())
    image = torch.rand(1, 1, 16, 16)
    with torch.no_grad():
        assert torch.allclose(bright(image * 1000) / 1000, plain(image), atol=1e-6)


def test_residual_denoiser_adds_to_its_input():
    image = torch.rand(1, 2, 16, 16)
    config = DenoiserConfig(network=SMALL)
    residual, plain = Denoiser(config), Denoiser(config.model_copy(update={"is_residual": False}))
    plain.load_state_dict(residual.state_dict())
    with torch.no_grad():
        assert torch.allclose(residual(image), image + plain(image), atol=1e-6)


def test_fresh_updater_changes_nothing(scene):
    target, simulated, heights, gradient = inputs(scene)
    assert torch.equal(build(BEST_UPDATER, scene)(target, simulated, heights, gradient), heights)


def test_updater_uses_each_of_its_inputs():
    updater = positive(build(UpdaterConfig(network=SMALL), SCENE))
    arguments = [argument.requires_grad_() for argument in inputs()]
    (updater(*arguments) - arguments[2]).sum().backward()
    assert all(argument.grad.abs().max() > 0 for argument in arguments)


def test_updater_without_gradient_needs_none():
    updater = positive(build(UpdaterConfig(network=SMALL, use_gradient=False), SCENE))
    target, simulated, heights, gradient = inputs()
    with torch.no_grad():
        assert torch.equal(updater(target, simulated, heights), updater(target, simulated, heights, gradient))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda t, s, h, g: (t[:, :1], s, h, g), "target image has shape"),
        (lambda t, s, h, g: (t, s[..., :32], h, g), "simulated image has shape"),
        (lambda t, s, h, g: (t, s, h[:, :8], g), "heights has shape"),
        (lambda t, s, h, g: (t, s, h, g[:, None]), "gradient has shape"),
        (lambda t, s, h, g: (t, s, h, None), "gradient of the simulation"),
    ],
)
@pytest.mark.parametrize("kind", ["updater", "unrolled"])
def test_inputs_of_another_scene_are_refused(kind, change, reason):
    """Above all, one channel never broadcasts into three."""
    with pytest.raises(MismatchError, match=reason):
        build(KINDS[kind], SCENE)(*change(*inputs()))


def test_denoiser_refuses_an_image_without_batch():
    with pytest.raises(MismatchError, match=r"\[B, n_w, H, W\]"):
        Denoiser(DenoiserConfig(network=SMALL))(torch.rand(3, 16, 16))


def test_a_ratio_that_is_no_whole_number_is_refused():
    with pytest.raises(InputError, match="use a scene with image_pixels=48"):
        build("paper-updater", Scene(height_samples=16, image_pixels=50))
