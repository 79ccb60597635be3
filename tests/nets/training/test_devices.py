"""Where a training runs."""

import sys

import torch

from nets.training.devices import launched


def test_one_device_needs_no_lightning(monkeypatch):
    """It trains in this process, and nothing is sent or averaged."""
    monkeypatch.setitem(sys.modules, "lightning.fabric", None)  # what imports it fails
    alone = launched("cpu", 1)
    assert (alone.device, alone.world_size, alone.global_rank) == (torch.device("cpu"), 1, 0) and alone.is_global_zero
    module = alone.setup_module(torch.nn.Linear(2, 1))
    with alone.no_backward_sync(module, enabled=True):
        alone.backward(module(torch.ones(3, 2)).sum())
    assert torch.equal(module.weight.grad, torch.full((1, 2), 3.0))
    assert alone.broadcast("told") == "told"
    assert torch.equal(alone.all_reduce(torch.tensor(2.5), reduce_op="mean"), torch.tensor(2.5))
