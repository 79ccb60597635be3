"""Weights files: what goes in comes out, and anything else is refused without running it."""

import json
import pickle
import random

import pytest
import safetensors.torch
import torch
from hypothesis import HealthCheck, assume, given, settings

from nets.architecture import build
from nets.config import UpdaterConfig
from nets.updater import Updater
from nets.weights import load_weights, save_weights
from nets.weights_file import ENTRY, MAX_HEADER_BYTES, decode, encode
from tests.nets.conftest import KINDS, SCENE, inputs, members, scramble
from warp_caustics.errors import CausticsError, DamagedDataError, InputError, MismatchError

TRAINING = {"epochs": 3, "loss": [0.5, 0.25], "note": "µm"}


def save(path, module, **options):
    return save_weights(
        path, module, **{"scene": SCENE, "data_fingerprint": "d" * 64, "training": TRAINING} | options
    )  # fmt: skip


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A small updater and its file."""
    path = tmp_path_factory.mktemp("weights") / "updater.safetensors"
    module = scramble(build(KINDS["updater"], SCENE))
    save(path, module)
    return module, path


def same(a, b):
    a, b = a.state_dict(), b.state_dict()
    return list(a) == list(b) and all(torch.equal(a[key], b[key]) for key in a)


@pytest.mark.parametrize("kind", list(KINDS))
def test_networks_come_back_as_they_were(tmp_path, kind):
    path, module = tmp_path / "net.safetensors", scramble(build(KINDS[kind], SCENE)).eval()
    digest = save(path, module)
    loaded = load_weights(path, scene=SCENE)
    assert same(loaded.module, module)
    assert not loaded.module.training
    assert (loaded.info.architecture, loaded.info.scene, loaded.info.content_hash) == (KINDS[kind], SCENE, digest)
    assert (loaded.info.training, loaded.info.data_fingerprint) == (TRAINING, "d" * 64)
    assert loaded.info.code["nsfc"].count(".") == 2
    assert loaded.info.parameters == sum(parameter.numel() for parameter in module.parameters())
    arguments = inputs()[:1] if kind in ("denoiser", "direct") else inputs()
    with torch.no_grad():
        ours, theirs = module(*arguments), loaded.module(*arguments)
    assert torch.equal(ours[0], theirs[0])


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(members())
def test_every_member_of_the_family_comes_back(tmp_path, network):
    config = UpdaterConfig(network=network)
    with torch.device("meta"):
        assume(sum(parameter.numel() for parameter in Updater(config, SCENE).parameters()) < 300_000)
    module = build(config, SCENE)
    save(tmp_path / "net.safetensors", module)
    loaded = load_weights(tmp_path / "net.safetensors")
    assert same(loaded.module, module)
    assert loaded.info.architecture == config


def test_float16_rounds_by_half_a_thousandth_and_once(tmp_path):
    module, path, again = scramble(build(KINDS["direct"], SCENE)), tmp_path / "a", tmp_path / "b"
    digest = save(path, module, dtype="float16")
    loaded = load_weights(path)
    assert loaded.info.precision == "float16"
    for key, weight in module.state_dict().items():
        found = loaded.module.state_dict()[key]
        assert found.dtype == torch.float32
        assert torch.all((found - weight).abs() <= 2.0**-11 * weight.abs() + 2.0**-25)
    assert save(again, loaded.module, dtype="float16") == digest
    assert again.read_bytes() == path.read_bytes()
    assert 0.5 < path.stat().st_size / (2 * loaded.info.parameters) < 1.5


def test_int8_rounds_kernels_by_half_a_step_of_their_channel(tmp_path):
    module, path = scramble(build(KINDS["direct"], SCENE)), tmp_path / "a"
    save(path, module, dtype="int8")
    loaded = load_weights(path)
    assert loaded.info.precision == "int8"
    assert loaded.info.parameters == sum(weight.numel() for weight in module.state_dict().values())
    kernels = 0
    for key, weight in module.state_dict().items():
        found = loaded.module.state_dict()[key]
        assert found.dtype == torch.float32
        if weight.ndim > 1:
            kernels += 1
            half_step = weight.abs().flatten(1).amax(dim=1) / 254
            assert ((found - weight).abs().flatten(1) <= 1.001 * half_step[:, None]).all()
        else:
            assert torch.all((found - weight).abs() <= 2.0**-11 * weight.abs() + 2.0**-25)
    assert kernels > 10 and path.stat().st_size < 1.5 * loaded.info.parameters
    again = load_weights_after(save(tmp_path / "b", loaded.module, dtype="int8"), tmp_path / "b")
    for key, weight in loaded.module.state_dict().items():
        assert torch.allclose(again.state_dict()[key], weight, rtol=1e-6, atol=0)


def load_weights_after(digest, path):
    loaded = load_weights(path)
    assert loaded.info.content_hash == digest
    return loaded.module


def test_a_kernel_of_bytes_needs_its_steps(tmp_path):
    module = scramble(build(KINDS["direct"], SCENE))
    path = tmp_path / "a"
    save(path, module, dtype="int8")
    saved = (module, path)
    for change, error, reason in (
        (lambda r, t: t.pop("stem.weight#step"), MismatchError, "stem.weight#step is missing"),
        (lambda r, t: t["stem.weight#step"].fill_(float("nan")), DamagedDataError, "not finite: stem.weight#step"),
        (lambda r, t: t.update({"stem.weight": t["stem.weight"].half()}), MismatchError, "is float16, not int8"),
        (lambda r, t: r.update(precision="float16"), MismatchError, "#step belongs to no direct network"),
    ):
        with pytest.raises(error, match=reason):
            load_weights(changed(tmp_path, saved, change))


def test_a_channel_of_zeros_stays_one(tmp_path):
    module = scramble(build(KINDS["direct"], SCENE))
    with torch.no_grad():
        module.stem.weight[0] = 0
    save(tmp_path / "a", module, dtype="int8")
    assert not load_weights(tmp_path / "a").module.stem.weight[0].any()


def test_equal_content_makes_equal_files(tmp_path, saved):
    module, path = saved
    save(tmp_path / "again", module)
    assert (tmp_path / "again").read_bytes() == path.read_bytes()


def test_layout_in_memory_does_not_matter(tmp_path, saved):
    path = saved[1]
    other = load_weights(path).module.to(memory_format=torch.channels_last)
    save(tmp_path / "again", other)
    assert (tmp_path / "again").read_bytes() == path.read_bytes()


@pytest.mark.slow
def test_wrapped_networks_are_saved_unwrapped(tmp_path, saved):
    module, path = saved
    save(tmp_path / "again", torch.compile(module))
    assert (tmp_path / "again").read_bytes() == path.read_bytes()


def test_loading_leaves_random_numbers_alone(saved):
    torch.manual_seed(5)
    expected = torch.rand(1)
    torch.manual_seed(5)
    load_weights(saved[1])
    assert torch.equal(torch.rand(1), expected)


# What is damaged


def test_every_flipped_bit_is_noticed(tmp_path, saved):
    """Half of them in the header, which is a small part of the file."""
    content, generator, path = saved[1].read_bytes(), random.Random(1), tmp_path / "flipped"
    header = 8 + int.from_bytes(content[:8], "little")
    for trial in range(300):
        changed = bytearray(content)
        place = generator.randrange(header if trial % 2 else len(content))
        changed[place] ^= 1 << generator.randrange(8)
        path.write_bytes(changed)
        with pytest.raises((DamagedDataError, MismatchError)):
            load_weights(path)


def test_every_truncation_is_noticed(tmp_path, saved):
    content, path = saved[1].read_bytes(), tmp_path / "short"
    for trial in range(50):
        path.write_bytes(content[: len(content) * trial // 50])
        with pytest.raises(CausticsError) as raised:
            load_weights(path)
        assert isinstance(raised.value, DamagedDataError) or (trial == 0 and "empty" in str(raised.value))
    path.write_bytes(content + b"\0")
    with pytest.raises(DamagedDataError, match="promises"):
        load_weights(path)


def test_swapped_weights_are_noticed(tmp_path, saved):
    """Two tensors of one shape change places; nothing but the hash can tell."""
    record, tensors, digest = decode(saved[1].read_bytes(), "file")
    first, second = "image_branch.unet.merge.0.conv.bias", "image_branch.unet.up.0.conv.bias"
    assert tensors[first].shape == tensors[second].shape
    tensors[first], tensors[second] = tensors[second], tensors[first]
    entry = {ENTRY: json.dumps({"record": record, "sha256": digest})}
    (tmp_path / "swapped").write_bytes(safetensors.torch.save(tensors, entry))
    with pytest.raises(DamagedDataError, match="hashes to"):
        load_weights(tmp_path / "swapped")


def changed(tmp_path, saved, change):
    """A file with a right hash over a wrong content."""
    record, tensors, _ = decode(saved[1].read_bytes(), "file")
    change(record, tensors)
    path = tmp_path / "changed"
    path.write_bytes(encode(record, tensors)[0])
    return path


def poison(value):
    return lambda record, tensors: tensors["update.weight"].view(-1)[3].fill_(value)


@pytest.mark.parametrize(
    ("change", "error", "reason"),
    [
        (poison(float("nan")), DamagedDataError, "not finite: update.weight"),
        (poison(float("-inf")), DamagedDataError, "not finite: update.weight"),
        (lambda r, t: t.pop("update.bias"), MismatchError, "update.bias is missing"),
        (lambda r, t: t.update(more=torch.zeros(1)), MismatchError, "more belongs to no updater network"),
        (lambda r, t: t.update({"update.bias": torch.zeros(2)}), MismatchError, r"has shape \[2\], not \[1\]"),
        (lambda r, t: t.update({"update.bias": torch.zeros(1).half()}), MismatchError, "is float16, not float32"),
        (lambda r, t: r.update(format=2), MismatchError, "has format 2, this program reads 1"),
        (lambda r, t: r.pop("scene"), MismatchError, "says nothing of its scene"),
        (lambda r, t: r["scene"].update(image_pixels=-1), MismatchError, "image_pixels"),
        (lambda r, t: r["architecture"].update(kind="gan"), MismatchError, "does not know"),
        (lambda r, t: r["architecture"].update(later=1), MismatchError, "later: unknown key"),
        (lambda r, t: r["architecture"]["network"].update(m_s=3), MismatchError, "has shape"),
        (lambda r, t: r["normalisation"].update(height_unit_m=1.0), MismatchError, "normalisation"),
        (lambda r, t: r.update(precision="float64"), MismatchError, "precision 'float64'"),
        (lambda r, t: r.update(training=3), MismatchError, "training is no record"),
        # Three wavelengths become one: a network for one channel is another network.
        (
            lambda r, t: r["scene"].update(wavelengths_m=[530e-9], radiosity_W_m2=[1.0]),
            MismatchError,
            "image_branch.* has shape",
        ),
    ],
)
def test_contents_that_do_not_fit_are_refused(tmp_path, saved, change, error, reason):
    with pytest.raises(error, match=reason) as raised:
        load_weights(changed(tmp_path, saved, change))
    assert type(raised.value) is error
    assert "\n" not in str(raised.value)


def test_a_network_of_absurd_size_is_refused_before_it_is_built(tmp_path, saved):
    path = changed(
        tmp_path,
        saved,
        lambda r, t: r["architecture"]["network"].update(m_s=8, n_s=4, k_down=11, k_up=11),
    )
    with pytest.raises(MismatchError, match="cannot be built: network would have"):
        load_weights(path)


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("image_pixels", 128, "image_pixels is 64 there and 128 here"),
        ("plate_size_m", (0.04, 0.05), r"plate_size_m is \(0.05, 0.05\) there and \(0.04, 0.05\) here"),
        ("wavelengths_m", (430e-9, 530e-9, 610e-9), "wavelengths_m is"),
        ("glass", "n_bk7", "glass is fused_silica there and n_bk7 here"),
    ],
)
def test_another_scene_is_refused_with_both_values(saved, field, value, reason):
    other = type(SCENE).model_validate(SCENE.model_dump() | {field: value})
    with pytest.raises(MismatchError, match=reason):
        load_weights(saved[1], scene=other)


@pytest.mark.parametrize(
    "content",
    [
        b"\0",
        (2**63).to_bytes(8, "little") + b"{}",
        (MAX_HEADER_BYTES + 1).to_bytes(8, "little") + b" " * (MAX_HEADER_BYTES + 1),
        (100_000).to_bytes(8, "little") + b"[" * 100_000,
        (2).to_bytes(8, "little") + b"[]",
        (8).to_bytes(8, "little") + b'{"a": 1}',
        (60).to_bytes(8, "little") + b'{"a":{"dtype":"F32","shape":[9],"data_offsets":[0,1' + b"0" * 6 + b"]}}",
    ],
)
def test_absurd_headers_are_refused(tmp_path, content):
    (tmp_path / "absurd").write_bytes(content)
    with pytest.raises(DamagedDataError):
        load_weights(tmp_path / "absurd")


def test_foreign_safetensors_are_refused(tmp_path):
    safetensors.torch.save_file({"weight": torch.zeros(3)}, tmp_path / "foreign.safetensors")
    with pytest.raises(MismatchError, match="not weights of nsfc"):
        load_weights(tmp_path / "foreign.safetensors")


# What could run


class Bomb:
    """Runs code when it is unpickled."""

    def __init__(self, canary):
        self.canary = canary

    def __reduce__(self):
        return open, (str(self.canary), "w")


@pytest.mark.parametrize("forced", [False, True])
@pytest.mark.parametrize("kind", ["pickle", "zip", "legacy"])
def test_pickles_are_refused_without_running(tmp_path, monkeypatch, kind, forced):
    canary, path = tmp_path / "canary", tmp_path / "net.pt"
    if forced:
        monkeypatch.setenv("TORCH_FORCE_NO_WEIGHTS_ONLY_LOAD", "1")
    if kind == "pickle":
        path.write_bytes(pickle.dumps(Bomb(canary)))
    else:
        torch.save({"weight": Bomb(canary)}, path, _use_new_zipfile_serialization=kind == "zip")
    with pytest.raises(MismatchError, match=r"it is never opened; give a \.safetensors file"):
        load_weights(path)
    assert not canary.exists()
    pickle.loads(pickle.dumps(Bomb(canary))).close()
    assert canary.exists(), "the bomb is a dud, so this test proves nothing"


# What is not written


@pytest.mark.parametrize(
    ("value", "dtype", "reason"),
    [
        (float("nan"), "float32", "update.weight reaches nan"),
        (float("inf"), "float32", "update.weight reaches inf"),
        (7e4, "float16", "reaches 70000, float16 ends at 65504"),
    ],
)
def test_weights_that_cannot_be_stored_are_refused(tmp_path, value, dtype, reason):
    module = build(KINDS["updater"], SCENE)
    torch.nn.init.constant_(module.update.weight, value)
    with pytest.raises(InputError, match=reason):
        save(tmp_path / "net", module, dtype=dtype)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("training", [{"loss": float("nan")}, {"module": object()}, {"deep": {"set": {1}}}])
def test_records_that_json_cannot_hold_are_refused(tmp_path, saved, training):
    with pytest.raises(InputError, match="training record"):
        save(tmp_path / "net", saved[0], training=training)


def test_foreign_modules_are_refused(tmp_path):
    with pytest.raises(InputError, match="Linear is no network"):
        save(tmp_path / "net", torch.nn.Linear(2, 2))


def test_a_network_is_not_saved_for_another_scene(tmp_path, saved):
    with pytest.raises(MismatchError, match="height_samples is 16 there and 32 here"):
        save(tmp_path / "net", saved[0], scene=SCENE.model_copy(update={"height_samples": 32}))
