"""Wrong input of every kind ends in one line and an exit code of 2 to 6: never in a bug, never late, never large.

A short part runs with every test run; ``-m slow`` runs the same for longer. Seeds are fixed: what fails fails again.
"""

import hashlib
import json
import math
import os
import random
import resource
import signal
import sqlite3
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest

from cli.failures import explained

SECONDS = 20
"""For one attempt, on a busy machine."""
MAX_GROWTH = 1_500_000_000
"""Of the peak memory over all attempts of a kind [bytes]."""


class TooLate(BaseException):
    """Not an Exception: no reader may take it for damage."""


def outcome(action):
    """Exit code and message of an attempt; 0 where it was accepted."""

    def stop(*_):
        raise TooLate

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    try:
        action()
    except Exception as error:
        message, code = explained(error)
        return code, message
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    return 0, ""


def check(action, what):
    code, message = outcome(action)
    assert code in (0, 2, 3, 4, 5, 6), f"{what!r:.300}: {message}"
    if code:
        assert message and "\n" not in message.strip() and len(message) < 1200, f"{what!r:.300}: {message!r:.2000}"


@pytest.fixture(autouse=True)
def bounded_memory():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    yield
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - before < MAX_GROWTH


@pytest.fixture(params=[pytest.param(1, id="short"), pytest.param(20, id="long", marks=pytest.mark.slow)])
def rounds(request):
    return request.param


def damaged(content, rng):
    """Bytes with something wrong: flipped, cut, repeated, overwritten or foreign."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 8))):
        kind, at = rng.randrange(6), rng.randrange(max(1, len(data)))
        if not data:
            break
        if kind == 0:
            data[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del data[at:]
        elif kind == 2:
            data[at:at] = data[at : at + rng.randrange(64)]
        elif kind == 3:
            data[at : at + 4] = rng.choice((b"\xff" * 4, b"\0" * 4, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f"))
        elif kind == 4:
            del data[at : at + rng.randrange(1, 64)]
        else:
            # Headers are where sizes stand.
            data[min(at, rng.randrange(128)) % len(data)] = rng.randrange(256)
    return bytes(data)


# --------------------------------------------------------------------------- configurations

SCALARS = [
    "0", "-1", "1e400", "-1e400", "1e-400", "1e-30", "nan", ".nan", ".inf", "-.inf", "null", "~", "true", "yes", "''",
    '""', "3mm", "530nm", "-5um", "3 parsec", "1e999mm", "0x10", "1:30", "1_0", "!!int ''", "!!bool x", "!!float x",
    "!!timestamp x", "!!binary =", "!!set {a}", "!foo bar", "*a", "&a b", "[[]]", "{}", "[]", "{a: {b: c}}", "[1, [2]]",
    "2022-02-30", "'\\u0000'", '"\\uD800"', "9" * 5000, "-" + "9" * 400, "1." + "0" * 400, "[" * 200, "{" * 200 + "a",
    "a: b: c", "- -", "%", "@", "`", "\t", "<<", "? a", "'", '"', "|", ">", "\u2028", "\ufeff1", "=", "..", "1..2", "auto",
    "9223372036854775808", "18446744073709551616", "[9223372036854775808]", "1e308", "[1e308, -1e308]",
]  # fmt: skip


def leaves(tree, at=()):
    for key, value in tree.items():
        yield (*at, key)
        if isinstance(value, dict):
            yield from leaves(value, (*at, key))


def yaml_text(path, value):
    return (
        "".join(f"{'  ' * depth}{key}:{chr(10) if depth < len(path) - 1 else ' '}" for depth, key in enumerate(path))
        + value
    )


def test_configurations(tmp_path, rounds):
    from cli.config import Config, load_config

    rng = random.Random(1)
    paths = [
        *leaves(Config().model_dump(mode="json")),
        ("nosuch",),
        ("scene", "nosuch"),
        ("reconstruction", "options", "x"),
    ]
    tries = [(path, value) for path in paths for value in SCALARS]
    file = tmp_path / "config.yaml"
    for path, value in rng.sample(tries, min(len(tries), 300 * rounds)):
        check(lambda path=path, value=value: load_config(None, [f"{'.'.join(path)}={value}"]), (path, value))
        text = yaml_text(path, value)
        file.write_text(text, encoding="utf-8")
        check(lambda: load_config(str(file)), text)
    for _ in range(60 * rounds):
        content = damaged((Path(__file__).parents[2] / "configs/paper.yaml").read_bytes(), rng)
        file.write_bytes(content)
        check(lambda: load_config(str(file)), content)


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [x, x, x]\nb: &b [*a, *a, *a]\nc: [*b, *b, *b]",
        "[" * 100_000,
        "{a: " * 20_000,
        "- " * 50_000 + "a",
        "scene: {image_pixels: " + "9" * 500_000 + "}",
        "scene:\n" + "".join(f"  k{i}: 1\n" for i in range(20_000)),
    ],
)
def test_bombs_of_yaml(tmp_path, text):
    from cli.config import load_config

    file = tmp_path / "bomb.yaml"
    file.write_text(text)
    assert outcome(lambda: load_config(str(file)))[0] == 3


@pytest.mark.parametrize(
    "setting", ["", "=", "a", "scene", ".=1", "scene.=1", "scene..x=1", "=1", "scene=1", "a=b=c", "\0=1"]
)
def test_settings_that_are_none(setting):
    from cli.config import load_config

    assert outcome(lambda: load_config(None, [setting]))[0] == 3


# --------------------------------------------------------------------------- images and heights


def png_of(width, height, bits=16, colour=2, chunks=()):
    """A PNG that claims a size and holds next to nothing."""

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(chunks) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """One small file of each format."""
    from PIL import Image

    from warp_caustics.io.images import write_image

    folder = tmp_path_factory.mktemp("images")
    values = np.random.default_rng(0).random((3, 16, 16), np.float32)
    names = [f"x.{suffix}" for suffix in ("png", "tif", "npy", "npz", "h5")]
    for name in names:
        write_image(folder / name, values)
    Image.fromarray((values[0] * 255).astype(np.uint8)).save(folder / "x.jpg")
    try:
        write_image(folder / "x.exr", values)
        names.append("x.exr")
    except Exception:  # OpenEXR is optional
        pass
    return {name: (folder / name).read_bytes() for name in [*names, "x.jpg"]}


def test_images(images, tmp_path, rounds):
    from warp_caustics.io.heights import read_heights
    from warp_caustics.io.images import read_image

    rng = random.Random(2)
    for name, content in images.items():
        path = tmp_path / name
        # Flipped bits make the HDF5 library crash now and then, which nothing in the process can prevent; see formats.md.
        cut = (lambda c: c[: rng.randrange(len(c))]) if name == "x.h5" else (lambda c: damaged(c, rng))
        for _ in range(25 * rounds):
            path.write_bytes(cut(content))
            check(lambda path=path: read_image(path, transfer="srgb" if path.suffix == ".jpg" else None), name)
            if name in ("x.tif", "x.npy", "x.npz", "x.h5"):
                check(lambda path=path: read_heights(path), name)


def claims(folder):
    """Small files that claim to be large."""
    import h5py

    side, planes = 20_000, 64
    with h5py.File(folder / "empty.h5", "w") as file:
        file.create_dataset("image", (planes, 8000, 8000), "f8", chunks=(1, 64, 64), compression="gzip")
    with h5py.File(folder / "few.h5", "w") as file:
        data = file.create_dataset("image", (3, 8000, 8000), "f8", chunks=(1, 64, 64), compression="gzip")
        data[0, 0, 0] = 1.0
    header = {"descr": "<f8", "fortran_order": False, "shape": (planes, 4000, 4000)}
    with open(folder / "claims.npy", "wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
    with (
        zipfile.ZipFile(folder / "claims.npz", "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("image.npy", "w") as stream,
    ):
        np.lib.format.write_array_header_1_0(stream, {**header, "shape": (3, 6000, 6000)})
        for _ in range(108):
            stream.write(bytes(8_000_000))
    (folder / "claims.png").write_bytes(png_of(side, side))
    (folder / "wide.png").write_bytes(png_of(7000, 7000))
    text = struct.pack(">I", 0) + b"teSt" + struct.pack(">I", zlib.crc32(b"teSt"))
    (folder / "chunks.png").write_bytes(png_of(64, 64, chunks=[text] * 300_000))
    return sorted(path for path in folder.iterdir())


def test_what_claims_to_be_large_is_refused_before_it_is_decoded(tmp_path):
    from warp_caustics.capture.read import read_capture
    from warp_caustics.scene import Scene

    scene = Scene(height_samples=16, image_pixels=32)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for path in claims(tmp_path):
        code, message = outcome(lambda path=path: read_capture(str(path), scene))
        assert code in (3, 4, 5), (path.name, message)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    assert grown < 300_000_000


# --------------------------------------------------------------------------- tables, lists and solids

CELLS = ["", "1", "-1", "nan", "inf", "1e999", "1_0", "=1", "a", "\0", '"', "9" * 400, "1e-400", " 1 ", "\u0661"]


def test_tables(tmp_path, rounds):
    from warp_caustics.capture.corners import read_window_file
    from warp_caustics.capture.mixing import read_mixing
    from warp_caustics.io.csv_table import CsvTable
    from warp_caustics.prints.line_list import read_lines

    rng = random.Random(3)
    path = tmp_path / "x.csv"
    headers = [
        "corner,x_px,y_px",
        "x_m,y_m,x_px,y_px",
        "610e-9,530e-9",
        "start_x_mm,start_y_mm,end_x_mm,end_y_mm,width_mm,height_mm",
        "",
    ]
    for _ in range(150 * rounds):
        header = rng.choice(headers)
        width = len(header.split(",")) + rng.choice((0, 0, 0, 1, -1))
        rows = [",".join(rng.choice(CELLS) for _ in range(max(0, width))) for _ in range(rng.randrange(5))]
        content = "\n".join([header, *rows]).encode()
        path.write_bytes(damaged(content, rng) if rng.random() < 0.3 else content)
        for read in (read_window_file, read_mixing, read_lines, lambda p: CsvTable(p, ("a",)).read()):
            check(lambda read=read: read(path), path.read_bytes())


VALUES = [*CELLS, "[1, 2]", "[[1, 2], [3, 4]]", "[[]]", "{a: 1}", "~", "true", "0", "1e30", "-0.5", "3.7", "text"]


def test_designs(tmp_path, rounds):
    """Examples with a value exchanged, or bytes damaged."""
    from warp_caustics.prints.design_file import read_design

    rng = random.Random(6)
    path = tmp_path / "x.yaml"
    examples = [file.read_text() for file in sorted((Path(__file__).parents[2] / "examples/designs").glob("*.yaml"))]
    assert len(examples) > 10
    for _ in range(100 * rounds):
        words = rng.choice(examples).split(": ")
        at = rng.randrange(1, len(words))
        rest = words[at].lstrip("-+.0123456789[]")
        content = ": ".join([*words[:at], rng.choice(VALUES) + rest, *words[at + 1 :]]).encode()
        path.write_bytes(damaged(content, rng) if rng.random() < 0.3 else content)
        check(lambda: read_design(path), path.read_bytes())


def test_solids(tmp_path, rounds):
    from warp_caustics.io.mesh import height_field_mesh, write_mesh
    from warp_caustics.io.solid import read_solid
    from warp_caustics.scene import Scene

    rng = random.Random(4)
    scene = Scene(height_samples=4, image_pixels=8)
    mesh = height_field_mesh(np.full((4, 4), 1e-4), 0.05, 3e-3)
    for suffix in ("stl", "ply", "obj"):
        path = tmp_path / f"x.{suffix}"
        write_mesh(path, mesh)
        content = path.read_bytes()
        for _ in range(25 * rounds):
            path.write_bytes(damaged(content, rng))
            check(lambda path=path: read_solid(path, scene), suffix)


def test_a_face_of_a_million_corners_is_refused(tmp_path):
    from warp_caustics.io.solid import read_solid
    from warp_caustics.scene import Scene

    path = tmp_path / "x.obj"
    path.write_text("v 0 0 0\nv 50 0 0\nv 0 50 0\nf " + "1 2 3 " * 300_000)
    code, message = outcome(lambda: read_solid(path, Scene()))
    assert (code, "corners" in message) == (3, True), message


# --------------------------------------------------------------------------- what the software writes itself


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


def test_scenes_at_the_edge():
    """What no plate of this world has."""
    from cli.config import load_config

    for value in ("1e-30", "0", "-1", "1e300", str(math.pi)):
        for key in ("scene.plate_size_m", "scene.base_thickness_m", "scene.screen_position_m", "scene.wavelengths_m"):
            text = f"[{value}, {value}]" if key.endswith("size_m") else f"[{value}]" if key.endswith("s_m") else value
            check(lambda key=key, text=text: load_config(None, [f"{key}={text}"]), (key, value))
