"""Training: what is learned from what (tasks, data), and the loop that does it.

The loop is this package's own, on several devices by Lightning Fabric (processes, DDP):
every number that a resumed run needs is in one dictionary of tensors and plain
values, which Lightning's Trainer spreads over its loops and callbacks.
"""
