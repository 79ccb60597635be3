"""Tests of inspection use small tensors only."""

import pytest
import torch


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """These tensors are too small to share; on a busy machine threads would wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
