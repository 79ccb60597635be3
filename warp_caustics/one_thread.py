"""Small matrices on one core: where others work, or cores are fewer than threads, to wait for threads takes longer.

A system of 150 equations takes one thread 0.2 ms, and two threads of a machine on which others work 150 ms.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """torch's operations on a CPU take no other threads meanwhile, those of other Python threads neither."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
