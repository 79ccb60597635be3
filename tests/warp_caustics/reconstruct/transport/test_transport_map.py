"""Optimal transport on a grid against maps that are known in closed form."""

import numpy as np
import pytest
import torch

from warp_caustics.errors import InputError
from warp_caustics.reconstruct.transport.transport_map import c_transform, mass_error, optimal_transport, push_forward

N = 64


def grid(cells=N):
    """(x, y) of the cell centres [px], shape [2, N, N]."""
    centres = torch.arange(cells, dtype=torch.float64) + 0.5
    return torch.stack(torch.meshgrid(centres, centres, indexing="xy"))


def blob(x, y, sigma, cells=N):
    """A round heap of light on black."""
    position = grid(cells)
    squared = ((position[0] - x) ** 2 + (position[1] - y) ** 2) / sigma**2
    return torch.exp(-squared / 2) * (squared < 9)


def test_c_transform_of_a_parabola():
    """min_y |x - y|^2 / 2 - a |y|^2 / 2 is -a / (1 - a) |x|^2 / 2, also between the grid points."""
    a = 0.3
    centred = grid() - N / 2
    squared = (centred**2).sum(0)
    found = c_transform(a * squared / 2, 20)
    inner = slice(12, -12)
    torch.testing.assert_close(found[inner, inner], (-a / (1 - a) * squared / 2)[inner, inner], rtol=1e-9, atol=1e-9)


def test_c_transform_is_a_lower_envelope():
    """phi + phi^c never exceeds the cost, for any phi; the refinement stays below the samples."""
    phi = torch.from_numpy(np.random.default_rng(0).normal(size=(12, 12)))
    psi = c_transform(phi, 11)
    position = grid(12).reshape(2, -1)
    cost = ((position[:, :, None] - position[:, None, :]) ** 2).sum(0) / 2
    assert float((phi.ravel()[:, None] + psi.ravel()[None, :] - cost).max()) < 1e-12


def test_pushing_conserves_mass_and_compresses():
    """x -> c + (x - c) / 2 makes the middle four times as bright and leaves the outside dark."""
    centred = grid() - N / 2
    pushed = push_forward(torch.ones(N, N, dtype=torch.float64), (centred**2).sum(0) / 4)
    assert float(pushed.sum()) == pytest.approx(N * N, rel=1e-12)
    torch.testing.assert_close(pushed[20:44, 20:44], torch.full((24, 24), 4.0, dtype=torch.float64), rtol=0.05, atol=0)
    # Cells at the edge are held there, so a little light stays behind.
    assert float(pushed[1:14, 1:14].sum()) < 1


@pytest.mark.parametrize(("shift_x", "shift_y"), [(5.3, 0.0), (-4.0, 7.6)])
def test_a_shifted_heap_is_shifted(shift_x, shift_y):
    source = blob(30, 30, 5)
    found = optimal_transport(source, blob(30 + shift_x, 30 + shift_y, 5))
    error = (found.displacement_px - torch.tensor([shift_x, shift_y])[:, None, None])[:, source > 0.2]
    assert found.mass_error < 0.025
    assert float(error.abs().max()) < 0.4 and float(error.square().mean().sqrt()) < 0.12


def test_a_wider_heap_is_a_scaling():
    """A heap 1.5 times as wide: T(x) - x = (x - c) / 2."""
    source = blob(32, 32, 5)
    found = optimal_transport(source, blob(32, 32, 7.5) / 2.25)
    error = (found.displacement_px - (grid() - 32) / 2)[:, source > 0.2]
    assert found.mass_error < 0.035
    assert float(error.abs().max()) < 0.25 and float(error.square().mean().sqrt()) < 0.06


def test_uniform_light_to_a_wave():
    """In one dimension T is the inverse of the distribution function of the target."""
    u = (torch.arange(N, dtype=torch.float64) + 0.5) / N
    contrast = 0.8

    def below(t):
        return t + contrast * torch.sin(2 * np.pi * t) / (2 * np.pi)

    edges = torch.arange(N + 1, dtype=torch.float64) / N
    target = (below(edges).diff() * N).expand(N, N).contiguous()
    found = optimal_transport(torch.ones(N, N, dtype=torch.float64), target, tolerance=1e-3)
    landed = u + found.displacement_px[0] / N
    assert float((below(landed) - u).abs().max()) < 0.1 / N
    assert float(found.displacement_px[1].abs().max()) < 1e-3
    assert found.mass_error < 5e-3


def test_equal_densities_stay_where_they_are():
    density = 1 + 3 * blob(20, 40, 6)
    found = optimal_transport(density, 2 * density)
    assert float(found.displacement_px.abs().max()) < 1e-3
    assert found.mass_error < 1e-3


def test_mass_error_of_a_known_case():
    """Uniform light left alone while all of it should be in one half: half of it is in the wrong place."""
    uniform, half = torch.ones(N, N, dtype=torch.float64), torch.zeros(N, N, dtype=torch.float64)
    half[:, : N // 2] = 2
    assert mass_error(uniform, half, torch.zeros_like(half)) == pytest.approx(0.5, abs=1e-12)
    squeezed = grid()[0] ** 2 / 4  # x -> x / 2, but for the last column, which is held at the edge
    assert 0 < mass_error(uniform, half, squeezed) < 2 / N


def test_light_on_black_lines_is_reached_by_lowering_the_floor():
    """Two lines, ten times as bright as the mean, on black; Newton's method from zero does not solve such a case.

    What is left is the half pixel to which a grid knows the edges of the lines.
    """
    target = torch.zeros(128, 128, dtype=torch.float64)
    target[:, 20:26] = 1
    target[80:88, :] = 1
    uniform = torch.ones_like(target)
    found = optimal_transport(uniform, target)
    assert found.mass_error < 0.16 < 0.8 < mass_error(uniform, target / target.mean(), torch.zeros_like(target))
    near = torch.nn.functional.max_pool2d(target[None, None], 5, stride=1, padding=2)[0, 0] > 0
    landed = torch.stack([grid(128)[axis] + found.displacement_px[axis] for axis in (0, 1)]).floor().long()
    landed = landed.clamp(0, 127)
    assert float(near.double().mean()) < 0.25
    assert float(near[landed[1], landed[0]].double().mean()) > 0.93


def test_interruption_returns_the_best_map_so_far():
    """Ctrl-C in the first grid: the map has the full size and is better than none."""
    source, target = torch.ones(N, N, dtype=torch.float64), 1 + 5 * blob(20, 40, 8)
    seen = []

    def interrupt(stage, error):
        seen.append(error)
        if len(seen) == 4:
            raise KeyboardInterrupt

    found = optimal_transport(source, target, report=interrupt)
    assert found.stop is not None and len(seen) == 4 == found.steps
    assert found.displacement_px.shape == (2, N, N)
    target = target / target.mean()
    assert found.mass_error < mass_error(source, target, torch.zeros_like(source))


ONES = torch.ones(8, 8, dtype=torch.float64)


@pytest.mark.parametrize(
    ("source", "target", "words"),
    [
        (ONES, ONES[:4, :4], r"\[8, 8\].*\[4, 4\]"),
        (ONES[:4], ONES, "square"),
        (ONES, -ONES, "-1"),
        (0 * ONES, ONES, "source"),
        (ONES, ONES * float("nan"), "not finite"),
    ],
)
def test_bad_densities_are_refused(source, target, words):
    with pytest.raises(InputError, match=words):
        optimal_transport(source, target)
