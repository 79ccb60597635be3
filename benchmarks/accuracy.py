"""How exact the simulator and its gradient are, and what refine recovers: prints one table.

Reference data: tests/data (another renderer). About three minutes on two CPU cores.

    python -m benchmarks.accuracy [--device cuda] [--without-refine]
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp
from scipy.ndimage import gaussian_filter

from nets.reconstruct.methods import create
from warp_caustics import CausticSimulator, Scene
from warp_caustics.energy import energy_budget
from warp_caustics.kernels.trace import FATE_NAMES
from warp_caustics.metrics import height_errors
from warp_caustics.oracle import oracle_image
from warp_caustics.photons import Chunk
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.tape import simulate_on_tape

DATA = Path(__file__).parents[1] / "tests" / "data"
CONTACT = Scene(exit_medium="glass")
TINY = {
    "contact": Scene(height_samples=10, image_pixels=20, exit_medium="glass"),
    "far, air": Scene(height_samples=10, image_pixels=20, screen_position_m=(1e-3, -2e-3, -0.02)),
    "point light": Scene(
        height_samples=10,
        image_pixels=20,
        screen_position_m=(0, 0, -5e-3),
        light_position_m=(4e-3, 2e-3, 0.1),
        emission_half_angle_rad=0.9,
    ),
}


def row(name: str, value: str) -> None:
    print(f"{name:<62} {value}", flush=True)


def heights_of(case: str) -> np.ndarray:
    heights: np.ndarray = np.load(DATA / f"{case}_trace.npz")["heights_m"]
    return heights


def blurred_error(image: np.ndarray, reference: np.ndarray) -> float:
    """M: relative RMSE, both blurred by a Gaussian of 1 px, 12 border pixels left out."""
    a, b = (np.stack([gaussian_filter(c.astype(float), 1)[12:-12, 12:-12] for c in x]) for x in (image, reference))
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


def ray_trace(device: str) -> None:
    for case in ("a_flat", "b_wedge", "c_cosine", "d_gauss", "f_lines"):
        trace = np.load(DATA / f"{case}_trace.npz")
        simulator = CausticSimulator(
            CONTACT, placement="random", n_photons=trace["x"].size, dtype=torch.float64, device=device
        )
        engine = simulator.engine
        positions = torch.from_numpy(np.stack([trace["x"].ravel(), trace["y"].ravel()], axis=1)).to(device)
        coefficients = engine.coefficients(torch.from_numpy(heights_of(case)[None]).to(device))
        maps = engine.maps(coefficients, Chunk(0, len(positions)), positions)
        landings = engine.land(maps, positions)[0][0].cpu().numpy()
        metres = landings * CONTACT.pixel_size_m[0] - CONTACT.plate_size_m[0] / 2
        x, y = trace["X"].reshape(3, -1), trace["Y"].reshape(3, -1)
        distance = np.hypot(metres[:, 0] - x, metres[:, 1] - y).max()
        row(f"ray trace, {case}: largest distance of 3267 landings", f"{distance:.1e} m")


def images(device: str) -> None:
    for case in ("d_gauss", "f_lines"):
        reference = np.load(DATA / f"{case}_image.npz")["image"]
        heights = torch.from_numpy(heights_of(case)).float().to(device)
        for n_photons in (2**18, 2**20, 2**22):
            simulator = CausticSimulator(CONTACT, n_photons=n_photons, device=device)
            simulator(heights).cpu()
            started = time.perf_counter()
            image = simulator(heights).cpu().numpy()
            elapsed = time.perf_counter() - started
            error = blurred_error(image, reference)
            row(f"image, {case}, {n_photons} lattice photons", f"M = {100 * error:.3f} % in {1e3 * elapsed:.1f} ms")
    flat = CausticSimulator(CONTACT, device=device)(torch.full((128, 128), 0.5e-3, device=device))
    row("flat plate, largest deviation from 1, border included", f"{float((flat - 1).abs().max()):.1e}")


def energy(device: str) -> None:
    scene = TINY["far, air"].model_copy(update={"screen_position_m": (0.0, 0.0, -0.01)})
    heights = torch.from_numpy(np.random.default_rng(0).uniform(0, 2e-2, (10, 10))).to(device)
    budget = energy_budget(CausticSimulator(scene, "paper", n_photons=100000, device=device), heights.float())
    gap = max(abs(sum(budget[name][c] for name in FATE_NAMES) - 1) for c in range(3))
    lost = {name: f"{100 * budget[name][0]:.1f} %" for name in FATE_NAMES[:3]}
    row(f"energy budget, steep random relief {lost}", f"closes to {gap:.1e}")
    worst = 0.0
    simulator = CausticSimulator(CONTACT, n_photons=1, dtype=torch.float64, device=device)
    for sigma in (0.0, 0.02, 0.1, 0.3, 1.0, 5.0, 20.0):
        variance = sigma**2 + 4e-4
        record = torch.tensor([255.3, 256.7, variance, 0.5 * sigma**2, variance, 1.0], dtype=torch.float64)
        image = torch.zeros(1, 1, 512, 512, dtype=torch.float64, device=device)
        simulator.engine.splat(record.view(1, 1, 6, 1).to(device), image)
        worst = max(worst, abs(float(image.sum()) - 1))
    row("image sum against landed energy, footprints of 0 to 20 px", f"{worst:.1e}")


def gradient(simulator: CausticSimulator, heights: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    leaf = heights.clone().requires_grad_()
    (simulator(leaf) * weights).sum().backward()
    assert leaf.grad is not None
    return leaf.grad


def gradients(device: str) -> None:
    generator = torch.Generator().manual_seed(0)
    heights = 2e-4 * torch.randn(3, 10, 10, generator=generator, dtype=torch.float64).abs().to(device)
    weights = torch.randn(3, 20, 20, generator=generator, dtype=torch.float64).to(device)
    for name, scene in TINY.items():
        simulator = CausticSimulator(scene, n_photons=900, smoothing=6.0, dtype=torch.float64, device=device)
        grad = gradient(simulator, heights[0], weights)
        numeric, analytic = [], []
        for _ in range(32):
            direction = torch.randn(10, 10, generator=generator, dtype=torch.float64).to(device)
            pair = [simulator(heights[0] + step * direction) for step in (1e-9, -1e-9)]
            numeric.append(float(((pair[0] - pair[1]) * weights).sum()) / 2e-9)
            analytic.append(float((grad * direction).sum()))
        worst = np.abs(np.subtract(numeric, analytic)).max() / np.abs(numeric).max()
        row(f"gradient, {name}: against central differences, 32 directions", f"{worst:.1e}")
        positions = torch.cat([p for _, p in simulator.engine.chunks(1)]).cpu()
        leaf = heights[0].cpu().clone().requires_grad_()
        (oracle_image(leaf, scene, positions, 6.0, simulator.profile, True) * weights.cpu()).sum().backward()
        assert leaf.grad is not None
        scale = float(leaf.grad.abs().max())
        row(f"gradient, {name}: against the oracle", f"{float((grad.cpu() - leaf.grad).abs().max()) / scale:.1e}")
        warp_device = simulator.engine.warp_device
        on_tape: Any = wp.array(heights[:1].cpu().numpy(), dtype=wp.float64, device=warp_device, requires_grad=True)
        tape = wp.Tape()
        with tape:
            image = simulate_on_tape(tape, simulator, on_tape)
        tape.backward(grads={image: wp.array(weights[None].cpu().numpy(), dtype=wp.float64, device=warp_device)})
        difference = torch.from_numpy(on_tape.grad.numpy()[0]) - grad.cpu()
        row(f"gradient, {name}: tape against torch", f"{float(difference.abs().max()) / scale:.1e}")
        single = CausticSimulator(scene, n_photons=900, smoothing=6.0, device=device)
        grad32 = gradient(single, heights[0].float(), weights.float()).double()
        row(f"gradient, {name}: float32 against float64", f"{float((grad32 - grad).norm() / grad.norm()):.1e}")
        batch = gradient(simulator, heights, weights)
        singles = torch.stack([gradient(simulator, h, weights) for h in heights])
        row(f"gradient, {name}: batch of 3 against 3 singles", f"{float((batch - singles).abs().max()) / scale:.1e}")


def refine(device: str) -> None:
    for case in ("d_gauss", "c_cosine", "f_lines"):
        image = CausticImage(np.load(DATA / f"{case}_image.npz")["image"])
        started = time.perf_counter()
        result = create("refine", CONTACT, device=device).reconstruct(image)
        errors = height_errors(result.heights_m, heights_of(case), CONTACT.plate_size_m)
        row(
            f"refine from flat, {case} (flat guess {errors['reference_rms_um']:.1f} um)",
            f"RMSE {errors['rmse_um']:.2f} um, without the mean {errors['rmse_mean_removed_um']:.2f} um "
            f"in {time.perf_counter() - started:.0f} s",
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--without-refine", action="store_true")
    arguments = parser.parse_args()
    ray_trace(arguments.device)
    images(arguments.device)
    energy(arguments.device)
    gradients(arguments.device)
    if not arguments.without_refine:
        refine(arguments.device)


if __name__ == "__main__":
    main()
