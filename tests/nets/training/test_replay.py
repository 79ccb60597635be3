"""The pool of recent samples, for every kind of training."""

import pydantic
import pytest
import torch

from nets.training.batch import HEIGHT_MAPS, IMAGES
from nets.training.config import RunConfig
from nets.training.sources import make_source

CPU = torch.device("cpu")


@pytest.mark.parametrize("kind", ["denoiser", "updater", "direct", "unrolled"])
def test_pool_holds_fresh_samples_of_every_kind(tiny_run, kind):
    plain = make_source(tiny_run(kind, batch_size=2), CPU)
    source = make_source(tiny_run(kind, batch_size=2, replay={"size": 4, "fresh_per_step": 2}), CPU)
    try:
        fresh = [plain.batch(0), plain.batch(1)]
        drawn = [source.batch(step) for step in range(3)]
        for batch in drawn:
            assert batch.keys() == fresh[0].keys()
            for name, values in batch.items():
                assert values.shape == fresh[0][name].shape and values.dtype == torch.float32
        # Before the third round overwrites the first: every sample is one of the pool's, images to float16.
        source.rounds, source.pool = 0, {}
        batch = source.batch(0)
        pool = {name: torch.cat([part[name] for part in fresh]) for name in batch}
        for k in range(2):
            same = [
                all(torch.allclose(batch[name][k], pool[name][j], rtol=1e-3, atol=1e-6) for name in batch)
                for j in range(4)
            ]
            assert sum(same) == 1
    finally:
        plain.close()
        source.close()


@pytest.mark.parametrize("kind", ["denoiser", "updater", "direct", "unrolled"])
def test_memory_of_a_pool_is_what_is_announced(tiny_run, kind):
    source = make_source(tiny_run(kind, batch_size=2, replay={"size": 4, "fresh_per_step": 2}), CPU)
    try:
        batch = source.batch(0)
        assert sum(values.numel() * values.element_size() for values in source.pool.values()) == source.bytes_needed
        images = [name for name, values in batch.items() if values.dim() == 4]
        assert sorted(images) == sorted(IMAGES[kind]) and len(batch) - len(images) == HEIGHT_MAPS[kind]
    finally:
        source.close()


def test_a_data_set_needs_no_pool(tiny_run):
    tree = tiny_run("updater", replay={"size": 4, "fresh_per_step": 2}).model_dump()
    with pytest.raises(pydantic.ValidationError, match=r"replay.size is for fresh samples.*set it to 0"):
        RunConfig.model_validate(tree | {"data": "folder"})
