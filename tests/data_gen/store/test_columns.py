"""Rows of named numbers in a data set: names, units and meanings travel with them."""

import json

import h5py
import numpy as np
import pytest
import torch
from store_synthetic import captures, factory, make_config, shard_bytes

from data_gen.sampler import Column, Field
from data_gen.store import CausticDataset, build, column_ranges, info, verify, write_index
from data_gen.store.layout import Manifest
from data_gen.store.shard import check_fields
from warp_caustics.errors import DamagedDataError, InputError


@pytest.fixture(scope="module")
def benches(tmp_path_factory):
    place = tmp_path_factory.mktemp("benches") / "set"
    build(place, captures(10), factory())
    write_index(place)
    return place


def test_hdf5_says_what_each_number_is(benches):
    with h5py.File(benches / "shards" / "00000.h5") as file:
        attributes = dict(file["bench"].attrs)
        row = file["bench"][2]
    names, units = ([word.decode() for word in attributes[key]] for key in ("columns", "units"))
    assert len(names) == len(units) == len(attributes["descriptions"]) == len(row)
    record = dict(zip(names, row, strict=True))
    assert dict(zip(names, units, strict=True))["gap_m"] == "m" and 1e-6 <= record["gap_m"] <= 1.01e-4
    with h5py.File(benches / "index.h5") as index:
        assert list(index["bench"].attrs["columns"]) == list(attributes["columns"])
        np.testing.assert_array_equal(index["bench"][2], row)


def test_reader_and_loader_give_them(benches):
    dataset = CausticDataset(benches, ["bench"])
    columns = dataset.columns("bench")
    assert columns[0] == Column("gap_m", "m", "plate to screen") and dataset.columns("image") == ()
    (batch,) = torch.utils.data.DataLoader(dataset, batch_size=10)
    assert batch["bench"].dtype == torch.float64 and batch["bench"].shape == (10, len(columns))
    assert len(torch.unique(batch["bench"][:, 0])) == 10


def test_ranges_found_are_those_of_the_rows(benches):
    table = torch.stack([sample["bench"] for sample in CausticDataset(benches)])
    found = column_ranges(benches)
    low, high = found[CausticDataset(benches).columns("bench")[0]]
    assert (low, high) == (table[:, 0].min().item(), table[:, 0].max().item()) and len(found) == table.shape[1]


def test_a_row_that_was_changed_is_found(benches, folder):
    import shutil

    shutil.copytree(benches, folder)
    path = folder / "shards" / "00001.h5"
    with h5py.File(path, "r+") as file:
        file["bench"][1, 0] += 1e-6
    assert [problem.shard for problem in verify(folder).problems] == [1]
    with pytest.raises(DamagedDataError, match="sample 5: bench does not match its hash|another size"):
        CausticDataset(folder)[5]


def test_manifests_of_other_data_sets_are_written_as_before(folder):
    build(folder, make_config(4), factory())
    tree = json.loads((folder / "shards" / "00000.json").read_text())
    assert all(set(field) == {"name", "shape", "dtype", "unit", "description"} for field in tree["fields"])
    assert column_ranges(folder) == {} and info(folder).fields[0].columns == ()
    with h5py.File(folder / "shards" / "00000.h5") as file:
        assert set(file["image"].attrs) == {"unit", "description"}


def test_manifest_comes_back(benches):
    data = (benches / "shards" / "00001.json").read_bytes()
    manifest = Manifest.from_bytes(data)
    assert manifest.to_bytes() == data and manifest.fields[-1].columns[1].name == "base_thickness_m"


def test_columns_that_do_not_fit_are_refused():
    wrong = Field("bench", (3,), "float64", "", "a bench", (Column("gap_m", "m", ""),))
    with pytest.raises(InputError, match=r"1 columns and shape \[3\]"):
        check_fields([wrong], "gzip")


def test_workers_write_the_same_bytes(benches, folder):
    build(folder, captures(10), factory(), workers=2)
    assert shard_bytes(folder) == shard_bytes(benches)
