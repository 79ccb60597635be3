"""Chunks of photons on several threads of a CPU."""

from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from warp_caustics import chunked
from warp_caustics.simulator import CausticSimulator


@pytest.mark.parametrize("preset", ["lattice", "paper"])
def test_threads_change_nothing(preset, tiny_scene, monkeypatch):
    """Bit for bit, image and gradient: sums are private to a slot, and slots are added in order.

    One thread is this one; others are asked for.
    """
    simulator = CausticSimulator(tiny_scene, preset, n_photons=8 * chunked.MIN_CHUNK_PHOTONS, device="cpu")
    relief = torch.rand(16, 16, generator=torch.Generator().manual_seed(0)) * 3e-4
    found, asked = [], set()
    for threads in (1, 2, chunked.CPU_SLOTS):
        with ThreadPoolExecutor(threads) as pool:
            monkeypatch.setattr(torch, "get_num_threads", lambda threads=threads: threads)
            monkeypatch.setattr(chunked, "_thread_pool", lambda pool=pool, threads=threads: asked.add(threads) or pool)
            heights = relief.clone().requires_grad_()
            image = simulator(heights)
            image.square().sum().backward()
        found.append((image.detach(), heights.grad))
    for image, gradient in found[1:]:
        assert torch.equal(image, found[0][0]) and torch.equal(gradient, found[0][1])
    assert found[0][1].abs().max() > 0
    assert asked == {2, chunked.CPU_SLOTS}
