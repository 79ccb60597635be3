"""Normal equations as a GPU makes them, here without one, against those by torch's operations one after the other."""

import numpy as np
import pytest
import torch

from warp_caustics.prints import fit_system as module
from warp_caustics.prints.fit import GEMAN_MCCLURE, fit_lines, normal_equations
from warp_caustics.prints.fit_each import _each_alone, fit_each
from warp_caustics.prints.fit_system import COUNTS, MOST_BYTES, fit_system
from warp_caustics.prints.line_shape import Shape
from warp_caustics.prints.model import LineModel
from warp_caustics.prints.overlap import share
from warp_caustics.scene import Scene

N = 48
SCENE = Scene(height_samples=N, image_pixels=N)
LINES = 1e-3 * torch.tensor(
    [
        [-15.0, -12.0, 14.0, 9.0, 4.0, 0.7],
        [-9.0, 12.0, 13.0, -11.0, 3.0, 0.4],
        [2.0, 15.0, 3.0, -15.0, 2.0, 0.9],
        [-14.0, 3.0, 16.0, 4.0, 3.5, 0.2],
        [8.0, 8.0, 8.5, 8.2, 2.5, 0.3],
    ],
    dtype=torch.float64,
)
NEAR = 1e-3 * torch.tensor([0.2, -0.1, -0.2, 0.1, -0.3, 0.05], dtype=torch.float64)
SHAPES = (
    Shape(),
    Shape(0.5, 0.3, 0.5),
    Shape(1.6, overlap=0.0),
    Shape(0.7, 1.0, thicker=0.3, end_m=2e-3),
    Shape(is_cap=True, overlap=0.2),
    Shape(5.0, 0.2, cut=0.08),
)


def on(device: str) -> LineModel:
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("needs a CUDA device")
    return LineModel(SCENE, device=device)


@pytest.fixture(autouse=True)
def everywhere(monkeypatch):
    monkeypatch.setattr(module, "DEVICES", ("cpu", "cuda"))


def assert_alike(found, expected, exact=2e-5):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=exact * float(np.abs(other).max()))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_lines_together(device, shape):
    """Over a line that does not move; more lines are told of than there are, and then others, as of another shape."""
    model = on(device)
    sigma = torch.full((N, N), 2e-5, device=model.device)
    sigma[:, N // 2 :] = 3e-4
    with fit_system(model, 4, is_each=False) as kept:
        for model.shape, lines in ((Shape(), LINES[:4]), (shape, LINES[:3]), (shape, LINES[1:4] + NEAR)):
            relief, printed = model.heights(lines + NEAR), model.heights(LINES[4:])

            def over_printed(rows, printed=printed):
                parts, derivatives = model.parts(rows)
                total = model.joined(torch.cat([printed[None], parts]))
                shares = shares_of(parts, total, model.shape.overlap)
                return total, (derivatives * shares[:, None]).flatten(0, 1)

            kept.about(relief, sigma, printed)
            expected = normal_equations(over_printed, relief, sigma, GEMAN_MCCLURE)(lines)
            for _ in range(3):  # launched, then recorded, then replayed
                assert_alike(kept(model, lines), expected)


def shares_of(parts, total, q):
    """Of sums, to which each line adds what it is, all."""
    return torch.ones_like(parts) if q == 1 else share(parts, total, q)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_each_line_for_itself(device, shape):
    model = on(device)
    model.shape = shape
    sigma, some = torch.full((N, N), 5e-5, device=model.device), torch.tensor([0, 2, 4])
    relief = model.heights(LINES[:1] + NEAR)
    beside = model.parts(LINES.flip(0))[0]
    for printed in (None, beside):
        expected = _each_alone(model, relief, sigma, printed)(LINES, some)
        with fit_system(model, len(LINES), is_each=True) as kept:
            kept.about(relief, sigma, printed)
            for _ in range(3):
                assert_alike([told[some] for told in kept(model, LINES)], expected)


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_fits_are_the_same(monkeypatch, device):
    """Of some lines among others, and of each for itself, to a hundredth of what is expected to be left."""
    model = on(device)
    relief, sigma = model.heights(LINES), torch.full((N, N), 2e-5, device=model.device)
    start, found = LINES + NEAR, []
    for devices in ((), ("cpu", "cuda")):
        monkeypatch.setattr(module, "DEVICES", devices)
        lines, loss = fit_lines(model, start, relief, sigma, iterations=20, only=[0, 2, 3])
        each, losses = fit_each(model, start, relief, sigma, iterations=12, printed_m=model.parts(start)[0].flip(0))
        found.append((lines, torch.tensor([loss]), each, losses))
    assert bool((found[0][0][[1, 4]] == start[[1, 4]]).all())
    for one, other, most in zip(found[1], found[0], (2e-7, 1.0, 2e-7, 1.0), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=most)


def test_a_system_is_in_one_pair_of_hands():
    """And is used again; those that take too much memory are not made."""
    model = on("cpu")
    with fit_system(model, 5, is_each=False) as one, fit_system(model, 6, is_each=False) as other:
        assert one is not other and one.count == other.count == 6
    with fit_system(model, 6, is_each=False) as again:
        assert again is one or again is other
    large = LineModel(Scene(height_samples=1024, image_pixels=N))
    assert 64 * (COUNTS[-1] + 1) * 1024**2 > MOST_BYTES
    for count, of in ((COUNTS[-1], large), (COUNTS[-1] + 1, model)):
        with fit_system(of, count, is_each=False) as none:
            assert none is None


def test_no_more_is_kept_than_there_is_room_for(monkeypatch):
    model, kept = on("cpu"), module._UNUSED
    monkeypatch.setattr(module, "_UNUSED", type(kept)(list))
    with fit_system(model, 5, is_each=False) as small, fit_system(model, 5, is_each=True) as other:
        assert 2 * 7 * 6 * N * N * 4 < small.bytes < 2 * 8 * 8 * N * N * 4
    with fit_system(model, 5, is_each=True) as again:
        assert again is other
    monkeypatch.setattr(module, "KEPT_BYTES", small.bytes + other.bytes - 1)
    with fit_system(model, 5, is_each=False) as again:
        assert again is small
    with fit_system(model, 5, is_each=True) as new:
        assert new is not other
