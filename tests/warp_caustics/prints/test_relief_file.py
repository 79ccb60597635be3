"""Lists and designs as reliefs: what no print can be is refused as it is of height maps."""

import numpy as np
import pytest

from warp_caustics.errors import InputError
from warp_caustics.io.heights import MAX_HEIGHT_M, read_heights
from warp_caustics.prints.relief_file import read_relief

PLATE = (0.05, 0.05)
NAMES = "start_x_mm,start_y_mm,end_x_mm,end_y_mm,width_mm,height_um"
DESIGN = "merge: sum\nlines:\n- {{start_x_mm: {x}, start_y_mm: 0, end_x_mm: {x}, end_y_mm: 5, width_mm: 6, height_um: {h}}}\n"


def relief(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    return read_relief(tmp_path / name, 32, PLATE, "height map")


def test_lines_that_miss_the_plate_are_a_slip_of_the_unit(tmp_path):
    """Silence would be the image of a flat plate."""
    with pytest.raises(InputError, match=r"no line of .* lies on the plate of 50 x 50 mm.*check the unit"):
        relief(tmp_path, "a.csv", f"{NAMES}\n500,500,600,600,6,300\n")
    with pytest.raises(InputError, match="no line of .* lies on the plate"):
        relief(tmp_path, "a.yaml", DESIGN.format(x=500, h=300))


def test_lines_without_glass_are_a_flat_plate(tmp_path):
    np.testing.assert_array_equal(relief(tmp_path, "a.csv", f"{NAMES}\n0,0,6,6,6,0\n"), 0.0)


def test_lines_as_high_as_no_map_may_be_are_refused(tmp_path):
    line = "-10,0,10,0,6,300\n"
    assert relief(tmp_path, "a.csv", f"{NAMES}\n{line * 100}").max() < MAX_HEIGHT_M
    with pytest.raises(InputError, match=r"piles lines up to 0\.\d+ m, above 0\.1 m; check the unit of heights"):
        relief(tmp_path, "a.csv", f"{NAMES}\n{line * 500}")
    with pytest.raises(InputError, match="piles lines up to"):
        relief(tmp_path, "a.yaml", DESIGN.format(x=0, h=900000))


@pytest.mark.parametrize("name", ["a.stl", "a.obj", "a.ply"])
def test_a_solid_is_told_where_it_is_read(tmp_path, name):
    (tmp_path / name).write_bytes(bytes(80) + b"\1\0\0\0" + bytes(50))
    with pytest.raises(InputError, match="of solids nsfc inspect --nominal reads the top; give heights in metres"):
        read_heights(tmp_path / name)


def test_what_is_no_map_is_not_asked_for_as_a_picture(tmp_path):
    """Pictures of 16 bits are refused as heights: to ask for one would send in a circle."""
    (tmp_path / "a.txt").write_text("words")
    with pytest.raises(InputError, match="is text; give heights in metres as NPY, NPZ, float TIFF or HDF5") as caught:
        read_heights(tmp_path / "a.txt")
    assert "16-bit" not in str(caught.value)
