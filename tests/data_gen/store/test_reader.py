"""The data set as training sees it."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from store_synthetic import SyntheticSampler, factory, make_config
from torch.utils.data import DataLoader

from data_gen.store import CausticDataset, build, write_index
from data_gen.store.layout import Layout, Manifest, sha256
from data_gen.store.reader import is_validation
from warp_caustics.errors import DamagedDataError, InputError

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def truth():
    return SyntheticSampler(make_config()).draw(range(40)).arrays


def test_samples_are_the_samplers(reference, truth):
    data = CausticDataset(reference)
    assert len(data) == 40 and data.fields == ("image", "heights")
    for index in (0, 17, 39, -1):
        item = data[index]
        assert set(item) == {"image", "heights", "id"} and item["id"] == index % 40
        assert item["image"].dtype == torch.float16 and item["heights"].dtype == torch.float32
        np.testing.assert_array_equal(item["heights"], truth["heights"][index])
        np.testing.assert_array_equal(item["image"], truth["image"][index])
    with pytest.raises(IndexError):
        data[40]


def test_selection_of_fields_and_samples(reference, truth):
    data = CausticDataset(reference, fields=["heights"], ids=[31, 3], transform=lambda item: {**item, "more": 1})
    assert len(data) == 2 and set(data[0]) == {"heights", "id", "more"} and data[0]["id"] == 31
    np.testing.assert_array_equal(data[1]["heights"], truth["heights"][3])
    with pytest.raises(InputError, match=r"fields \['depth'\] are not in .*; use some of image, heights"):
        CausticDataset(reference, fields=["depth"])
    with pytest.raises(InputError, match=r"samples \[40\]"):
        CausticDataset(reference, ids=[39, 40])


def test_split_is_fixed_disjoint_and_complete(reference):
    train, val = (CausticDataset(reference, split=split).ids.tolist() for split in ("train", "val"))
    assert sorted(train + val) == list(range(40)) and train and val
    assert val == [sample for sample in range(40) if is_validation(sample)]
    wider = CausticDataset(reference, split="val", val_fraction=0.5).ids.tolist()
    assert set(val) < set(wider)
    assert CausticDataset(reference, split="val", val_fraction=0.0).ids.size == 0
    both = CausticDataset(reference, split="val", ids=range(20), val_fraction=0.5).ids.tolist()
    assert both == [sample for sample in wider if sample < 20]


def test_split_stays_what_it_is_for_ever():
    """Networks trained on one version must not meet their validation samples in the next."""
    assert [sample for sample in range(100) if is_validation(sample)] == FIRST_VALIDATION_SAMPLES
    share = np.mean([is_validation(sample) for sample in range(100_000)])
    assert share == pytest.approx(0.1, abs=0.003)


FIRST_VALIDATION_SAMPLES = [3, 22, 25, 39, 52, 54, 73, 74, 83]


@pytest.mark.parametrize("arguments", [{"split": "test"}, {"val_fraction": 1.0}, {"val_fraction": float("nan")}])
def test_impossible_splits(reference, arguments):
    with pytest.raises(InputError):
        CausticDataset(reference, **{"split": "train", **arguments})


def loaded(data, **options):
    return {
        int(item): batch["heights"][row]
        for batch in DataLoader(data, **options)
        for row, item in enumerate(batch["id"])
    }


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_workers_of_a_loader(reference, truth, method):
    data = CausticDataset(reference)
    data[0], data[20]
    # Under spawn each worker imports torch anew: one is enough.
    workers = {"fork": 2, "spawn": 1}[method]
    items = loaded(data, batch_size=4, num_workers=workers, multiprocessing_context=method, shuffle=True)
    assert sorted(items) == list(range(40))
    for sample, heights in items.items():
        np.testing.assert_array_equal(heights, truth["heights"][sample])
    np.testing.assert_array_equal(data[3]["heights"], truth["heights"][3])


def test_forked_process_opens_files_of_its_own(reference):
    data = CausticDataset(reference)
    data[0]
    before = data._files
    pid = os.fork()
    if pid == 0:
        data[0]
        os._exit(0 if data._files is not before else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    data[0]
    assert data._files is before


def test_pickled_data_set_carries_no_handles(reference, truth):
    data = CausticDataset(reference)
    data[0]
    assert len(data._files) == 1 and data._checked.sum() == 1
    other = pickle.loads(pickle.dumps(data))
    assert len(other._files) == 0 and other._checked.sum() == 0
    np.testing.assert_array_equal(other[5]["heights"], truth["heights"][5])


def test_number_of_open_files_is_bounded(reference):
    def descriptors():
        return sum(
            os.readlink(f"/proc/self/fd/{fd}").endswith(".h5") for fd in os.listdir("/proc/self/fd") if is_open(fd)
        )

    def is_open(fd):
        return os.path.lexists(f"/proc/self/fd/{fd}")

    data = CausticDataset(reference, most_open=3)
    for index in range(40):
        data[index]
    assert descriptors() == len(data._files) == 3
    data.close()
    assert descriptors() == 0


def test_hash_is_taken_once_per_sample_and_process(folder):
    """What was right a moment ago is not hashed again; another process hashes for itself."""
    build(folder, make_config(), factory(), compression="none")
    data = CausticDataset(folder, fields=["heights"])
    heights = data[0]["heights"].numpy().tobytes()
    data.close()
    path = Layout(folder).shard(0)
    path.write_bytes(path.read_bytes().replace(heights, bytes(len(heights))))
    assert not data[0]["heights"].any()
    with pytest.raises(DamagedDataError, match="sample 0: heights does not match its hash"):
        pickle.loads(pickle.dumps(data))[0]
    with pytest.raises(DamagedDataError, match="sample 0: heights does not match its hash"):
        CausticDataset(folder)[0]


def resealed(folder, shard, change):
    """Change a shard's file as an attacker would, with a fitting manifest and without COMPLETE.json."""
    layout = Layout(folder)
    with h5py.File(layout.shard(shard), "r+") as file:
        change(file)
    data = layout.shard(shard).read_bytes()
    old = Manifest.from_bytes(layout.manifest(shard).read_bytes())
    new = Manifest(**{**vars(old), "sha256": sha256(data), "n_bytes": len(data)})
    layout.manifest(shard).write_bytes(new.to_bytes())
    layout.complete.unlink(missing_ok=True)


def soft_link(file):
    del file["heights"]
    file["heights"] = h5py.SoftLink("/image")


def external_link(file):
    del file["heights"]
    file["heights"] = h5py.ExternalLink("00001.h5", "/heights")


def external_storage(file):
    del file["heights"]
    file.create_dataset("heights", (4, 8, 8), "<f4", external=[("/etc/hostname", 0, h5py.h5f.UNLIMITED)])


def virtual(file):
    del file["heights"]
    layout = h5py.VirtualLayout((4, 8, 8), "<f4")
    layout[:] = h5py.VirtualSource("00001.h5", "heights", (4, 8, 8))
    file.create_virtual_dataset("heights", layout)


def group(file):
    del file["heights"]
    file.create_group("heights")


def other_shape(file):
    del file["heights"]
    file["heights"] = np.zeros((4, 4, 16), "<f4")


def other_filter(file):
    del file["heights"]
    file.create_dataset("heights", (4, 8, 8), "<f4", chunks=(1, 8, 8), compression="lzf")


def other_ids(file):
    file["ids"][:] = [3, 2, 1, 0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (soft_link, "sample 0: heights is a link elsewhere"),
        (external_link, "sample 0: heights is a link elsewhere"),
        (external_storage, "heights lies in other files"),
        (virtual, "heights lies in other files"),
        (group, "heights lies in other files"),
        (other_shape, r"heights is float32 \[4, 4, 16\], not float32 \[4, 8, 8\]"),
        (other_filter, "unknown filters"),
        (other_ids, "holds other samples than its manifest says"),
    ],
)
def test_files_that_point_elsewhere_are_refused(copied, change, message):
    resealed(copied, 0, change)
    data = CausticDataset(copied, partial=True)
    with pytest.raises(DamagedDataError, match=message):
        data[0]
    assert data[4]["id"] == 4


MANY = 200

LIMITED = f"""
import random, resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
import h5py, numpy as np
from data_gen.store import CausticDataset
from store_synthetic import SyntheticSampler, make_config
folder, way = sys.argv[1:]
chance = random.Random(6)
truth = SyntheticSampler(make_config({MANY}, 1)).draw(range({MANY})).arrays["heights"]
reader = CausticDataset(folder) if way == "reader" else h5py.File(folder + "/index.h5")["heights"]
wrong = 0
for _ in range(600):
    sample = chance.randrange({MANY})
    read = reader[sample]["heights"].numpy() if way == "reader" else reader[sample]
    wrong += not np.array_equal(read, truth[sample])
print(wrong)
"""


def test_few_descriptors_and_many_shards(folder):
    """Control: through the virtual index the same reads come back as fill values, without an error."""
    build(folder, make_config(MANY, 1), factory())
    write_index(folder)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    wrong = {}
    for way in ("reader", "index"):
        command = [sys.executable, "-c", LIMITED, str(folder), way]
        run = subprocess.run(command, capture_output=True, text=True, env=environment)
        assert run.returncode == 0, run.stderr
        wrong[way] = int(run.stdout)
    assert wrong["reader"] == 0 and wrong["index"] > 200
