"""Building in one process: resume, what is refused, what is told."""

import json

import pytest
from store_synthetic import captures, factory, failing_factory, make_config, shard_bytes, temporaries

from data_gen import dataset_config
from data_gen.config import Perturbation, ReliefConfig
from data_gen.dataset_config import DatasetConfig, PhotonConfig
from data_gen.store import CausticDataset, build, verify
from data_gen.store.layout import Layout, Manifest, canonical_json, read_manifest
from warp_caustics.errors import DamagedDataError, InputError, MismatchError
from warp_caustics.scene import Scene


def drawn(log):
    return [int(line) for line in log.read_text().split()] if log.exists() else []


def test_finished_set_is_left_alone(copied, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in copied.rglob("*.*") if path.name != ".lock"}
    report = build(copied, make_config(), factory(log=str(tmp_path / "log")))
    assert report.shards_built == 0 and drawn(tmp_path / "log") == []
    assert {path: path.stat().st_mtime_ns for path in before} == before


def test_only_what_is_missing_is_made(copied, reference, tmp_path):
    for name in ("shards/00002.h5", "shards/00005.json", "shards/00007.h5", "shards/00007.json", "COMPLETE.json"):
        (copied / name).unlink()
    (copied / "shards" / ".tmp-0123456789abcdef").write_bytes(b"left by a dead builder")
    states = []
    report = build(copied, make_config(), factory(log=str(tmp_path / "log")), progress=states.append)
    assert drawn(tmp_path / "log") == [8, 20, 28]
    assert (report.shards_built, report.samples_built) == (3, 12)
    assert [(state.done, state.total) for state in states] == [(28, 40), (32, 40), (36, 40), (40, 40)]
    assert states[0].eta_s is None and states[-1].rate > 0 and states[-1].eta_s == 0
    assert shard_bytes(copied) == shard_bytes(reference) and not temporaries(copied)
    assert (copied / "COMPLETE.json").read_bytes() == (reference / "COMPLETE.json").read_bytes()


def test_missing_file_of_a_finished_set_makes_it_unfinished_until_it_is_there(copied, reference):
    (copied / "shards" / "00004.h5").unlink()
    with pytest.raises(InputError):
        build(copied, make_config(), factory(trouble="nan", at=17))
    assert not (copied / "COMPLETE.json").exists()
    build(copied, make_config(), factory())
    assert shard_bytes(copied) == shard_bytes(reference) and (copied / "COMPLETE.json").exists()


def test_full_check_rebuilds_what_is_damaged_and_fast_does_not_look(copied, reference):
    path = copied / "shards" / "00006.h5"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)
    assert build(copied, make_config(), factory()).shards_built == 0
    report = build(copied, make_config(), factory(), check="full")
    assert report.shards_built == 1 and "shard 00006 damaged: sha256" in report.notices[0]
    assert shard_bytes(copied) == shard_bytes(reference)


def test_interrupted_repair_is_not_forgotten(copied, reference):
    """The fast check of the next run does not hash; so the damaged file must be gone by then."""
    path = copied / "shards" / "00006.h5"
    data = bytearray(path.read_bytes())
    data[-9] ^= 1
    path.write_bytes(data)
    with pytest.raises(ValueError, match="too thin"):
        build(copied, make_config(), factory(trouble="raise", at=24), check="full")
    build(copied, make_config(), factory())
    assert shard_bytes(copied) == shard_bytes(reference)


def test_shard_that_comes_out_differently_is_refused(folder):
    config = make_config()
    build(folder, config, factory(trouble="random", at=9))
    (folder / "shards" / "00002.h5").unlink()
    with pytest.raises(MismatchError, match="shard 2 is not reproducible: .*same library versions"):
        build(folder, config, factory(trouble="random", at=9))
    assert not (folder / "shards" / "00002.h5").exists()


def test_other_spelling_of_the_same_samples_is_accepted(copied, reference):
    """As another version of zlib would: the manifest's file hash differs, the samples' hashes do not."""
    path = copied / "shards" / "00002.json"
    manifest = Manifest.from_bytes(path.read_bytes())
    other = Manifest(**{**vars(manifest), "sha256": "f" * 64, "n_bytes": manifest.n_bytes + 1})
    path.write_bytes(other.to_bytes())
    (copied / "shards" / "00002.h5").unlink()
    (copied / "COMPLETE.json").unlink()
    build(copied, make_config(), factory())
    assert shard_bytes(copied) == shard_bytes(reference)


CHANGES = {
    "kind": "updater",
    "n_samples": 44,
    "seed": 2,
    "role": "test",
    "samples_per_shard": 5,
    "scene": Scene(image_pixels=32),
    "reliefs": ReliefConfig(perturbation=Perturbation(line_width_m=(-1e-4, 1e-4))),
    "noisy": PhotonConfig(preset="lattice"),
    "clean": PhotonConfig(n_photons=7),
}


@pytest.mark.parametrize("key", sorted(CHANGES))
def test_another_configuration_is_refused(copied, key):
    arguments = {"kind": "denoiser", "n_samples": 40, "samples_per_shard": 4, "seed": 1, key: CHANGES[key]}
    before = (copied / "config.json").read_bytes()
    with pytest.raises(MismatchError, match=rf"[:,] {key}\S* [^,]*(, \S+\])? -> ") as error:
        build(copied, DatasetConfig(**arguments), factory())
    assert len(str(error.value).splitlines()) == 1
    assert (copied / "config.json").read_bytes() == before


def test_other_ranges_of_benches_are_refused(folder):
    config = captures(4)
    build(folder, config, factory())
    wider = config.bench.model_copy(update={"camera": config.bench.camera.model_copy(update={"psf_px": (0.0, 1.5)})})
    with pytest.raises(MismatchError, match=r"bench.camera.psf_px \[0.0, 1.0\] -> \[0.0, 1.5\]"):
        build(folder, config.model_copy(update={"bench": wider}), factory())


def test_every_key_of_the_configuration_is_tried():
    assert {*CHANGES, "bench", "denoiser"} == set(DatasetConfig.model_fields)


def test_both_values_are_named_and_growing_is_explained(copied):
    with pytest.raises(MismatchError, match=r"n_samples 40 -> 44 \(the number of samples belongs to"):
        build(copied, make_config(n_samples=44), factory())


def test_another_generator_is_refused(copied, monkeypatch):
    monkeypatch.setattr(dataset_config, "GENERATOR_VERSION", 2)
    with pytest.raises(MismatchError, match="generator_version 1 -> 2"):
        build(copied, make_config(), factory())


def test_another_code_version_or_compression_is_refused_where_shards_are_missing(copied, monkeypatch):
    from data_gen.store import folder as module

    (copied / "shards" / "00001.h5").unlink()
    with pytest.raises(MismatchError, match="compression gzip -> none"):
        build(copied, make_config(), factory(), compression="none")
    monkeypatch.setattr(module, "code_version", lambda: "9.9")
    with pytest.raises(MismatchError, match=r"code version \S+ -> 9.9"):
        build(copied, make_config(), factory())
    assert (copied / "COMPLETE.json").exists()


def test_order_of_keys_and_spelling_of_numbers_do_not_matter(copied):
    path = copied / "config.json"
    canonical = path.read_bytes()
    tree = json.loads(canonical)
    assert tree["noisy"]["n_photons"] == 1_000_000
    tree["noisy"]["n_photons"] = 1e6
    path.write_text(json.dumps(dict(reversed(tree.items())), indent=2))
    build(copied, make_config(), factory())
    assert path.read_bytes() == canonical
    tree["noisy"]["n_photons"] = True
    path.write_bytes(canonical_json(tree))
    with pytest.raises(MismatchError, match="n_photons"):
        build(copied, make_config(), factory())


def test_other_fields_are_refused(copied):
    (copied / "shards" / "00001.h5").unlink()
    with pytest.raises(MismatchError, match=r"fields image .* -> other float32 \[2\]"):
        build(copied, make_config(), other_fields)


def other_fields(config, device):
    from store_synthetic import SyntheticSampler

    from data_gen.sampler import Field

    sampler = SyntheticSampler(config)
    sampler.fields = (Field("other", (2,), "float32", "m", ""),)
    return sampler


def test_broken_config_is_named(copied):
    (copied / "config.json").write_text("{")
    with pytest.raises(DamagedDataError, match="config.json' is damaged"):
        build(copied, make_config(), factory())
    with pytest.raises(DamagedDataError, match="config.json' is damaged"):
        verify(copied)


def test_config_changed_after_completion_is_seen(copied):
    tree = json.loads((copied / "config.json").read_bytes())
    (copied / "config.json").write_bytes(canonical_json({**tree, "seed": 2}))
    with pytest.raises(DamagedDataError, match="not the one that COMPLETE.json was written for"):
        CausticDataset(copied)
    assert len(verify(copied).problems) == 11


def test_folder_of_somebody_else_is_not_touched(folder):
    folder.mkdir()
    (folder / "thesis.tex").write_text("x")
    with pytest.raises(InputError, match="holds 'thesis.tex' but no config.json"):
        build(folder, make_config(), factory())
    assert {path.name for path in folder.iterdir()} == {"thesis.tex"}


def test_missing_parent_and_file_instead_of_folder(folder):
    with pytest.raises(InputError, match="does not exist; create it first"):
        build(folder / "a" / "b", make_config(), factory())
    folder.write_text("x")
    with pytest.raises(InputError, match="is a file"):
        build(folder, make_config(), factory())


@pytest.mark.parametrize(("trouble", "message"), [("nan", "sample 17: heights"), ("counter", "counter lost")])
def test_wrong_samples_stop_the_build_and_it_can_be_resumed(folder, reference, trouble, message):
    with pytest.raises(InputError, match=message):
        build(folder, make_config(), factory(trouble=trouble, at=17 if trouble == "nan" else 16))
    assert sorted(shard_bytes(folder)) == [f"{shard:05d}.h5" for shard in range(4)] and not temporaries(folder)
    build(folder, make_config(), factory())
    assert shard_bytes(folder) == shard_bytes(reference)


def test_failing_factory_leaves_a_folder_that_can_be_resumed(folder, reference):
    with pytest.raises(RuntimeError, match="no such device"):
        build(folder, make_config(), failing_factory)
    build(folder, make_config(), factory())
    assert shard_bytes(folder) == shard_bytes(reference)


def test_manifests_say_where_data_come_from(reference):
    manifest = read_manifest(Layout(reference).manifest(1))
    assert manifest.ids == (4, 5, 6, 7) and manifest.device == "cpu" and manifest.compression == "gzip"
    assert {"python", "numpy", "h5py", "hdf5", "zlib"} <= set(manifest.libraries)


@pytest.mark.parametrize("arguments", [{"workers": -1}, {"devices": ()}])
def test_impossible_arguments(folder, arguments):
    with pytest.raises(InputError):
        build(folder, make_config(), factory(), **arguments)
