"""Light behind a plate without relief, smooth: what a flat frame has divided out of a capture.

Of one bench, with all that its scene says, by simulation. Networks take closed forms for batches of benches instead,
which know lamps from 0.25 m on (``nets/flat_light.py``).
"""

from functools import lru_cache

import torch

from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

COARSE = 32
"""Pixels of the simulation; light of a lamp bends over the whole window only."""
BORDER = 3
ORDER = 4
"""Of the polynomial in x and y: a lamp as near as the plate is large is off by 1e-3."""
_PAIRS = [(i, j) for i in range(ORDER + 1) for j in range(ORDER + 1 - i)]
"""Powers of x and y."""


def flat_light(
    scene: Scene, pixels: int, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float64
) -> torch.Tensor:
    """Irradiance behind a flat plate [W/m^2], shape [n_w, m, m]; smooth up to the border.

    Collimated light makes it even. That of a lamp falls off: a simulation in few pixels, and a polynomial through them.

    Args:
        scene: the bench.
        pixels: m.
        device: where the polynomial is evaluated; the simulation is one of a CPU.
        dtype: of the result.

    Raises:
        InputError: no light in the window.
    """
    level = torch.tensor(scene.radiosity_W_m2, dtype=dtype, device=device)
    if scene.is_collimated:
        return level[:, None, None].expand(-1, pixels, pixels)
    coarse = Scene.model_validate(
        scene.model_dump() | {"image_pixels": COARSE, "height_samples": 8, "lamp_radius_m": 0.0}
    )
    with torch.no_grad():
        image = CausticSimulator(coarse, device="cpu", dtype=torch.float64)(torch.zeros(8, 8, dtype=torch.float64))
    inner = image[:, BORDER:-BORDER, BORDER:-BORDER]
    if not bool((inner.mean((1, 2)) > 0).any()):
        raise InputError("no light of the lamp reaches the window; check its place and the screen's")
    fitted = _least_squares() @ inner.flatten(1).T
    coefficients = fitted.new_zeros(len(inner), ORDER + 1, ORDER + 1)  # of y and x
    coefficients[:, *torch.tensor(_PAIRS).flip(1).T] = fitted.T
    powers, coefficients = (each.to(device, dtype) for each in (_powers(pixels), coefficients))
    result: torch.Tensor = powers @ coefficients @ powers.T
    return result


@lru_cache(maxsize=1)
def _least_squares() -> torch.Tensor:
    """From light in pixels of the simulation, without those at the border, to the coefficients of the polynomial."""
    design = _products(_powers(COARSE)[BORDER:-BORDER]).flatten(0, 1)
    inverse: torch.Tensor = torch.linalg.pinv(design)
    return inverse


def _powers(pixels: int) -> torch.Tensor:
    at = (2 * torch.arange(pixels, dtype=torch.float64) + 1) / pixels - 1
    return torch.stack([at**k for k in range(ORDER + 1)], dim=1)


def _products(along: torch.Tensor) -> torch.Tensor:
    """x^i y^j up to the order, shape [m, m, K]."""
    return torch.stack([along[None, :, i] * along[:, None, j] for i, j in _PAIRS], dim=-1)
