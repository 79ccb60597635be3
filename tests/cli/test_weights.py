"""``nsfc weights``."""

import json

import pytest

from cli.main import main
from nets.architecture import build
from nets.residual_config import BackboneConfig, DirectConfig
from nets.weights import save_weights
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=8, image_pixels=16)
TINY = DirectConfig(backbone=BackboneConfig(widths=(4, 4), depths=(1, 1)))


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """Weights of a tiny network."""
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    training = {"epochs": 7, "best": {"rmse_um": 12.5}, "legs_before": [{"steps": 3}, {"steps": 4}]}
    save_weights(path, build(TINY, SCENE), scene=SCENE, data_fingerprint="abc", training=training)
    return path


def test_info_says_what_is_in_a_file(file, capsys):
    assert main(["weights", "info", str(file)]) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert lines["architecture.kind"] == "direct"
    assert lines["architecture.backbone.widths"] == "[4, 4]"
    assert lines["scene.image_pixels"] == "16"
    assert lines["training.best.rmse_um"] == "12.5"
    assert (lines["training.legs_before.1.steps"], lines["training.legs_before.2.steps"]) == ("3", "4")
    assert lines["data_fingerprint"] == "abc"
    assert lines["receptive_field.height_samples"] == "-"
    module = build(TINY, SCENE)
    assert int(lines["parameters"]) == sum(parameter.numel() for parameter in module.parameters())
    assert int(lines["receptive_field.image_pixels"]) > 16
    assert len(lines["content_hash"]) == 64


def test_info_as_json(file, capsys):
    assert main(["weights", "info", str(file), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["file"] == str(file)
    assert record["training"]["best"] == {"rmse_um": 12.5} and len(record["training"]["legs_before"]) == 2
    assert Scene.model_validate(record["scene"]) == SCENE
    assert record["receptive_field"]["sees_all"] is True


def damaged(file, tmp_path):
    content = bytearray(file.read_bytes())
    content[-1] ^= 1
    (tmp_path / "damaged.safetensors").write_bytes(content)
    return str(tmp_path / "damaged.safetensors")


def test_verify_names_every_file(file, tmp_path, capsys):
    foreign = tmp_path / "foreign.pt"
    foreign.write_bytes(b"PK\x03\x04 and so on")
    assert main(["weights", "verify", str(file), damaged(file, tmp_path), str(foreign)]) == 4
    said = capsys.readouterr()
    assert said.out.startswith(f"{file}: ok, direct, ")
    assert [line.split(": ")[0] for line in said.err.splitlines()] == ["error", "error"]
    assert "damaged" in said.err.splitlines()[0] and "never opened" in said.err.splitlines()[1]


@pytest.mark.parametrize(
    ("content", "code"), [(None, 3), (b"", 3), (b"PK\x03\x04 and so on", 5), (b"\x10\0\0\0\0\0\0\0{", 4)]
)
@pytest.mark.parametrize("command", ["info", "verify"])
def test_exit_code_says_what_is_wrong(command, content, code, tmp_path, capsys):
    path = tmp_path / "weights.safetensors"
    if content is not None:
        path.write_bytes(content)
    assert main(["weights", command, str(path)]) == code
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("error: ") and said.err.count("\n") == 1


def test_verify_as_json(file, tmp_path, capsys):
    assert main(["weights", "verify", str(file), damaged(file, tmp_path), "--json"]) == 4
    record = json.loads(capsys.readouterr().out)
    assert record["ok"] is False
    assert [entry["ok"] for entry in record["files"]] == [True, False]
    assert "damaged" in record["files"][1]["error"]


def test_verify_wants_a_file():
    assert main(["weights", "verify"]) == 2


def test_the_list_names_every_shipped_network_and_its_use(capsys):
    from cli.weights import USES
    from nets.shipped import shipped_weights

    assert main(["weights", "list"]) == 0
    names = {line.split()[0] for line in capsys.readouterr().out.splitlines()} - {"nsfc"}
    assert names == set(USES) == {file.stem for file in shipped_weights()}
    assert main(["weights", "list", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["networks"]) == len(USES)
