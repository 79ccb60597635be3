"""The Lightning data module over a built data set."""

import pytest
import torch

from data_gen.dataset_config import DatasetConfig
from data_gen.samples import make_sampler
from data_gen.store import build
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene


@pytest.fixture
def data_module():
    """Its class; loading Lightning takes longer than to collect all other tests."""
    from data_gen.store import CausticDataModule

    return CausticDataModule


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "set"
    config = DatasetConfig(
        kind="updater", n_samples=40, samples_per_shard=20, scene=Scene(height_samples=8, image_pixels=16)
    )
    build(path, config, make_sampler)
    return path


@pytest.mark.parametrize("workers", [0, 1])
def test_every_sample_comes_once_and_in_its_part(data_module, folder, workers):
    module = data_module(folder, ["heights"], batch_size=4, workers=workers)
    module.setup()
    batches = [list(loader) for loader in (module.train_dataloader(), module.val_dataloader())]
    parts = [torch.cat([batch["id"] for batch in part]).tolist() for part in batches]
    assert sorted(parts[0] + parts[1]) == list(range(40))
    assert parts[1] == [3, 22, 25, 39]
    assert batches[1][0]["heights"].shape == (4, 8, 8)


def test_unfinished_sets_are_refused(data_module, folder, tmp_path):
    (tmp_path / "config.json").write_bytes((folder / "config.json").read_bytes())
    with pytest.raises(MismatchError, match="0/2"):
        data_module(tmp_path).setup()
