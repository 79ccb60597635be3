"""The simulation on a ``wp.Tape``, for programs written in Warp.

The torch route (:class:`~warp_caustics.simulator.CausticSimulator`) is the
faster one: it launches adjoints itself and works in bounded memory, while a
tape keeps every stage of every photon.
"""

from typing import Any

import torch
import warp as wp

from warp_caustics.kernels import MAP_NAMES, RECORD_NAMES
from warp_caustics.simulator import CausticSimulator


def simulate_on_tape(tape: wp.Tape, simulator: CausticSimulator, heights: Any) -> Any:
    """Record a simulation; call inside ``with tape:``.

    Args:
        tape: the active tape.
        simulator: scene, photons, device and precision. Lattices are gathered
            like scattered photons here.
        heights: relief above the base [m], shape [B, n, n], with ``requires_grad``.

    Returns:
        Irradiance [W/m^2], shape [B, n_w, m, m]. ``tape.backward(grads={image: ...})``
        then adds to ``heights.grad``.
    """
    engine, scene = simulator.engine, simulator.scene
    device, dtype = engine.warp_device, engine.warp_dtype
    batch, n, _ = heights.shape

    def zeros(*shape: int) -> Any:
        return wp.zeros(shape, dtype=dtype, device=device, requires_grad=True)

    def constant(tensor: torch.Tensor) -> Any:
        return wp.from_torch(tensor.contiguous(), requires_grad=False)

    prefilter = constant(engine.prefilter)
    size = prefilter.shape[0]
    filtered, coefficients = zeros(batch, size, n), zeros(batch, size, size)
    surface = engine.surface
    wp.launch(surface.prefilter_columns, filtered.shape, [prefilter, heights], [filtered], device=device)
    wp.launch(surface.prefilter_rows, coefficients.shape, [prefilter, filtered], [coefficients], device=device)
    image = zeros(batch, scene.n_wavelengths, scene.image_pixels, scene.image_pixels)
    for chunk, positions in engine.chunks(batch):
        photons = engine.told(wp.to_torch(coefficients, requires_grad=False), engine.photons(positions))
        maps = zeros(batch, len(MAP_NAMES), chunk.count)
        wp.launch(surface.gather_surface, (batch, chunk.count), [coefficients, photons], [maps], device=device)
        records = zeros(batch, scene.n_wavelengths, len(RECORD_NAMES), chunk.count)
        dim = (batch, scene.n_wavelengths, chunk.count)
        wp.launch(engine.tracer.trace, dim, [maps, photons], [records], device=device)
        _record_splat(tape, engine.splatter.splat, engine.splatter.splat_adjoint, records, image)
    return image


def _record_splat(tape: wp.Tape, splat: wp.Kernel, splat_adjoint: wp.Kernel, records: Any, image: Any) -> None:
    """Launch the splat with its hand-written adjoint on the tape."""
    dim = (records.shape[0], records.shape[1], records.shape[3])

    def backward() -> None:
        wp.launch(splat_adjoint, dim, [records, image.grad], [records.grad], device=records.device)

    wp.launch(splat, dim, [records], [image], device=records.device, record_tape=False)
    tape.record_func(backward, [records, image])
