"""The camera of an image: closed forms for displacement and blur, operators against their adjoints, and what must not matter."""

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.seen_camera.aligned_channels import channels_together, repaired
from warp_caustics.reconstruct.seen_camera.blur_estimate import estimated_blur
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.channel_registration import registered
from warp_caustics.resampling import blur_matrices, blur_matrix, blurred

PIXELS = 128
RGB = (610e-9, 530e-9, 430e-9)


def lines(shift=(0.0, 0.0), scale=0.0, blur=0.0, seed=0, bent=0.0):
    """Gaussian ridges on an even background, in closed form: moved, magnified and blurred exactly, shape [m, m].

    Narrow enough that a blur shows, wide enough (0.9 px) for pixels to hold them. `bent` misplaces each.
    """
    rng = np.random.default_rng(seed)
    along = np.arange(PIXELS) - (PIXELS - 1) / 2
    x = ((along - shift[0]) / (1 + scale))[None, :]
    y = ((along - shift[1]) / (1 + scale))[:, None]
    image, wrong = np.ones((PIXELS, PIXELS)), np.random.default_rng(7)
    for _ in range(12):
        angle, place, width, height = (
            rng.uniform(0, np.pi),
            rng.uniform(-45, 45),
            rng.uniform(0.9, 2),
            rng.uniform(0.3, 2),
        )
        across = x * np.cos(angle) + y * np.sin(angle) - place - bent * wrong.standard_normal()
        std = np.hypot(width, blur)
        image = image + height * width / std * np.exp(-0.5 * (across / std) ** 2)
    return image


def stacked(*images):
    return torch.tensor(np.stack(images), dtype=torch.float32)


def found(measured, simulated, weight=None):
    weight = torch.ones_like(measured) if weight is None else weight
    return registered(Measurement(measured, weight, None), simulated)


def noise(*shape, std=0.01, seed=1):
    return std * torch.tensor(np.random.default_rng(seed).standard_normal(shape), dtype=torch.float32)


CLEAN = stacked(*[lines()] * 3)
RED, BLUE = (0.31, -0.22), (-0.4, 0.45)


@pytest.mark.parametrize("bent", [0.0, 0.5])
def test_displacements_are_found_to_a_hundredth_of_a_pixel(bent):
    """Also beside a simulation that has its lines in wrong places."""
    measured = stacked(lines(RED), lines(), lines(BLUE)) + noise(3, PIXELS, PIXELS)
    camera = found(measured, stacked(*[lines(bent=bent)] * 3))
    np.testing.assert_allclose(camera.shift, [RED, (0, 0), BLUE], atol=0.01)
    np.testing.assert_allclose(camera.scale * PIXELS / 2, 0.0, atol=0.02)


def test_several_pixels_and_a_scale_are_found():
    measured = stacked(lines((5.3, -7.6), scale=2e-3), lines(), lines(scale=-4e-3)) + noise(3, PIXELS, PIXELS)
    camera = found(measured, CLEAN)
    np.testing.assert_allclose(camera.shift[0], (5.3, -7.6), atol=0.03)
    np.testing.assert_allclose(camera.shift[2], 0, atol=0.01)
    np.testing.assert_allclose(camera.scale * PIXELS / 2, np.array([2e-3, 0, -4e-3]) * PIXELS / 2, atol=0.02)


def test_a_common_shift_is_left_alone():
    """It is that of a displaced plate."""
    measured = stacked(*[lines((0.4, -0.7))] * 3)
    assert found(measured + noise(3, PIXELS, PIXELS), CLEAN).is_perfect


@pytest.mark.parametrize("level", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("bent", [0.0, 0.5])
def test_zero_stays_exactly_zero(level, bent):
    camera = found(CLEAN + level * noise(3, PIXELS, PIXELS, std=1.0), stacked(*[lines(bent=bent)] * 3))
    assert camera.is_perfect and not camera.shift.any() and not camera.scale.any() and not camera.blur.any()
    assert camera.warnings(RGB, 0.6) == []


@pytest.mark.parametrize("bent", [0.0, 0.5])
def test_blur_is_found_where_lines_are_misplaced(bent):
    """To 0.1 px; least squares of pixels would take misplaced lines for blurred ones."""
    measured = stacked(lines(blur=0.6), lines(blur=1.0), lines(blur=2.0)) + noise(3, PIXELS, PIXELS)
    camera = found(measured, stacked(*[lines(bent=bent)] * 3))
    np.testing.assert_allclose(camera.blur, [0.6, 1.0, 2.0], atol=0.1)
    assert not camera.displaces


@pytest.mark.parametrize("channels", [1, 2, 3, 5])
def test_any_number_of_channels(channels):
    """One has nothing to be displaced against, and a blur that is told from noise all the same."""
    shifts = [(0.1 * (c - channels // 2), 0.0) for c in range(channels)]
    measured = stacked(*[lines(shift, blur=1.2) for shift in shifts]) + noise(channels, PIXELS, PIXELS)
    camera = found(measured, stacked(*[lines()] * channels))
    np.testing.assert_allclose(camera.shift, shifts, atol=0.01)
    np.testing.assert_allclose(camera.blur, 1.2, atol=0.1)
    sharp = stacked(*[lines()] * channels) + noise(channels, PIXELS, PIXELS)
    assert found(sharp, stacked(*[lines()] * channels)).is_perfect


def test_masked_pixels_do_not_matter():
    measured = stacked(lines(RED, blur=1), lines(blur=1), lines(BLUE, blur=1)) + noise(3, PIXELS, PIXELS)
    weight = torch.ones_like(measured)
    weight[torch.rand(weight.shape, generator=torch.Generator().manual_seed(2)) < 0.003] = 0
    cameras = [found(torch.where(weight > 0, measured, value), CLEAN, weight) for value in (0.0, 50.0)]
    np.testing.assert_array_equal(cameras[0].shift, cameras[1].shift)
    np.testing.assert_array_equal(cameras[0].blur, cameras[1].blur)
    np.testing.assert_allclose(cameras[0].shift, [RED, (0, 0), BLUE], atol=0.015)
    np.testing.assert_allclose(cameras[0].blur, 1, atol=0.1)


def test_dead_pixels_everywhere_tell_no_displacement():
    """Not one pixel is far from all that do not count."""
    measured = stacked(lines(RED), lines(), lines(BLUE)) + noise(3, PIXELS, PIXELS)
    weight = torch.ones_like(measured)
    weight[:, ::5, ::5] = 0
    camera = found(measured, CLEAN, weight)
    assert not camera.displaces and np.isfinite(camera.blur).all() and np.isfinite(camera.gain).all()


def test_a_dark_channel_is_left_out():
    measured = stacked(lines(RED), lines(), np.zeros((PIXELS, PIXELS))) + noise(3, PIXELS, PIXELS)
    weight = torch.ones_like(measured)
    weight[2] = 0
    camera = found(measured, CLEAN * weight, weight)
    np.testing.assert_allclose(camera.shift[0], RED, atol=0.01)
    assert not camera.shift[1:].any() and not camera.blur.any()


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("level", [0.0, 0.3])
def test_a_channel_without_light_is_left_out(level):
    """All its pixels count and hold the same: no spectrum to compare, and the others are found as without it."""
    measured = stacked(lines(RED, blur=1), lines(blur=1), level * np.ones((PIXELS, PIXELS)))
    camera = found(measured, CLEAN)
    np.testing.assert_allclose(camera.shift, [RED, (0, 0), (0, 0)], atol=0.01)
    np.testing.assert_allclose(camera.blur, [1, 1, 0], atol=0.1)
    assert np.isfinite(camera.gain).all() and np.isfinite(camera.ambient).all()


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_measured_image_without_light_tells_nothing():
    assert found(torch.zeros_like(CLEAN), CLEAN).is_perfect


def test_gain_and_ambient_do_not_disturb():
    gain, ambient = torch.tensor([1.05, 0.98, 1.02])[:, None, None], 0.03
    sharp = gain * stacked(lines(RED), lines(), lines(BLUE)) + ambient + noise(3, PIXELS, PIXELS)
    camera = found(sharp, CLEAN)
    np.testing.assert_allclose(camera.shift, [RED, (0, 0), BLUE], atol=0.01)
    assert not camera.blur.any()
    np.testing.assert_allclose(camera.gain, gain.flatten(), atol=0.03)
    np.testing.assert_allclose(camera.ambient, ambient, atol=0.05)


def test_a_flat_simulation_tells_nothing():
    assert found(CLEAN, torch.ones_like(CLEAN)).is_perfect


def test_a_small_image_tells_nothing():
    assert found(CLEAN[:, :32, :32], CLEAN[:, :32, :32]).is_perfect


def test_the_error_of_a_blur_grows_with_what_is_wrong():
    transforms = [torch.fft.rfft2(stacked(*[lines(seed=seed)] * 3) - 1) for seed in (0, 3)]
    errors = [estimated_blur(transforms[0], simulated).error for simulated in transforms]
    assert (errors[1] > 1.3 * errors[0]).all()


@pytest.mark.parametrize("blur", [0.2, 0.5, 1.0, 3.0])
def test_blur_is_its_own_adjoint_and_keeps_all_light(blur):
    matrices = blur_matrices(48, np.array([blur, 0.0]), "cpu").double()
    rng = np.random.default_rng(0)
    x, y = (torch.tensor(rng.standard_normal((2, 48, 48))) for _ in range(2))
    assert float((blurred(x, matrices) * y).sum()) == pytest.approx(float((x * blurred(y, matrices)).sum()), rel=1e-6)
    torch.testing.assert_close(blurred(x, matrices).sum((1, 2)), x.sum((1, 2)), rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(blurred(x, matrices)[1], x[1])
    variable = x.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((blurred(variable, matrices) * y).sum(), variable)
    torch.testing.assert_close(gradient, blurred(y, matrices), rtol=1e-6, atol=1e-6)


def test_blur_has_the_width_it_is_told():
    """Of a ridge that pixels hold: widths add in squares."""
    matrix = blur_matrix(PIXELS, 1.3).numpy()
    along = np.arange(PIXELS) - 60.0
    ridge, wide = (np.exp(-0.5 * (along / width) ** 2) / width for width in (1.2, np.hypot(1.2, 1.3)))
    np.testing.assert_allclose(matrix @ ridge, wide, atol=1e-3)


def test_channels_come_to_lie_together():
    """The inverse of a displacement is exact for what pixels hold, and spares the rest."""
    image = CausticImage(np.stack([lines(RED, scale=1e-3), lines(), lines(BLUE, scale=-2e-3)]))
    camera = ChannelCamera.perfect(3, PIXELS)
    camera.shift[[0, 2]], camera.scale[[0, 2]] = (RED, BLUE), (1e-3, -2e-3)
    together = channels_together(image, camera, "cpu").irradiance
    inside = (slice(None), slice(6, -6), slice(6, -6))
    np.testing.assert_allclose(together[inside], np.stack([lines()] * 3)[inside], atol=0.015)
    np.testing.assert_array_equal(together[1], image.irradiance[1])
    assert np.abs(image.irradiance[0] - lines())[6:-6, 6:-6].max() > 0.3


@pytest.mark.parametrize(("shift", "scale"), [((0.5, 0.0), 0.0), ((0.3, -0.2), 0.0), ((0.0, 0.0), 2e-3)])
def test_noise_of_channels_that_are_moved_is_told_as_it_is(shift, scale):
    """White before it; that of the channel that stays is as it was."""
    pixels, noise = 256, np.array([0.02, 0.02, 0.03])
    white = 1 + noise[:, None, None] * np.random.default_rng(3).standard_normal((3, pixels, pixels))
    camera = ChannelCamera.perfect(3, pixels)
    camera.shift[0], camera.scale[0] = shift, scale
    together = channels_together(CausticImage(white, noise), camera, "cpu")
    np.testing.assert_allclose(together.irradiance.std(axis=(1, 2)), together.noise_std, rtol=0.01)
    assert together.noise_std[0] < 0.98 * noise[0] and (together.noise_std[1:] == noise[1:]).all()


def test_pixels_made_of_others_that_do_not_count_do_not_count():
    mask = np.ones((3, PIXELS, PIXELS), bool)
    mask[0, 40, 50] = False
    values = np.ones((3, PIXELS, PIXELS))
    values[0, 40, 50] = 100.0
    camera = ChannelCamera.perfect(3, PIXELS)
    camera.shift[0] = 0.5, 0.0
    together = channels_together(CausticImage(values, mask=mask), camera, "cpu")
    gaps = np.argwhere(~together.mask[0])
    assert {(40, 49), (40, 50)} <= {tuple(at) for at in gaps} and len(gaps) < 6
    assert together.mask[1:].all() and np.abs(together.irradiance[together.mask] - 1).max() < 10


def test_repaired_pixels_take_their_neighbours():
    values, mask = np.ones((1, 16, 16)), np.ones((1, 16, 16), bool)
    values[0, 5, 5], mask[0, 5, 5] = 0.0, False
    assert repaired(CausticImage(values, mask=mask))[0, 5, 5] == pytest.approx(1)


def test_the_warning_names_the_channel_and_what_was_trained():
    camera = ChannelCamera.perfect(3, 512)
    camera.shift[2] = 0.0, 0.3
    assert camera.warnings(RGB, 0.6) == [], "what a network has seen costs nothing"
    (line,) = camera.warnings(RGB)
    assert "430 nm lies up to 0.30 px beside that of 530 nm" in line and "\n" not in line
    assert "trained" not in camera.warnings(RGB)[0]
    camera.shift[2], camera.scale[0] = 0.0, 1e-3
    assert "trained for no more than 0.2 px; correct it" in camera.warnings(RGB, 0.2)[0]
    assert "610 nm lies up to 0.36 px" in camera.warnings(RGB)[0], "256 px from the middle, along x and y"
    camera.scale[0], camera.blur[1] = 0.0, 2.4
    assert "530 nm is blurred by 2.4 px" in camera.warnings(RGB)[0]
    camera.blur[1] = 1.9
    assert camera.warnings(RGB) == []


def test_a_camera_survives_its_record():
    camera = ChannelCamera.perfect(3, 512)
    camera.shift[2], camera.blur[0], camera.scale[1] = (0.1, 0.3), 1.5, 1e-4
    again = ChannelCamera.of_record(camera.record, 512)
    assert again.record == camera.record and again.pixels == 512
    np.testing.assert_allclose(camera.blur_at(256), [0.75, 0, 0])


class Operations(TorchDispatchMode):
    """Counts what a GPU would be given to do, and how often the host would wait for it."""

    VIEWS = (
        "view",
        "select",
        "slice",
        "expand",
        "unsqueeze",
        "transpose",
        "diagonal",
        "unbind",
        "_unsafe_view",
        "detach",
    )

    def __init__(self):
        super().__init__()
        self.names = []

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        self.names.append(function.overloadpacket.__name__)
        return function(*args, **(kwargs or {}))

    @property
    def work(self):
        return sum(name not in self.VIEWS for name in self.names)


def test_the_host_seldom_waits_and_is_not_waited_for(monkeypatch):
    """465 operations and 31 waits once took 40 ms on a GPU, whose own work is a few; here three turns are made."""
    measured = stacked(lines(RED, blur=1), lines(blur=1), lines(BLUE, blur=1)) + noise(3, PIXELS, PIXELS)
    found(measured, CLEAN)  # what is computed once for a size
    waits = []
    for name in ("cpu", "tolist", "numpy"):
        kept = getattr(torch.Tensor, name)
        monkeypatch.setattr(torch.Tensor, name, lambda tensor, kept=kept, name=name: waits.append(name) or kept(tensor))
    with Operations() as counted:
        found(measured, CLEAN)
    assert counted.work < 360
    waits = [name for name in waits if name != "numpy"] + [n for n in counted.names if n == "_local_scalar_dense"]
    assert len(waits) <= 8 and "_linalg_check_errors" not in counted.names


def test_spectra_by_rings_are_the_same_every_time_and_those_of_a_plain_sum():
    """Oracle: each frequency added to its ring, one after the other."""
    from warp_caustics.reconstruct.seen_camera.blur_estimate import RINGS, _ring_spectra

    rng = np.random.default_rng(5)
    measured, simulated = torch.fft.rfft2(torch.tensor(rng.standard_normal((2, 3, 48, 48)), dtype=torch.float32))
    pairs = [(0, 1), (0, 2), (1, 2)]
    spectra, simulations, powers, rings = _ring_spectra(measured, simulated, pairs)
    count = min(RINGS, 48 // 4)
    sums, modes = np.zeros((9, count + 1)), np.zeros(count + 1)
    for row, ky in enumerate(np.fft.fftfreq(48)):
        for column, kx in enumerate(np.fft.rfftfreq(48)):
            ring = min(int(2 * count * np.hypot(kx, ky) + 1e-6), count)
            weight = 1 if column == 0 else 2
            a, b = measured[:, row, column].numpy(), simulated[:, row, column].numpy()
            crossed = [(x[i] * x[j].conj()).real for x in (a, b) for i, j in pairs]
            sums[:, ring] += weight * np.array([*crossed, *np.abs(a) ** 2])
            modes[ring] += weight
    means = (sums / modes)[:, 1:count]
    np.testing.assert_array_equal(rings.modes, modes[1:count])
    np.testing.assert_allclose(np.concatenate((spectra, simulations, powers)), means, rtol=1e-5, atol=1e-3)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.parametrize("has_gaps", [False, True])
def test_a_gpu_finds_the_same_camera(has_gaps):
    measured = stacked(lines(RED, blur=1), lines(blur=1), lines(BLUE, blur=1)) + noise(3, PIXELS, PIXELS)
    weight = torch.ones_like(measured)
    if has_gaps:
        weight[:, 40, 50:52] = 0
    here = found(measured, CLEAN, weight)
    there = found(measured.cuda(), CLEAN.cuda(), weight.cuda())
    for name in ("shift", "scale", "blur", "gain", "ambient"):
        np.testing.assert_allclose(getattr(there, name), getattr(here, name), atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_where_noise_hides_the_picture_channels_are_not_moved_far(seed):
    """The highest of many peaks of noise is no place."""
    faint = 1 + 1e-2 * (CLEAN - 1)
    camera = found(faint + noise(3, PIXELS, PIXELS, std=0.05, seed=seed), 1 + 0.3 * (faint - 1))
    assert np.abs(camera.shift).max() < 0.6


def test_a_shift_of_pixels_is_found_in_ten_percent_of_noise():
    measured = stacked(lines((3.0, -5.0)), lines(), lines()) + noise(3, PIXELS, PIXELS, std=0.1)
    np.testing.assert_allclose(found(measured, CLEAN).shift, [[3.0, -5.0], [0, 0], [0, 0]], atol=0.1)
