"""Processes and devices of a training."""

import logging
import warnings
from typing import Any


def launched(device: str, devices: int) -> Any:
    """A Lightning Fabric whose processes run: this one, and for several devices one more each.

    Args:
        device: ``"cpu"``, ``"cuda"`` or ``"cuda:N"``.
        devices: how many; above 1 the networks are kept equal by DDP.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from lightning.fabric import Fabric
        from lightning.fabric.strategies.ddp import DDPStrategy
    # Fabric announces processes and devices, and torch 2.13 that broadcast_buffers will be renamed.
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("lightning")]:
        logging.getLogger(name).setLevel(logging.ERROR)
    warnings.filterwarnings("ignore", message=".*broadcast_buffers")

    kind, _, index = device.partition(":")
    strategy: Any = "auto"
    if devices > 1:
        # Buffers are constants; sending them before every call would also break networks that are called repeatedly.
        strategy = DDPStrategy(broadcast_buffers=False)
    fabric = Fabric(
        accelerator="cuda" if kind == "cuda" else "cpu",
        devices=[int(index)] if index and devices == 1 else devices,
        strategy=strategy,
        precision="32-true",
    )
    fabric.launch()
    return fabric
