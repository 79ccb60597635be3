"""The printed solid: closed, of the right size and volume, the right way round."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from warp_caustics.errors import InputError
from warp_caustics.io import height_field_mesh, write_mesh

SIZE, BASE = 0.05, 3e-3


def random_relief(n: int = 24) -> np.ndarray:
    return 2e-3 * np.random.default_rng(7).random((n, n)) - 1e-3


@pytest.mark.parametrize("n", [2, 3, 24])
def test_solid_is_closed_and_oriented(n: int) -> None:
    mesh = height_field_mesh(random_relief(n), SIZE, BASE)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.is_volume
    assert mesh.body_count == 1 and mesh.euler_number == 2
    assert mesh.volume > 0
    assert mesh.area_faces.min() > 0
    assert len(mesh.faces) == 2 * (n + 1) ** 2 + 12 * (n + 1)
    assert mesh.units == "mm"
    centre = mesh.triangles_center
    below, above = np.isclose(centre[:, 2], 0), centre[:, 2] > 2.0 + 1e-6
    assert (mesh.face_normals[below, 2] < -0.99).all()
    inside = (np.abs(centre[:, :2]) < 25 - 1e-9).all(axis=1)
    assert (mesh.face_normals[above & inside, 2] > 0).all()


def test_flat_plate_has_the_volume_of_a_box() -> None:
    mesh = height_field_mesh(np.full((16, 16), 1e-3), SIZE, BASE)
    assert mesh.volume == pytest.approx(50 * 50 * 4, rel=1e-12)
    assert mesh.area == pytest.approx(2 * 50 * 50 + 4 * 50 * 4, rel=1e-12)


@pytest.mark.parametrize("axis", [0, 1])
def test_wedge_has_the_volume_of_a_prism(axis: int) -> None:
    """h = s (x + W/2) with the outermost half cells continued flat: they cancel, so V = A (d + s W/2)."""
    n, slope = 20, 0.02
    ramp = slope * SIZE * (np.arange(n) + 0.5) / n
    heights = np.broadcast_to(ramp, (n, n)) if axis == 1 else np.broadcast_to(ramp[:, None], (n, n))
    mesh = height_field_mesh(heights, SIZE, BASE)
    assert mesh.volume == pytest.approx(1e9 * SIZE**2 * (BASE + slope * SIZE / 2), rel=1e-12)
    # Centre of mass of a trapezoid lies towards the thick side, d_x = s W^2 / (12 (d + s W/2)), less the flat rims.
    shift = 1e3 * slope * SIZE**2 / (12 * (BASE + slope * SIZE / 2))
    assert mesh.center_mass[1 - axis] == pytest.approx(shift, rel=5e-3)
    assert mesh.center_mass[axis] == pytest.approx(0, abs=1e-9)


def test_span_and_place_of_a_peak() -> None:
    heights = np.zeros((10, 10))
    heights[2, 7] = 1e-3
    mesh = height_field_mesh(heights, (0.05, 0.03), BASE)
    np.testing.assert_allclose(mesh.bounds, [[-25, -15, 0], [25, 15, 4]], atol=1e-12)
    peak = mesh.vertices[mesh.vertices[:, 2].argmax()]
    np.testing.assert_allclose(peak, [-25 + 7.5 * 5, -15 + 2.5 * 3, 4], atol=1e-12)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_files_hold_the_same_solid_in_millimetres(tmp_path: Path, suffix: str) -> None:
    mesh = height_field_mesh(random_relief(), SIZE, BASE)
    write_mesh(tmp_path / f"plate{suffix}", mesh)
    assert [file.name for file in tmp_path.iterdir()] == [f"plate{suffix}"]
    back = trimesh.load_mesh(tmp_path / f"plate{suffix}")
    assert back.is_watertight and back.is_winding_consistent
    np.testing.assert_allclose(back.extents[:2], 50, atol=1e-3)
    np.testing.assert_allclose(back.bounds, mesh.bounds, atol=1e-5)
    assert back.volume == pytest.approx(mesh.volume, rel=1e-6)
    if suffix == ".stl":
        assert (tmp_path / "plate.stl").stat().st_size == 84 + 50 * len(mesh.faces)


def hole(value: float) -> np.ndarray:
    heights = np.zeros((6, 6))
    heights[4, 1] = value
    return heights


@pytest.mark.parametrize(
    ("heights", "size", "base", "text"),
    [
        (hole(-3.5e-3), SIZE, BASE, "-0.5 mm thick at [4, 1]"),
        (hole(-BASE), SIZE, BASE, "0 mm thick at [4, 1]"),
        (hole(np.nan), SIZE, BASE, "[4, 1] is nan"),
        (np.zeros((4, 5)), SIZE, BASE, "shape (4, 5)"),
        (np.zeros((1, 1)), SIZE, BASE, "at least 2 x 2"),
        (np.zeros((4, 4)), 50, BASE, "give metres"),
        (np.zeros((4, 4)), (0.05, 0.0), BASE, "give metres"),
        (np.zeros((4, 4)), SIZE, 3.0, "give metres"),
    ],
)
def test_unprintable_plates(heights: np.ndarray, size: float, base: float, text: str) -> None:
    with pytest.raises(InputError) as caught:
        height_field_mesh(heights, size, base)
    assert text in str(caught.value) and "\n" not in str(caught.value)


def test_only_closed_solids_are_written(tmp_path: Path) -> None:
    mesh = height_field_mesh(random_relief(), SIZE, BASE)
    inside_out = mesh.copy()
    inside_out.invert()
    opened = trimesh.Trimesh(mesh.vertices, mesh.faces[:-1], process=False)
    for bad in (inside_out, opened):
        with pytest.raises(InputError, match="closed solid"):
            write_mesh(tmp_path / "x.stl", bad)
    with pytest.raises(InputError, match="use one of .stl"):
        write_mesh(tmp_path / "x.3mf", mesh)
    assert list(tmp_path.iterdir()) == []


def test_a_failing_writer_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = height_field_mesh(random_relief(), SIZE, BASE)

    def fail(path: str, **_: object) -> None:
        Path(path).write_bytes(b"half")
        raise RuntimeError("interrupted")

    monkeypatch.setattr(mesh, "export", fail)
    with pytest.raises(RuntimeError, match="interrupted"):
        write_mesh(tmp_path / "x.stl", mesh)
    assert list(tmp_path.iterdir()) == []
