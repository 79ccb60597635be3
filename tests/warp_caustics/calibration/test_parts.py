"""Parts of a calibration against closed forms: plates, coordinates, the descent, noise, spread, files."""

import math

import numpy as np
import pytest
import torch

from warp_caustics.calibration.coordinates import Coordinates
from warp_caustics.calibration.least_squares import HUBER, Normal, huber, minimised
from warp_caustics.calibration.noise_model import fitted_variance, terms
from warp_caustics.calibration.plate_file import read_plate
from warp_caustics.calibration.plates import lens, wedge
from warp_caustics.calibration.posterior import posterior
from warp_caustics.calibration.registration import displacement_px
from warp_caustics.calibration.view import enlarged_camera, factors
from warp_caustics.camera.config import CameraConfig
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.setup.parameter import Parameter

SCENE = Scene(height_samples=64, image_pixels=64)


def test_a_lens_is_a_sphere_and_a_wedge_a_plane():
    heights, _ = lens(0.1, 0.03).surface(SCENE)
    place = (np.arange(64) + 0.5) / 64 * 0.05 - 0.025
    sag = math.sqrt(0.1**2 - place[32] ** 2 * 2) - math.sqrt(0.1**2 - 0.015**2)
    assert float(heights[32, 32]) == pytest.approx(sag, rel=1e-12) and float(heights[0, 0]) == 0
    heights, _ = wedge(0.02, math.pi / 2).surface(SCENE)
    assert torch.allclose(torch.diff(heights, dim=0), torch.full((63, 64), math.tan(0.02) * 0.05 / 64).double())
    assert float(heights.min()) >= 0


def test_modes_are_derivatives_of_the_relief():
    """A plate that lies elsewhere is h(x - s): the mode is minus the slope; turned, the product with the radius."""
    plate = lens(0.1, 0.04, (2e-3, -3e-3))
    _, modes = plate.surface(SCENE)
    by_name = dict(zip([p.name for p in plate.parameters], modes, strict=True))
    step = 1e-5
    ahead, _ = lens(0.1, 0.04, (2e-3 + step, -3e-3)).surface(SCENE)
    behind, _ = lens(0.1, 0.04, (2e-3 - step, -3e-3)).surface(SCENE)
    change = (ahead - behind) / (2 * step)
    inner = (slice(20, 44), slice(20, 44))
    assert torch.allclose(by_name["shift_x_m"][inner], change[inner], atol=1e-4)
    turned = plate.with_tolerances({"turn_rad": 1e-3})
    _, modes = turned.surface(SCENE)
    x = (torch.arange(64, dtype=torch.float64) + 0.5) / 64 * 0.05 - 0.025
    slope_x, slope_y = -by_name["shift_x_m"], -by_name["shift_y_m"]
    assert torch.allclose(modes[-1], slope_x * x[:, None] - slope_y * x[None, :])


def test_plates_from_files(tmp_path):
    path = tmp_path / "plate.yaml"
    path.write_text("kind: lens\nfocal_length_m: 200mm\nindex: 1.5\ndiameter_m: 30mm\n")
    same = lens(0.1, 0.03).relief(16, (0.05, 0.05))
    assert np.allclose(read_plate(path).relief(16, (0.05, 0.05)), same)
    np.save(tmp_path / "map.npy", same)
    assert np.allclose(read_plate(tmp_path / "map.npy").relief(16, (0.05, 0.05)), same)
    lines = tmp_path / "lines.csv"
    lines.write_text("start_x_mm,start_y_mm,end_x_mm,end_y_mm,width_mm,height_mm\n-10,0,10,0,4,0.2\n")
    printed = read_plate(lines)
    _, modes = printed.surface(SCENE)
    wider = dict(zip([p.name for p in printed.parameters], modes, strict=True))["width_scale"]
    assert float(wider[32, 32]) < float(wider[34, 32])  # a crown keeps its height, flanks rise
    path.write_text("kind: lens\nradius_m: 10mm\ndiameter_m: 30mm\n")
    with pytest.raises(InputError, match="has no rim of 30 mm"):
        read_plate(path)
    path.write_text("kind: wedge\n")
    with pytest.raises(InputError, match="write angle_deg"):
        read_plate(path)
    with pytest.raises(InputError, match="tolerance 'width_scale' is none of lens"):
        lens(0.1, 0.03).with_tolerances({"width_scale": 0.1})


def test_coordinates_of_squares():
    """u = v^2: there and back, its derivative, and what is left of a deviation at 0."""
    blur = Parameter("psf", "s", "px", 0.0, 10.0, 0.4, "camera", "", is_squared=True)
    gap = Parameter("gap", "g", "m", 0.0, 1.0, 1e-4, "screen", "")
    coordinates = Coordinates.of([blur, gap], torch.tensor([0.5, 1e-3]))
    values = torch.tensor([0.9, 1.2e-3], dtype=torch.float64)
    assert torch.allclose(coordinates.values(coordinates.to(values)), values)
    assert float(coordinates.to(values)[1]) == pytest.approx(2.0)
    width = math.sqrt(4 * 0.25 * 0.16 + 2 * 0.4**4)
    assert float(coordinates.widths[0]) == pytest.approx(width)
    small = coordinates.deviations(coordinates.to(values), torch.tensor([0.01, 0.5], dtype=torch.float64))
    assert small.tolist() == pytest.approx([0.01 * width / 1.8, 5e-5])
    none = coordinates.deviations(coordinates.low, torch.tensor([0.1, 0.1], dtype=torch.float64))
    assert float(none[0]) == pytest.approx(math.sqrt(0.1 * width))


class Line:
    """Data y = a x + b with noise of 1, as a problem."""

    def __init__(self, x, y):
        self.columns, self.y = torch.stack((x, torch.ones_like(x))), y

    def cost(self, x):
        return float(huber(x @ self.columns - self.y)[0].sum())

    def normal(self, x):
        residual = x @ self.columns - self.y
        rho, weight = huber(residual)
        weighted = self.columns * weight
        return Normal(float(rho.sum()), weighted @ self.columns.T, weighted @ residual)


def test_the_descent_is_the_posterior_of_a_straight_line():
    """Linear and without outliers the answer is (J^T J + 1)^-1 J^T y; an outlier pulls by at most its limit."""
    place = torch.linspace(-1, 1, 101, dtype=torch.float64)
    y = 0.7 * place - 0.2
    wide = torch.full((2,), 100.0, dtype=torch.float64)
    problem = Line(place, y)
    found = minimised(problem, torch.zeros(2), -wide, wide)
    exact = torch.linalg.solve(problem.columns @ problem.columns.T + torch.eye(2), problem.columns @ y)
    assert torch.allclose(found.x, exact, atol=2e-2) and found.is_converged
    held = minimised(problem, torch.zeros(2), torch.zeros(2).double(), wide)
    assert float(held.x[1]) == 0 and bool(held.is_held[1]) and not bool(held.is_held[0])
    spoiled = y.clone()
    spoiled[50] = 1e6
    pulled = minimised(Line(place, spoiled), torch.zeros(2), -wide, wide, iterations=40)
    assert float((pulled.x - found.x).abs().max()) < 2 * HUBER / 100


def test_noise_is_read_from_residuals():
    """Reading and shot noise of known size come back; dust does not count."""
    generator = np.random.default_rng(1)
    light = torch.as_tensor(generator.uniform(0.2, 6, (1, 96, 96)))
    noise, level = torch.tensor([0.02], dtype=torch.float64), torch.ones(1, dtype=torch.float64)
    parts = terms(light, noise, level)
    true = 0.5 * parts[0] + 2.0 * parts[1]
    drawn = torch.as_tensor(generator.standard_normal((1, 96, 96))) * true.sqrt()
    drawn[0, ::17, ::13] = 3.0
    found = fitted_variance(parts, drawn, torch.ones_like(drawn, dtype=torch.bool))
    assert float((found / true).log().abs().mean()) < 0.08


def test_spread_grows_with_what_parts_disagree_by():
    """Scores with twice the spread of noise double the deviation; a finer simulation that moves by d adds d^2."""
    generator = torch.Generator().manual_seed(0)
    information = torch.diag(torch.tensor([401.0, 101.0], dtype=torch.float64))
    root = torch.tensor([20.0, 10.0], dtype=torch.float64) / 20
    scores = torch.randn(400, 2, generator=generator, dtype=torch.float64) * root * 2
    found = posterior(information, scores, torch.zeros(2, dtype=torch.float64))
    assert found.inflation.tolist() == pytest.approx([2.0, 2.0], rel=0.1)
    moved = posterior(information, scores / 4, torch.tensor([401.0, 0.0], dtype=torch.float64))
    assert moved.inflation.tolist() == [1.0, 1.0] and moved.numerical.tolist() == pytest.approx([1.0, 0.0])
    assert float(moved.covariance[0, 0]) == pytest.approx(1 + 1 / 401)


def test_whole_displacements_are_found():
    """Of a pattern moved by whole and half pixels."""
    place = torch.arange(64, dtype=torch.float64)
    x, y = torch.meshgrid(place, place, indexing="xy")

    def spots(dx, dy):
        return sum(torch.exp(-((x - a - dx) ** 2 + (y - b - dy) ** 2) / 8) for a, b in ((20, 30), (40, 25), (33, 45)))[
            None
        ]

    counts = torch.ones(1, 64, 64, dtype=torch.bool)
    found = displacement_px(spots(3.5, -2.0), spots(0.0, 0.0), counts)
    assert found == pytest.approx((3.5, -2.0), abs=0.1)


def test_levels_and_larger_pixels():
    assert factors(512, 256) == (8, 4, 2) and factors(40, 256) == (1,) and factors(64, 256) == (2, 1)
    camera = enlarged_camera(CameraConfig(psf_px=(0.8, 0.6), shift_px=(2, -1), magnification=1.01), 2)
    assert camera.psf_px == (0.4, 0.3) and camera.shift_px == (1, -0.5) and camera.magnification == 1.01
