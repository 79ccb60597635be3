"""What the software writes itself, damaged: one line and an exit code of 2 to 6, never a bug, never late, never large."""

import hashlib
import json
import os
import random
import sqlite3
from pathlib import Path

import pytest
from fuzzing import check, damaged, outcome


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return (Path(__file__).parents[2] / "nets/trained/direct.safetensors").read_bytes()


def test_weights(weights, tmp_path, rounds):
    from nets.weights import weights_info

    rng = random.Random(5)
    path = tmp_path / "x.safetensors"
    length = int.from_bytes(weights[:8], "little")
    for _ in range(8 * rounds):
        head = damaged(weights[: 8 + length], rng)
        path.write_bytes(head + (weights[8 + length :] if rng.random() < 0.5 else b""))
        check(lambda: weights_info(path), head[:100])


def sealed(state, path):
    import io

    import torch

    buffer = io.BytesIO()
    torch.save(state, buffer)
    path.write_bytes(buffer.getvalue() + hashlib.sha256(buffer.getvalue()).digest())


def test_checkpoints(tmp_path, rounds):
    import torch

    from nets.training.checkpoint import load_checkpoint
    from nets.training.config import RunConfig, default_run
    from nets.training.state import check_same_run

    rng = random.Random(6)
    path = tmp_path / "last.ckpt"
    config = RunConfig.model_validate(default_run("direct", "direct-small"))
    whole = {"version": 2, "config": config.model_dump_json(), "step": 3, "network": {"a": torch.zeros(3)}}
    sealed(whole, path)
    content = path.read_bytes()
    for _ in range(20 * rounds):
        path.write_bytes(damaged(content, rng))
        check(lambda: load_checkpoint(path), "damaged checkpoint")
    for wrong in ([], 3, {}, {**whole, "config": "{"}, {**whole, "config": 3}, {**whole, "version": "x"}):
        sealed(wrong, path)
        check(lambda: check_same_run(config, load_checkpoint(path)), wrong)


WRONG = [None, 0, -1, 3_000_000_000, 2**63, 1e300, "", "x", [], {}, [0] * 3, True, {"a": 1}, "0" * 64]


def test_data_sets(tmp_path, rounds):
    """Records whose seal fits, but not their content."""
    from data_gen.dataset_config import DatasetConfig
    from data_gen.sampler import Field
    from data_gen.store.folder import open_folder
    from data_gen.store.layout import Complete, Entry, Layout, Manifest, _sealed, canonical_json, sha256
    from data_gen.store.reader import CausticDataset
    from data_gen.store.summary import info
    from data_gen.store.verification import verify

    rng = random.Random(7)
    layout = Layout(tmp_path)
    layout.shards.mkdir()
    config = DatasetConfig(kind="denoiser", n_samples=2, samples_per_shard=2).canonical()
    fingerprint = sha256(canonical_json(config))
    digest = "0" * 64
    manifest = Manifest(
        0, 5, digest, fingerprint, (0, 1), {"heights": (digest, digest)}, {"lost": (0.0, 1.0)},
        (Field("heights", (4, 4), "float32", "m", "x"),), "gzip", "cpu", "0", {},
    )  # fmt: skip
    layout.shard(0).write_bytes(b"12345")
    complete = Complete(fingerprint, 2, (Entry(0, 5, digest, sha256(manifest.to_bytes())),))

    def changed(tree):
        """The tree with one of its values wrong."""
        tree = json.loads(json.dumps(tree))
        node, keys = tree, []
        while True:
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            key = rng.choice(keys)
            if isinstance(node[key], dict | list) and node[key] and rng.random() < 0.7:
                node = node[key]
                continue
            if rng.random() < 0.2:
                del node[key]
            else:
                node[key] = rng.choice(WRONG)
            return tree

    def plain(data):
        return {k: v for k, v in json.loads(data).items() if k not in ("self_sha256", "format_version")}

    for _ in range(60 * rounds):
        which = rng.randrange(3)
        layout.config.write_bytes(json.dumps(changed(config)).encode() if which == 0 else canonical_json(config))
        record = _sealed(changed(plain(manifest.to_bytes()))) if which == 1 else manifest.to_bytes()
        layout.manifest(0).write_bytes(record)
        layout.complete.write_bytes(_sealed(changed(plain(complete.to_bytes()))) if which == 2 else complete.to_bytes())
        shown = layout.config.read_bytes(), record, layout.complete.read_bytes()
        for read in (open_folder, info, lambda d: verify(d).require(), lambda d: CausticDataset(d)[0]):
            check(lambda read=read: read(tmp_path), shown)


def test_a_pipe_in_place_of_a_record_stops_nobody(tmp_path):
    from data_gen.store.reader import CausticDataset
    from data_gen.store.summary import info
    from data_gen.store.verification import verify

    (tmp_path / "shards").mkdir()
    for name in ("config.json", "COMPLETE.json", "shards/00000.json", "shards/00000.h5"):
        os.mkfifo(tmp_path / name)
        for read in (info, verify, CausticDataset):
            assert outcome(lambda read=read: read(tmp_path))[0] in (0, 3, 4), name
        if name == "config.json":
            (tmp_path / name).unlink()
            (tmp_path / name).write_text('{"n_samples":2,"samples_per_shard":2}')


def test_studies(tmp_path, rounds):
    from nets.search.config import SearchConfig
    from nets.search.study import address, count, open_study
    from nets.training.config import default_run

    rng = random.Random(8)
    search = SearchConfig.model_validate({"run": default_run("denoiser")})
    where = address(None, tmp_path, "s")
    study = open_study(where, search)
    study.ask()
    del study
    file = tmp_path / "study.db"
    content = file.read_bytes()

    def attempt():
        found = open_study(where, search)
        count(found)

    for _ in range(3 * rounds):
        file.write_bytes(damaged(content, rng))
        check(attempt, "damaged study")
    for table in ("trials", "study_user_attributes", "study_directions", "studies"):
        file.write_bytes(content)
        with sqlite3.connect(file) as database:
            database.execute(f"drop table {table}")
        check(attempt, table)
    for change in (
        "update study_user_attributes set value_json = 'x'",
        "update study_user_attributes set value_json = '3'",
        "update trials set state = 'x'",
        "update trials set study_id = 'x'",
        "update study_directions set direction = 'x'",
    ):
        file.write_bytes(content)
        with sqlite3.connect(file) as database:
            database.execute(change)
        check(attempt, change)
