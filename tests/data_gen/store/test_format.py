"""What is on the disk: bytes, attributes, hashes, and what is refused before it gets there."""

import hashlib
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import h5py
import numpy as np
import pytest
from store_synthetic import FIELDS, SyntheticSampler, factory, make_config, shard_bytes

from data_gen.sampler import Field, SampleBatch
from data_gen.store import build, estimate, info, write_index
from data_gen.store.layout import Complete, Layout, Manifest, read_manifest
from data_gen.store.shard import check_fields, encode_shard, sample_digest
from warp_caustics.errors import DamagedDataError, InputError, MismatchError, ResourceError


def test_config_is_canonical_and_its_hash_is_the_fingerprint(reference):
    data = (reference / "config.json").read_bytes()
    assert hashlib.sha256(data).hexdigest() == make_config().fingerprint()
    assert json.loads(data) == make_config().canonical()


def test_files_are_what_the_format_says(reference):
    names = sorted(path.relative_to(reference).as_posix() for path in reference.rglob("*") if path.is_file())
    shards = [f"shards/{shard:05d}.{kind}" for shard in range(10) for kind in ("h5", "json")]
    assert names == [".lock", "COMPLETE.json", "config.json", *shards]


def test_shard_is_plain_hdf5_with_the_samplers_numbers(reference):
    expected = SyntheticSampler(make_config()).draw(range(8, 12))
    with h5py.File(reference / "shards" / "00002.h5") as file:
        assert file["ids"][:].tolist() == [8, 9, 10, 11]
        for field in FIELDS:
            dataset = file[field.name]
            np.testing.assert_array_equal(dataset[:], expected.arrays[field.name])
            assert dataset.dtype == field.dtype
            assert dataset.chunks == (1, *field.shape)
            assert (dataset.compression, dataset.compression_opts, dataset.shuffle) == ("gzip", 1, True)
            assert np.isnan(dataset.fillvalue)
            assert dataset.attrs["unit"] == field.unit and dataset.attrs["description"] == field.description
        np.testing.assert_array_equal(file["counters/lost"][:], [4, 4.5, 5, 5.5])
        assert file.attrs["fingerprint"] == make_config().fingerprint()
        assert file.attrs["format_version"] == 1 and file.attrs["shard"] == 2
        assert json.loads(file.attrs["config"]) == make_config().canonical()


def test_old_hdf5_can_read_it(reference):
    """Version 0 of the superblock, the one since HDF5 1.0."""
    data = (reference / "shards" / "00000.h5").read_bytes()
    assert data[:8] == b"\x89HDF\r\n\x1a\n" and data[8] == 0


@pytest.mark.parametrize("compression", ["gzip", "none"])
def test_same_samples_same_bytes_for_any_number_of_threads(compression):
    batch = SyntheticSampler(make_config()).draw(range(4))
    results = []
    for threads in (1, 5):
        with ThreadPoolExecutor(threads) as pool:
            results.append(encode(batch, pool=pool, compression=compression))
    assert bytes(results[0].data) == bytes(results[1].data)
    assert results[0].samples == results[1].samples


def encode(batch, *, pool=None, fields=FIELDS, ids=range(4), compression="gzip"):
    arguments = {"shard": 0, "ids": ids, "fingerprint": "0" * 64, "config": b"{}", "compression": compression}
    if pool is not None:
        return encode_shard(batch, fields, pool=pool, **arguments)
    with ThreadPoolExecutor(1) as pool:
        return encode_shard(batch, fields, pool=pool, **arguments)


def test_uncompressed_set_holds_the_same_samples(reference, folder):
    build(folder, make_config(), factory(), compression="none")
    for shard in (0, 9):
        packed, plain = (read_manifest(Layout(place).manifest(shard)) for place in (reference, folder))
        assert packed.samples == plain.samples and packed.sha256 != plain.sha256
    assert info(folder).compression == {"none": 10}


@pytest.mark.parametrize("per_shard", [1, 7, 64])
def test_samples_do_not_depend_on_the_size_of_shards(reference, folder, per_shard):
    def hashes(place):
        manifests = [Manifest.from_bytes(path.read_bytes()) for path in sorted(place.glob("shards/*.json"))]
        return {field.name: sum((manifest.samples[field.name] for manifest in manifests), ()) for field in FIELDS}

    build(folder, make_config(samples_per_shard=per_shard), factory())
    assert hashes(folder) == hashes(reference)


def test_sample_hash_knows_its_place():
    array = np.arange(4, dtype=np.float32)
    hashes = {
        sample_digest(1, "a", array),
        sample_digest(2, "a", array),
        sample_digest(1, "b", array),
        sample_digest(1, "a", array.reshape(2, 2)),
        sample_digest(1, "a", array.view(np.int32)),
    }
    assert len(hashes) == 5


def damaged_batch(change):
    batch = SyntheticSampler(make_config()).draw(range(4))
    ids, arrays, counters = batch.ids, dict(batch.arrays), dict(batch.counters)
    if change == "nan":
        arrays["heights"][2, 1, 1] = np.nan
    elif change == "inf":
        arrays["image"][1, 0, 0, 0] = np.inf
    elif change == "float16 limit":
        arrays["image"][3, 0, 0, 0] = -65504
    elif change == "shape":
        arrays["image"] = arrays["image"][..., :7]
    elif change == "dtype":
        arrays["heights"] = arrays["heights"].astype(np.float64)
    elif change == "missing":
        del arrays["heights"]
    elif change == "more":
        arrays["extra"] = arrays["heights"]
    elif change == "ids":
        ids = (0, 1, 3, 2)
    elif change == "counter":
        counters["lost"] = np.array([0, 1, np.nan, 2])
    elif change == "counter length":
        counters["lost"] = np.zeros(3)
    return SampleBatch(ids, arrays, counters)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("nan", "sample 2: heights has 1 of 64 values that are not finite"),
        ("inf", "sample 1: image has 1 of 192"),
        ("float16 limit", "sample 3: image reaches the limit 65504"),
        ("shape", r"image is float16 \[4, 3, 8, 7\], not float16 \[4, 3, 8, 8\]"),
        ("dtype", "heights is float64"),
        ("missing", "returned .*image"),
        ("more", "extra"),
        ("ids", r"returned samples \[0, 1, 3, 2\]"),
        ("counter", "sample 2: counter lost is not finite"),
        ("counter length", "counter 'lost' has shape"),
    ],
)
def test_wrong_samples_never_reach_the_disk(change, message):
    encode(damaged_batch("none"))
    with pytest.raises(InputError, match=message):
        encode(damaged_batch(change))


@pytest.mark.parametrize(
    "fields",
    [
        [],
        [FIELDS[0], FIELDS[0]],
        [Field("ids", (2,), "float32", "m", "")],
        [Field("a/b", (2,), "float32", "m", "")],
        [Field("a", (2,), "int8", "m", "")],
        [Field("a", (0,), "float32", "m", "")],
    ],
)
def test_fields_that_cannot_be_stored_are_refused(fields):
    check_fields(FIELDS, "gzip")
    with pytest.raises(InputError):
        check_fields(fields, "gzip")


def test_unknown_compression_is_refused(folder):
    with pytest.raises(InputError, match="'zstd' is not known; use one of gzip, none"):
        build(folder, make_config(), factory(), compression="zstd")


def test_every_changed_byte_of_a_manifest_or_the_list_is_seen(reference):
    for path, kind in ((reference / "shards" / "00003.json", Manifest), (reference / "COMPLETE.json", Complete)):
        data = path.read_bytes()
        assert kind.from_bytes(data).to_bytes() == data
        for position in range(len(data)):
            changed = bytearray(data)
            changed[position] ^= 1 << position % 8
            with pytest.raises(DamagedDataError):
                kind.from_bytes(bytes(changed))
        for wrong in (b"", data[:-1], data + b"\n", b"[]", b"{}"):
            with pytest.raises(DamagedDataError):
                kind.from_bytes(wrong)


def test_index_shows_all_samples_and_is_byte_stable(reference, folder, copied):
    expected = SyntheticSampler(make_config()).draw(range(40))
    path = write_index(copied)
    first = path.read_bytes()
    with h5py.File(path) as file:
        assert file["ids"][:].tolist() == list(range(40))
        np.testing.assert_array_equal(file["heights"][:], expected.arrays["heights"])
        assert {source.file_name for source in file["image"].virtual_sources()} == {
            f"shards/{shard:05d}.h5" for shard in range(10)
        }
    write_index(copied)
    assert path.read_bytes() == first
    # Wherever the folder goes, the index goes with it; a missing shard shows as NaN.
    moved = copied.rename(copied.with_name("moved"))
    (moved / "shards" / "00001.h5").unlink()
    with h5py.File(moved / "index.h5") as file:
        assert np.isnan(file["heights"][4:8]).all() and np.isfinite(file["heights"][:4]).all()
        assert file["ids"][4:8].tolist() == [-1] * 4


def test_no_index_of_an_unfinished_set(copied):
    (copied / "COMPLETE.json").unlink()
    with pytest.raises(MismatchError, match="unfinished"):
        write_index(copied)


def test_estimate_before_and_from_measurement(folder):
    config = make_config(n_samples=400)
    before = estimate(folder, config, FIELDS)
    assert (before.measured, before.shards_total, before.shards_missing) == (False, 100, 100)
    assert before.bytes_total > 400 * sum(field.bytes_per_sample for field in FIELDS)
    build(folder, config, factory())
    path = folder / "shards" / "00099.json"
    path.unlink()
    after = estimate(folder, config, FIELDS)
    actual = sum(len(data) for data in shard_bytes(folder).values())
    assert after.measured and after.shards_missing == 1
    assert actual < after.bytes_total < 2 * actual


def test_build_that_the_disk_cannot_hold_is_refused(folder, monkeypatch):
    config = make_config(n_samples=10**6, samples_per_shard=4096)
    needed = int(estimate(folder.parent, config, FIELDS).bytes_missing * 1.1)
    set_free(monkeypatch, needed - 1)
    with pytest.raises(ResourceError, match=f"{needed:,} with reserve, and {needed - 1:,} are free"):
        build(folder, config, factory())
    with pytest.raises(ResourceError, match="are free"):
        build(folder, config, factory(), workers=1)
    small = make_config(n_samples=8)
    set_free(monkeypatch, 0)
    with pytest.raises(ResourceError):
        build(folder.with_name("other"), small, factory())
    build(folder.with_name("other"), small, factory(), preflight=False)


def set_free(monkeypatch, free):
    from data_gen.store import summary

    class Usage:
        def __init__(self):
            self.free = free

    monkeypatch.setattr(summary.shutil, "disk_usage", lambda path: Usage())


def test_info_sums_up(reference):
    summary = info(reference)
    assert (summary.kind, summary.n_samples, summary.shards_done, summary.complete) == ("denoiser", 40, 10, True)
    assert summary.counters["lost"].mean == pytest.approx(9.75)
    assert (summary.counters["lost"].max, summary.counters["lost"].sample_of_max) == (19.5, 39)
    assert summary.bytes == sum(len(data) for data in shard_bytes(reference).values())
    assert summary.raw_bytes == 40 * 640
    assert summary.devices == {"cpu": 10} and summary.fields == FIELDS


def test_import_is_light():
    code = "import sys, data_gen.store; print({'torch', 'h5py', 'numpy', 'distributed'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "set()"
