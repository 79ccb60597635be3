"""``nsfc data``: what people and scripts see; the storage itself is tested in tests/data_gen/store."""

import json
import shutil

import numpy as np
import pytest

from cli.main import main
from data_gen.store import CausticDataset
from data_gen.testset import field_heights
from nets import build
from nets.weights import save_weights
from warp_caustics.io.heights import read_heights
from warp_caustics.io.images import read_image, write_image
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=8, image_pixels=16)
SMALL = ["--set", "scene.height_samples=8", "--set", "scene.image_pixels=16", "--set", "data.samples_per_shard=3"]
FEW = ["--set", "data.noisy.n_photons=500", "--set", "data.clean.n_photons=2000"]


def build_set(folder, *options, kind="updater", n=7):
    arguments = ["data", "build", kind, str(folder), "--n", str(n), "--device", "cpu", "--workers", "0"]
    return main([*arguments, *SMALL, *FEW, *options])


@pytest.fixture(scope="module")
def updater(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "updater"
    assert build_set(folder) == 0
    return folder


def test_build_says_how_large_and_how_long_before_it_starts(tmp_path, capsys):
    assert build_set(tmp_path / "set") == 0
    captured = capsys.readouterr()
    lines = [line.split(maxsplit=1) for line in captured.out.splitlines()]
    assert [line[0] for line in lines] == ["size", "time", "data", "built", "written"]
    assert "3 shards" in lines[0][1] and "about" in lines[1][1]
    assert "7 of 7 samples" in captured.err.splitlines()[-1]


def test_the_same_command_continues_and_another_is_refused(updater, capsys):
    assert build_set(updater) == 0
    assert "built      0 samples in 0 shards" in capsys.readouterr().out
    assert build_set(updater, "--seed", "4") == 5
    error = capsys.readouterr().err.splitlines()[-1]
    assert "seed" in error and "4" in error


def test_denoiser_set_holds_pairs(tmp_path):
    assert build_set(tmp_path / "set", kind="denoiser") == 0
    sample = CausticDataset(tmp_path / "set")[0]
    assert set(sample) == {"id", "noisy", "clean"} and sample["noisy"].shape == (3, 16, 16)


CAMERA = ["--set", "data.bench.camera.psf_px=[0.1,0.5]"]


def test_captures_come_from_benches_of_their_own(full_figures, tmp_path, capsys):
    """Build, what info and the picture say of it, and the same command again."""
    folder = tmp_path / "set"
    assert build_set(folder, "--bench", "careful", *CAMERA, kind="capture", n=4) == 0
    dataset = CausticDataset(folder)
    sample, names = dataset[2], [column.name for column in dataset.columns("bench")]
    assert set(sample) == {"id", "heights", "image", "bench"} and len(names) == len(sample["bench"])
    assert 0.09 < dict(zip(names, sample["bench"].tolist(), strict=True))["psf_px_1"] < 0.53
    capsys.readouterr()
    assert main(["data", "info", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    (gap,) = [line for line in lines if line.startswith("column     gap_m:")]
    assert gap.endswith(" m, plate to screen") and sum(line.startswith("column") for line in lines) == len(names)
    assert main(["data", "info", str(folder), "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)["columns"]) == set(names)
    assert main(["data", "preview", str(folder), "-o", str(tmp_path / "sheet.png"), "--samples", "2"]) == 0
    assert read_image(tmp_path / "sheet.png").values.shape[1] > 400
    assert build_set(folder, "--bench", "careful", *CAMERA, kind="capture", n=4) == 0
    assert build_set(folder, "--bench", "careful", kind="capture", n=4) == 5
    assert "bench.camera.psf_px" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("kind", "options", "reason"),
    [
        ("capture", (), "needs ranges of benches; give --bench ordinary"),
        ("updater", ("--bench", "poor", *CAMERA), "bench is for captures"),
        ("capture", ("--bench", "por"), "bench 'por' is not shipped; did you mean 'poor'"),
        ("capture", ("--bench", "./none.yaml"), "none.yaml"),
        ("capture", ("--bench", "poor"), "too wide for 16 px"),
        ("capture", ("--bench", "poor", "--set", "data.bench.camera.mixing=[1,0]"), "swap them, write"),
        ("capture", ("--bench", "careful", *CAMERA, "--picture", "logo.png"), "add --set data.bench.prints=null"),
    ],
)
def test_benches_that_cannot_be_end_in_one_line(tmp_path, capsys, kind, options, reason):
    assert build_set(tmp_path / "set", *options, kind=kind) == 3
    error = capsys.readouterr().err.splitlines()
    assert len(error) == 1 and reason in error[0]
    assert not (tmp_path / "set").exists()


def test_info_and_verify(updater, capsys):
    assert main(["data", "info", str(updater)]) == 0
    assert "7 of 7 in 3 shards, complete" in capsys.readouterr().out
    assert main(["data", "verify", str(updater), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["shards_right"], record["n_shards"], record["problems"]) == (3, 3, [])


def test_every_sample_of_made_prints_says_how_it_was_made(tmp_path, capsys):
    """In the manifests, and the ranges in config.json; a set that is built again is the same."""
    making = ("--set", "reliefs.pattern=curves", "--set", "reliefs.making.fibre_diameter_m=[0.4mm, 0.4mm]",
              "--set", "reliefs.making.waviness=[0.01, 0.05]", "--set", "reliefs.making.overlaps=[max]")  # fmt: skip
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        assert build_set(folder, *making, n=4) == 0
    first, second = ([CausticDataset(folder)[k]["heights"] for k in range(4)] for folder in folders)
    np.testing.assert_array_equal(first, second)
    manifest = json.loads((folders[0] / "shards" / "00000.json").read_text())["counters"]
    assert manifest["print_fibre_diameter_m"] == [4e-4] * 3 and manifest["print_merging"] == [0.0] * 3
    assert len(set(manifest["print_waviness"])) == 3 and 0.01 <= min(manifest["print_waviness"]) <= 0.05
    assert len(set(manifest["print_contact_angle_rad"])) == 3
    stored = json.loads((folders[0] / "config.json").read_text())["reliefs"]
    assert stored["pattern"] == "curves" and stored["making"]["waviness"] == [0.01, 0.05]
    assert main(["data", "info", str(folders[0])]) == 0
    assert "print contact angle rad: mean" in capsys.readouterr().out


def test_damage_is_named_and_repaired(updater, tmp_path, capsys):
    folder = tmp_path / "set"
    shutil.copytree(updater, folder)
    shard = folder / "shards" / "00001.h5"
    right = shard.read_bytes()
    shard.write_bytes(right[:700] + bytes([right[700] ^ 1]) + right[701:])
    assert main(["data", "verify", str(folder)]) == 4
    assert "shard 00001 damaged" in capsys.readouterr().out
    assert build_set(folder, "--repair") == 0
    assert shard.read_bytes() == right


def test_unfinished_sets_are_shown_but_not_trained_on(updater, tmp_path, capsys):
    folder = tmp_path / "set"
    shutil.copytree(updater, folder)
    (folder / "COMPLETE.json").unlink()
    (folder / "shards" / "00002.json").unlink()
    (folder / "shards" / "00002.h5").unlink()
    assert main(["data", "info", str(folder)]) == 0
    assert "6 of 7 in 2 shards, unfinished" in capsys.readouterr().out
    assert main(["data", "preview", str(folder), "-o", str(tmp_path / "sheet.png")]) == 0
    assert main(["train", "updater", str(folder), "-o", str(tmp_path / "run"), "--max-steps", "1"]) == 5
    assert "2/3" in capsys.readouterr().err


def test_preview_is_a_picture_of_as_many_samples_as_asked_for(full_figures, updater, tmp_path, capsys):
    for count in (1, 3):
        output = tmp_path / f"{count}.png"
        assert main(["data", "preview", str(updater), "-o", str(output), "--samples", str(count)]) == 0
        assert f"{count} samples" in capsys.readouterr().out
    heights = [read_image(tmp_path / f"{count}.png").values.shape[1] for count in (1, 3)]
    assert heights[1] > 2 * heights[0]
    assert main(["data", "preview", str(updater), "-o", str(tmp_path / "x.png"), "--samples", "0"]) == 3


def test_a_picture_is_printed(tmp_path):
    """A bright page with a dark bar in its upper half."""
    page = np.full((1, 32, 32), 255, np.uint8)
    page[:, 4:12, 4:28] = 0
    write_image(tmp_path / "page.png", page)
    assert build_set(tmp_path / "set", "--picture", str(tmp_path / "page.png"), n=1) == 0
    relief = CausticDataset(tmp_path / "set")[0]["heights"].numpy()
    assert relief[4:].sum() > 10 * relief[:4].sum() > 0 or relief[:4].sum() == 0
    assert relief.max() > 0


def test_updater_images_can_be_denoised(tmp_path, capsys):
    """The weights' hash is part of what the data set is."""
    config = build("paper-denoiser", SCENE).config.model_copy(update={"c_init": 2, "m_s": 1, "n_s": 1})
    module = build(config, SCENE)
    hashed = save_weights(tmp_path / "d.safetensors", module, scene=SCENE, data_fingerprint=None, training={})
    assert build_set(tmp_path / "set", "--denoiser", str(tmp_path / "d.safetensors"), n=2) == 0
    stored = json.loads((tmp_path / "set" / "config.json").read_text(encoding="utf-8"))
    assert stored["denoiser"] == hashed
    other = Scene(height_samples=8, image_pixels=24)
    save_weights(tmp_path / "o.safetensors", build(config, other), scene=other, data_fingerprint=None, training={})
    assert build_set(tmp_path / "other", "--denoiser", str(tmp_path / "o.safetensors"), n=2) == 5
    assert "image_pixels" in capsys.readouterr().err


def test_testset_writes_heights_and_images(tmp_path, capsys):
    few = [*SMALL[:4], "--device", "cpu", "--set", "data.clean.n_photons=4000"]
    assert main(["data", "testset", str(tmp_path / "t"), "--fields", "2", *few]) == 0
    assert "field_1" in capsys.readouterr().out
    np.testing.assert_allclose(read_heights(tmp_path / "t" / "field_1_heights.npy"), field_heights(SCENE)[1])
    assert read_image(tmp_path / "t" / "field_0_image.tif").values.shape == (3, 16, 16)
    record = json.loads((tmp_path / "t" / "testset.json").read_text(encoding="utf-8"))
    assert record["fields"] == ["field_0", "field_1"]
    assert record["set"] == "development" and record["photons"]["n_photons"] == 4000
    assert main(["data", "testset", str(tmp_path / "t"), "--fields", "11"]) == 3
    assert main(["data", "testset", str(tmp_path / "u"), "--fields", "1", "--which", "test", *few]) == 0
    other = json.loads((tmp_path / "u" / "testset.json").read_text(encoding="utf-8"))
    assert other["set"] == "test" and other["fingerprint"] != record["fingerprint"]
    assert not np.array_equal(read_heights(tmp_path / "u" / "field_0_heights.npy"), field_heights(SCENE)[0])


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["build", "updater", "{}/missing/set", "--n", "3"], 3, "missing"),
        (["build", "updater", "{}/set", "--n", "0"], 3, "n_samples"),
        (["build", "updater", "{}/set", "--n", "3", "--seed", "-1"], 3, "seed"),
        (["build", "printer", "{}/set", "--n", "3"], 2, "printer"),
        (["build", "updater", "{}/set", "--n", "3", "--picture", "{}/no.png"], 3, "no.png"),
        (["build", "updater", "{}/set", "--n", "3", "--set", "reliefs.pattern=spiral"], 3, "spiral"),
        (["info", "{}"], 3, "config.json"),
        (["verify", "{}/nowhere"], 3, "nowhere"),
        (["preview", "{}", "-o", "{}/x.png"], 3, "config.json"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(tmp_path, capsys, arguments, code, words):
    extra = ["--device", "cpu"] if arguments[0] == "build" else []
    assert main(["data", *(argument.format(tmp_path) for argument in arguments), *extra]) == code
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith("error: ") and words in lines[-1], lines
