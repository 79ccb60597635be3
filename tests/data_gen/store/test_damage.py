"""Damage is found, named, repaired, and never returned to anybody."""

import random
import shutil

import numpy as np
import pytest
from store_synthetic import factory, make_config, shard_bytes

from data_gen.store import CausticDataset, build, verify
from data_gen.store.layout import Layout, Manifest
from warp_caustics.errors import DamagedDataError, InputError, MismatchError

CONFIG = make_config(n_samples=12)


@pytest.fixture
def small(folder):
    """Three shards of four samples."""
    build(folder, CONFIG, factory())
    return folder


@pytest.fixture
def foreign(folder):
    """The same shards from another seed."""
    place = folder.with_name("foreign")
    build(place, make_config(n_samples=12, seed=2), factory())
    return place


def flipped(data, chance):
    changed = bytearray(data)
    bit = chance.randrange(8 * len(data))
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def test_verify_names_every_one_of_1000_flipped_bits(small):
    chance, layout = random.Random(4), Layout(small)
    assert verify(small).problems == ()
    paths = [path for shard in range(3) for path in 3 * [layout.shard(shard)] + [layout.manifest(shard)]]
    for number in range(1000):
        path = paths[number % len(paths)]
        whole = path.read_bytes()
        path.write_bytes(flipped(whole, chance))
        (problem,) = verify(small, threads=1).problems
        assert problem.shard == int(path.stem) and problem.kind in ("damaged", "swapped", "foreign")
        path.write_bytes(whole)
    assert verify(small).problems == ()


def read_all(place, **options):
    """Each sample or the error it raises."""
    data = CausticDataset(place, **options)
    results = []
    for index in range(len(data)):
        try:
            results.append(data[index])
        except DamagedDataError as error:
            results.append(error)
    data.close()
    return results


def is_wrong(result, sample, truth):
    return any(not np.array_equal(result[name], truth[sample][name], equal_nan=True) for name in ("image", "heights"))


@pytest.mark.parametrize("compression", ["gzip", "none"])
def test_loader_never_returns_a_flipped_bit(folder, compression):
    """And without the hashes it would: the control."""
    build(folder, CONFIG, factory(), compression=compression)
    chance, path, truth = random.Random(5), Layout(folder).shard(1), read_all(folder)
    assert not any(isinstance(result, Exception) for result in truth)
    whole, raised, wrong_without = path.read_bytes(), 0, 0
    for _ in range(150):
        path.write_bytes(flipped(whole, chance))
        for sample, result in enumerate(read_all(folder)):
            if isinstance(result, DamagedDataError):
                raised += 1
                assert 4 <= sample < 8 and "00001.h5" in str(result) and f"sample {sample}" in str(result)
            else:
                assert not is_wrong(result, sample, truth)
        unchecked = read_all(folder, check=False)
        wrong_without += sum(
            is_wrong(result, sample, truth)
            for sample, result in enumerate(unchecked)
            if not isinstance(result, DamagedDataError)
        )
    assert raised > 10
    # gzip has a checksum of its own, but HDF5's tables have none.
    assert wrong_without > (10 if compression == "none" else -1)


def damage(kind, small, foreign):
    """Break shard 1; returns the kind of problem and a part of the reason."""
    layout, other = Layout(small), Layout(foreign)
    shard, manifest = layout.shard(1), layout.manifest(1)
    data = shard.read_bytes()
    if kind.startswith("truncated"):
        shard.write_bytes(data[: int(len(data) * float(kind.split()[1]))])
        return ("damaged", "bytes instead of") if kind != "truncated 0" else ("damaged", "0 bytes instead of")
    if kind == "longer":
        shard.write_bytes(data + b"\0")
        return "damaged", "bytes instead of"
    if kind in ("zeroed page", "page of 0xFF"):
        page = (bytes(1) if kind == "zeroed page" else b"\xff") * 4096
        shard.write_bytes(data[:8192] + page + data[12288:])
        return "damaged", "sha256 is"
    if kind == "file deleted":
        shard.unlink()
        return "missing", "its manifest is there"
    if kind == "both deleted":
        shard.unlink()
        manifest.unlink()
        return "missing", "neither"
    if kind == "manifest deleted":
        manifest.unlink()
        return "unpublished", "no manifest"
    if kind == "manifest empty":
        manifest.write_bytes(b"")
        return "damaged", "manifest is damaged"
    if kind == "another shard copied over":
        shutil.copy(layout.shard(2), shard)
        return "swapped", "a file of shard 00002"
    if kind == "both copied over":
        shutil.copy(layout.shard(2), shard)
        shutil.copy(layout.manifest(2), manifest)
        return "swapped", "manifest of shard 00002"
    if kind == "foreign file":
        shutil.copy(other.shard(1), shard)
        return "foreign", "a file of the data set"
    if kind == "foreign pair":
        shutil.copy(other.shard(1), shard)
        shutil.copy(other.manifest(1), manifest)
        return "foreign", "manifest of a data set"
    if kind == "stale manifest":
        old = Manifest.from_bytes(manifest.read_bytes())
        manifest.write_bytes(Manifest(**{**vars(old), "sha256": "0" * 64}).to_bytes())
        return "stale", "another version than COMPLETE.json lists"
    if kind == "folder":
        shard.unlink()
        shard.mkdir()
        return "damaged", "no regular file"
    raise AssertionError(kind)


KINDS = [
    "truncated 0",
    "truncated 0.1",
    "truncated 0.5",
    "truncated 0.99",
    "longer",
    "zeroed page",
    "page of 0xFF",
    "file deleted",
    "both deleted",
    "manifest deleted",
    "manifest empty",
    "another shard copied over",
    "both copied over",
    "foreign file",
    "foreign pair",
    "stale manifest",
]


@pytest.mark.parametrize("kind", KINDS)
def test_damage_is_named_not_loaded_and_repaired(small, foreign, kind):
    whole, truth = shard_bytes(small), read_all(small)
    complete = (small / "COMPLETE.json").read_bytes()
    expected, reason = damage(kind, small, foreign)
    (problem,) = verify(small).problems
    assert (problem.shard, problem.kind) == (1, expected) and reason in problem.reason
    with pytest.raises(DamagedDataError, match=f"shard 00001 {expected}"):
        verify(small).require()
    try:
        results = read_all(small)
    except DamagedDataError as error:
        assert "00001.h5" in str(error)
    else:
        assert all(isinstance(result, DamagedDataError) for result in results[4:8]) or kind in (
            "zeroed page",
            "page of 0xFF",
        )
        for sample, result in enumerate(results):
            assert isinstance(result, DamagedDataError) or not is_wrong(result, sample, truth)
        assert not any(isinstance(result, DamagedDataError) for result in results[:4] + results[8:])
    report = build(small, CONFIG, factory(), check="full")
    assert report.shards_built == 1
    assert shard_bytes(small) == whole and (small / "COMPLETE.json").read_bytes() == complete


def test_two_swapped_shards_are_both_named(small):
    layout, whole = Layout(small), shard_bytes(small)
    for path in (layout.shard, layout.manifest):
        path(0).rename(small / "x")
        path(2).rename(path(0))
        (small / "x").rename(path(2))
    assert [(problem.shard, problem.kind) for problem in verify(small).problems] == [(0, "swapped"), (2, "swapped")]
    # Which fields there are is read from the first shard.
    with pytest.raises(DamagedDataError, match="shard 00000 swapped"):
        read_all(small)
    build(small, CONFIG, factory())
    assert shard_bytes(small) == whole and verify(small).problems == ()


def test_file_that_does_not_belong_is_named(small):
    (small / "shards" / "00003.h5").write_bytes(b"x")
    (problem,) = verify(small).problems
    assert problem.shard is None and "shards/00003.h5 is not a file of this data set" in problem.reason


def test_fast_verification_trusts_contents(small):
    """Control: what finds a flipped bit is the hash, which only the full check takes."""
    path = Layout(small).shard(1)
    path.write_bytes(flipped(path.read_bytes(), random.Random(1)))
    assert verify(small, full=False).problems == () and verify(small, full=True).problems != ()
    path.write_bytes(path.read_bytes()[:-1])
    assert verify(small, full=False).problems[0].shard == 1


def test_list_that_is_broken_is_named_and_written_again(small):
    path = small / "COMPLETE.json"
    whole = path.read_bytes()
    path.write_bytes(flipped(whole, random.Random(2)))
    assert "COMPLETE.json is damaged" in verify(small).problems[0].reason
    with pytest.raises(DamagedDataError, match=r"'.*': COMPLETE.json is damaged .*; build again to repair$"):
        CausticDataset(small)
    built = build(small, CONFIG, factory())
    assert built.shards_built == 0
    assert path.read_bytes() == whole


def test_unfinished_set_has_no_problems_only_less(small):
    for name in ("COMPLETE.json", "shards/00001.h5", "shards/00001.json", "shards/00002.json"):
        (small / name).unlink()
    result = verify(small)
    assert (result.problems, result.shards_right, result.n_shards, result.complete) == ((), 1, 3, False)
    with pytest.raises(MismatchError, match="unfinished: 1/3 shards; .*partial=True"):
        CausticDataset(small)
    assert CausticDataset(small, partial=True).ids.tolist() == [0, 1, 2, 3]


def test_verify_needs_a_data_set(tmp_path):
    with pytest.raises(InputError, match="has no config.json"):
        verify(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        verify(tmp_path / "absent")
