"""Damaged images, tables and solids end in one line and an exit code of 2 to 6: never in a bug, never late, never large."""

import random
import resource
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from fuzzing import check, damaged, outcome


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


def test_vertices_of_two_numbers_are_refused(tmp_path):
    """Found by the long part of the test above."""
    from warp_caustics.io.solid import read_solid
    from warp_caustics.scene import Scene

    path = tmp_path / "x.obj"
    path.write_text("v 0 0\nv 50 0\nv 0 50\nf 1 2 3\n")
    code, message = outcome(lambda: read_solid(path, Scene()))
    assert (code, "numbers" in message) == (4, True), message


def test_a_face_of_a_million_corners_is_refused(tmp_path):
    from warp_caustics.io.solid import read_solid
    from warp_caustics.scene import Scene

    path = tmp_path / "x.obj"
    path.write_text("v 0 0 0\nv 50 0 0\nv 0 50 0\nf " + "1 2 3 " * 300_000)
    code, message = outcome(lambda: read_solid(path, Scene()))
    assert (code, "corners" in message) == (3, True), message
