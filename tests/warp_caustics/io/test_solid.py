"""Height maps read back from solids."""

import numpy as np
import pytest
import trimesh

from warp_caustics.errors import DamagedDataError, InputError, MismatchError
from warp_caustics.io.mesh import height_field_mesh, write_mesh
from warp_caustics.io.solid import read_solid, top_heights
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=24, image_pixels=24, plate_size_m=(0.05, 0.04), base_thickness_m=2e-3)
RELIEF = line_relief([Line((-0.02, -0.01), (0.01, 0.015), 6e-3, 5e-4)], 24, SCENE.plate_size_m)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_what_is_written_is_read_back(tmp_path, suffix):
    path = tmp_path / f"plate{suffix}"
    write_mesh(path, height_field_mesh(RELIEF, SCENE.plate_size_m, SCENE.base_thickness_m))
    np.testing.assert_allclose(read_solid(path, SCENE), RELIEF, atol=2e-8)


def test_a_solid_may_lie_anywhere(tmp_path):
    mesh = height_field_mesh(RELIEF, SCENE.plate_size_m, SCENE.base_thickness_m)
    mesh.apply_translation([25.0, 20.0, -3.0])
    mesh.export(tmp_path / "plate.stl")
    np.testing.assert_allclose(read_solid(tmp_path / "plate.stl", SCENE), RELIEF, atol=1e-8)


def test_another_grid_samples_the_triangles(tmp_path):
    """A ramp is linear between its vertices: every grid sees it exactly, but for the flat outermost half cells."""
    x = (np.arange(24) + 0.5) / 24 - 0.5
    write_mesh(tmp_path / "ramp.stl", height_field_mesh(np.tile(1e-3 * (x + 1), (24, 1)), SCENE.plate_size_m, 2e-3))
    fine = read_solid(tmp_path / "ramp.stl", SCENE.model_copy(update={"height_samples": 60}))
    centres = (np.arange(60) + 0.5) / 60 - 0.5
    np.testing.assert_allclose(fine[30, 2:-2], 1e-3 * (centres[2:-2] + 1), atol=2e-8)


def test_the_highest_of_several_surfaces_counts():
    low = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]
    high = [[0, 0, 1], [4, 0, 1], [0, 4, 3]]
    wall = [[1, 0, 0], [1, 4, 0], [1, 0, 9]]
    top = top_heights(np.array([high, low, wall], float), np.array([0.5, 3.9]), np.array([0.5, 1.0]))
    np.testing.assert_allclose(top, [[1.25, -np.inf], [1.5, -np.inf]])


def test_another_size_is_refused(tmp_path):
    mesh = height_field_mesh(RELIEF, SCENE.plate_size_m, SCENE.base_thickness_m)
    mesh.apply_scale(1e-3)
    mesh.export(tmp_path / "metres.stl")
    with pytest.raises(MismatchError, match=r"0.05 mm along x, the plate 50 mm \(files of this kind are read as milli"):
        read_solid(tmp_path / "metres.stl", SCENE)


def test_a_hole_and_rubbish_are_told(tmp_path):
    mesh = height_field_mesh(RELIEF, SCENE.plate_size_m, SCENE.base_thickness_m)
    z = mesh.triangles_center
    inside = (np.hypot(z[:, 0], z[:, 1]) < 3) & (mesh.face_normals[:, 2] > 0.5)
    below = mesh.face_normals[:, 2] < -0.5
    trimesh.Trimesh(mesh.vertices, mesh.faces[~inside & ~below], process=False).export(tmp_path / "hole.stl")
    with pytest.raises(InputError, match="has a hole at"):
        read_solid(tmp_path / "hole.stl", SCENE)
    whole = (tmp_path / "hole.stl").read_bytes()
    for size, content in ((len(whole) - 1, whole[:-1]), (len(whole) + 50, whole + bytes(50))):
        (tmp_path / "length.stl").write_bytes(content)
        with pytest.raises(DamagedDataError, match=rf"length.stl' has {size} bytes, and .* take {len(whole)}; copy"):
            read_solid(tmp_path / "length.stl", SCENE)
    (tmp_path / "bad.stl").write_bytes(b"solid but not really\n" * 9)
    with pytest.raises(DamagedDataError):
        read_solid(tmp_path / "bad.stl", SCENE)
