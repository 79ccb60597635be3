"""The bench comes back from captures of known plates, and is as sure as it says."""

import numpy as np
import torch

from warp_caustics.calibration.calibrate import calibrate
from warp_caustics.calibration.plates import DESIGN, TOLERANCES, KnownPlate
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.setup.set_up import SetUp

from .conftest import CAMERA, PHOTONS, SCENE, capture, drawn_bench

FREE = ("gap_m", "tilt_x_rad", "lamp_half_angle_rad", "shift_x_px", "shift_y_px", "magnification", "psf_px", "ambient")


def printed(seed=0, lines=6):
    generator = np.random.default_rng(seed)
    drawn = [
        Line(tuple(generator.uniform(-0.02, 0.02, 2)), tuple(generator.uniform(-0.02, 0.02, 2)), 6e-3, 4e-4)
        for _ in range(lines)
    ]

    def relief(factor, n, size):
        wider = [Line(line.start_m, line.end_m, line.width_m * factor, line.height_m) for line in drawn]
        return line_relief(wider, n, size)

    return KnownPlate(DESIGN, "print", lambda n, size: relief(1.0, n, size), TOLERANCES[DESIGN], relief)


def test_sigma_covers_over_random_benches():
    """Benches, prints and noise drawn at random; nothing but the model's own numbers is told."""
    setup = SetUp.of(SCENE, CAMERA, FREE)
    scores = []
    for seed in range(50):
        scene, camera, theta = drawn_bench(setup, seed)
        plate = printed(seed)
        generator = np.random.default_rng(1000 + seed)
        modes = [generator.normal(0, p.prior) for p in plate.parameters]
        view = capture(scene, camera, plate, 0.01, seed, modes=modes)
        found = calibrate(SCENE, CAMERA, [view], free=FREE, border_px=3, photons=PHOTONS)
        sigma = torch.tensor([f.sigma for f in found.bench])
        scores.append((found.theta - theta) / sigma)
    scores = torch.stack(scores)
    print((scores.abs() < 1).double().mean(0), scores.std(0), scores.mean(0), setup.names)
    within = float((scores.abs() < 1).double().mean())
    assert 0.58 < within < 0.78, f"{within:.2f} of the values are within one sigma"
    assert float((scores.abs() < 2).double().mean()) > 0.9
