"""The misfit of lines to an image, its derivatives, descents and jumps."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nets.reconstruct.fibres.image.descent import Beside
from nets.reconstruct.fibres.image.image_fit import ImageFit, reliefs_at_once
from nets.reconstruct.fibres.image.one_wavelength import clearest_wavelength, of_wavelength
from nets.reconstruct.fibres.search.moves import jump, shapes, stretches, suspects
from tests.nets.reconstruct.cameras import blurring
from tests.nets.reconstruct.fibres.three_lines import LINES, SCENE, N, error_um, noisy_image
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator


@pytest.fixture(scope="module")
def model():
    return LineModel(SCENE)


@pytest.fixture(scope="module")
def image(model):
    return noisy_image(model)


def test_gradient_with_respect_to_lines(model, image):
    """Along a random direction, against central differences."""
    model = LineModel(SCENE, supersampling=8)
    fit = ImageFit(SCENE, image, model, 2 * N)
    off = LINES + 1e-4
    parts, derivatives = model.parts(off)
    _, gradient, _ = fit.with_gradient(parts.sum(0))
    direction = torch.randn(off.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    slope = float((derivatives.flatten(2) @ gradient.flatten()).double().flatten() @ direction.flatten())
    step = 1e-6
    ahead, behind = (fit.loss(model.heights(off + s * step * direction)) for s in (1, -1))
    assert slope == pytest.approx((ahead - behind) / (2 * step), rel=0.05)


@pytest.mark.parametrize("blur_px", [0.0, np.array([0.4, 0.8, 1.2])])
def test_gradient_that_a_gpu_records_is_the_same(model, image, blur_px):
    """Through the camera's blur, too, of one fit's own image; also where that is told another one afterwards."""
    fit = ImageFit(SCENE, image, model, 2 * N, width=0.1, camera=blurring(blur_px, SCENE.image_pixels))
    heights, values = model.heights(LINES + 1e-4), []
    for _ in range(2):
        value, gradient, _ = fit.with_gradient(heights)
        recorded = fit._gradient(heights)
        assert float(recorded.value) == pytest.approx(value, rel=1e-6)
        assert float((recorded.gradient - gradient).abs().max()) < 1e-5 * float(gradient.abs().max())
        values.append(value)
        fit.correct_at(heights)
    assert abs(values[0] - values[1]) > 1e-5 * values[0]


def test_metric_is_the_curvature_of_the_misfit(model, image):
    """Along a random direction, at lines that explain the image: u N u / 2 of what a small step costs."""
    seen = CausticImage(CausticSimulator(SCENE)(model.heights(LINES)).numpy())
    fit = ImageFit(SCENE, seen, model, 2 * N)
    heights, derivatives = model.with_jacobian(LINES)
    normal = fit.normal_matrix(heights, derivatives)
    assert torch.allclose(normal, normal.T, rtol=1e-4) and float(torch.linalg.eigvalsh(normal)[0]) > -1e-3 * float(
        normal.diagonal().max()
    )
    step = 1e-6 * torch.randn(LINES.numel(), generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    either = [model.heights(model.clamped(LINES + sign * step.reshape(LINES.shape))) for sign in (1, -1)]
    cost = sum(fit.losses(torch.stack(either))) / 2 - fit.loss(heights)
    assert cost == pytest.approx(float(step @ normal @ step) / 2, rel=0.15)


def test_misfits_of_a_batch_are_those_of_each(model, image):
    fit = ImageFit(SCENE, image, model, 2 * N)
    both = torch.stack([model.heights(LINES), model.heights(LINES[:2])])
    singly = [float(fit.measurement.data_term(fit.simulator(each), "charbonnier", fit.width)) for each in both]
    np.testing.assert_allclose(fit.losses(both), singly, rtol=1e-6)


@pytest.mark.parametrize("blur_px", [0.0, 0.7])
def test_misfits_beside_a_relief_are_those_of_whole_images(model, image, blur_px):
    """Where reliefs differ from it in places, of which light a CPU traces no more; through the camera's blur, too."""
    fit = ImageFit(SCENE, image, model, 2 * N, camera=blurring(blur_px, SCENE.image_pixels))
    assert fit.simulator.traces_changes
    tried = torch.stack(list(shapes(LINES[2])))
    reliefs = model.with_each(LINES[:2], model.clamped(tried))
    whole, apart = np.array(fit.losses(reliefs)), np.ptp(fit.losses(reliefs))
    assert fit.losses_with_each(LINES[:2], model.clamped(tried)) == pytest.approx(whole, abs=1e-3 * apart)
    assert fit.losses(reliefs, model.heights(LINES)) == pytest.approx(whole, abs=1e-3 * apart)


def test_one_wavelength_is_that_which_shows_most(image):
    """Masked pixels count most, then noise; a dark wavelength shows nothing."""
    assert clearest_wavelength(CausticImage(image.irradiance), SCENE) == 1
    assert clearest_wavelength(CausticImage(image.irradiance, np.array([0.01, 0.02, 0.02])), SCENE) == 0
    mask = np.ones(image.irradiance.shape, bool)
    mask[:2, :40] = False
    assert clearest_wavelength(CausticImage(image.irradiance, np.array([0.01, 0.01, 0.02]), mask), SCENE) == 2
    dark = SCENE.model_copy(update={"radiosity_W_m2": (1.0, 0.0, 1.0)})
    assert clearest_wavelength(image, dark) in (0, 2)
    one, scene = of_wavelength(CausticImage(image.irradiance, image.noise_std, mask), SCENE, 2)
    assert one.irradiance.shape[0] == scene.n_wavelengths == 1 and scene.wavelengths_m == SCENE.wavelengths_m[2:]
    np.testing.assert_array_equal(one.irradiance[0], image.irradiance[2])
    assert one.mask.all() and one.noise_std[0] == image.noise_std[2]


def test_descent_finds_the_lines_from_near(model, image):
    shift = 1e-3 * torch.tensor([0.3, -0.2, -0.2, 0.3, 0.2, -0.05], dtype=torch.float64)
    fit = ImageFit(SCENE, image, model, 2 * N)
    start = LINES + shift
    fit.correct_at(model.heights(start))
    found = fit.descend(start, 40)
    assert error_um(model, start) > 20 and error_um(model, found.lines) < 1.0
    assert found.loss <= fit.loss(model.heights(LINES)) * 1.01
    again = fit.descend(LINES[:0], 5)
    assert len(again.lines) == 0 and again.loss > found.loss


@pytest.mark.parametrize("missing_m", [8e-3, 2e-4])
def test_a_short_line_jumps_to_its_length(model, image, missing_m):
    """What descent does not: the last 8 mm of a line are missing; and an eighth of a sample."""
    short = LINES.clone()
    along = (short[0, 2:4] - short[0, :2]) / (short[0, 2:4] - short[0, :2]).norm()
    short[0, 2:4] -= missing_m * along
    fit = ImageFit(SCENE, image, model, 2 * N)
    moved, has_jumped = jump(fit, short)
    assert has_jumped and error_um(model, moved) < 0.3 * error_um(model, short)
    if missing_m > 1e-3:
        assert suspects(fit, model, short)[0] == 0
    right, jumped_again = jump(fit, LINES)
    assert not jumped_again and torch.equal(right, LINES)


def test_jumps_change_one_thing_at_a_time():
    line = LINES[0]
    length = float((line[2:4] - line[:2]).norm())
    for changed, end, change in stretches(line):
        kept = [2, 3] if end == 0 else [0, 1]
        assert torch.equal(changed[kept], line[kept]) and torch.equal(changed[4:], line[4:])
        assert float((changed[2:4] - changed[:2]).norm()) == pytest.approx(length + change)
    reshaped = torch.stack(list(shapes(line)))
    assert torch.equal(reshaped[:, :4], line[:4].expand(6, 4)) and (reshaped[:, 4:] != line[4:]).any(1).all()
    dot = 1e-3 * torch.tensor([1.0, 1.0, 1.0, 1.0, 1.0, 1.0], dtype=torch.float64)
    assert all(change > 0 and changed.isfinite().all() for changed, _, change in stretches(dot))


def test_the_lattice_is_no_part_of_what_lines_are_asked_to_explain(model):
    """True lines leave less of an image of many photons once the lattice's error is taken off, and stay where they are."""
    many = CausticSimulator(SCENE, "lattice", n_photons=128 * SCENE.image_pixels**2)
    fit = ImageFit(SCENE, CausticImage(many(model.heights(LINES)).numpy()), model, 4 * N, photons_per_pixel=8)
    measured, plain = fit.measurement.irradiance.clone(), fit.loss(model.heights(LINES))
    wrong = error_um(model, fit.descend(LINES, 15).lines)
    fit.correct_at(model.heights(LINES))
    assert fit.loss(model.heights(LINES)) < 0.1 * plain
    assert error_um(model, fit.descend(LINES, 15).lines) < 0.5 * wrong
    # Told again, it is the error there, not the sum of both.
    fit.correct_at(model.heights(LINES + 1e-3))
    fit.correct_at(model.heights(LINES))
    missing = measured - fit.measurement.irradiance
    assert float((missing - fit.missing).abs().max()) < 1e-5


def test_a_metric_does_not_mix_what_a_mirrored_image_keeps_apart():
    """Beside a bench: of a line in the middle that moves sideways and grows, odd and even, nothing is in common.

    By differences to one side 0.31 was, which looked as if an image told more of both.
    """
    scene = Scene(height_samples=64, image_pixels=256)
    model = LineModel(scene)
    line = torch.tensor([[0.0, -0.012, 0.0, 0.012, 3e-3, 8e-4]], dtype=torch.float64)
    heights, derivatives = model.with_jacobian(line)
    seen = CausticImage(CausticSimulator(scene)(heights).numpy())
    fit = ImageFit(scene, seen, model, 256, camera=blurring(0.7, 256))
    sideways = derivatives[0] + derivatives[2]
    beside = Beside(torch.zeros(1, 3, 256, 256), np.zeros(1), 1.0)
    normal = fit.normal_matrix(heights, torch.stack([sideways, derivatives[5]]), beside)
    assert abs(float(normal[0, 1])) < 0.01 * float((normal[0, 0] * normal[1, 1]).sqrt())


def test_a_small_gpu_simulates_fewer_reliefs_at_once(monkeypatch):
    """Of 512 pixels and three wavelengths: as many as launches are worth, or as there is memory for."""
    image = 3 * 512**2
    assert reliefs_at_once(torch.device("cpu"), 128, image) == 16
    for memory_gib, most in ((80, 256), (8, 42), (0.1, 1)):
        card = SimpleNamespace(total_memory=int(memory_gib * 2**30))
        monkeypatch.setattr(torch.cuda, "get_device_properties", lambda device, card=card: card)
        assert reliefs_at_once(torch.device("cuda"), 128, image) == most
