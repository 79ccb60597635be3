"""Designs as lists of lines."""

from pathlib import Path

import numpy as np
import pytest

from warp_caustics.errors import InputError
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.prints.line_list import read_lines, write_lines

EXAMPLES = Path(__file__).parents[3] / "examples" / "data"
NAMES = "start_x_mm,start_y_mm,end_x_mm,end_y_mm,width_mm,height_um"


def test_the_example_is_the_print():
    """As whoever reads the list gets it: means over cells."""
    relief = line_relief(read_lines(EXAMPLES / "printed_lines.csv"), 128, (0.05, 0.05))
    np.testing.assert_allclose(relief, np.load(EXAMPLES / "true_heights.npy"), atol=1e-12)


def test_units_stand_in_the_names(tmp_path):
    (tmp_path / "a.csv").write_text(f"\ufeff{NAMES}\n-10,0,10.5,2,1.5,300\n\n")
    (tmp_path / "b.yaml").write_text(
        "lines:\n- {start_x_m: -0.01, start_y_m: 0, end_x_mm: 10.5, end_y_um: 2000, width_mm: 1.5, height_mm: 0.3}\n"
    )
    (a,), (b,) = read_lines(tmp_path / "a.csv"), read_lines(tmp_path / "b.yaml")
    wanted = Line((-0.01, 0.0), (0.0105, 0.002), 1.5e-3, 3e-4)
    for line in (a, b):
        np.testing.assert_allclose(
            (*line.start_m, *line.end_m, line.width_m, line.height_m),
            (*wanted.start_m, *wanted.end_m, wanted.width_m, wanted.height_m),
        )


YAML = "- {start_x_mm: 0, start_y_mm: 0, end_x_mm: 1, end_y_mm: 1, width_mm: 1, height_um: %s}\n"


@pytest.mark.parametrize("number", ["yes", "true", "1:30", "1_0", "0x10", "0o10", "'1_0'", "1e999", "[1]", "~"])
def test_yaml_that_is_no_decimal_number_is_refused(tmp_path, number):
    (tmp_path / "a.yaml").write_text(YAML % number)
    with pytest.raises(InputError, match="height_um is .*, not a finite number"):
        read_lines(tmp_path / "a.yaml")


@pytest.mark.parametrize("number", ["1_0", "yes", "0x10", "1:30", "1,5", "\u0661", "1e", "inf"])
def test_csv_that_is_no_decimal_number_is_refused(tmp_path, number):
    (tmp_path / "a.csv").write_text(f'{NAMES}\n0,0,1,1,1,"{number}"\n')
    with pytest.raises(InputError, match="height_um is .*, not a finite number"):
        read_lines(tmp_path / "a.csv")


@pytest.mark.parametrize("number", ["10", "010", "+1e1", "10.", " 10.0"])
def test_numbers_mean_the_same_in_both_formats(tmp_path, number):
    (tmp_path / "a.yaml").write_text(YAML % number)
    (tmp_path / "a.csv").write_text(f"{NAMES}\n0,0,1,1,1,{number}\n")
    for name in ("a.yaml", "a.csv"):
        (line,) = read_lines(tmp_path / name)
        assert line.height_m == pytest.approx(1e-5)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.yaml", YAML.replace("width_mm: 1,", "width_mm: 1, width_mm: 2,") % 1, "'width_mm' is given twice"),
        ("a.yaml", f"lines:\n{YAML % 1}lines:\n{YAML % 2}", "'lines' is given twice"),
        ("a.yaml", f"- &a {YAML[2:] % 1}- *a\n", "aliases"),
        ("a.csv", NAMES + ",width_mm\n0,0,1,1,1,300,2\n", "column 'width_mm' is given twice"),
    ],
)
def test_nothing_is_given_twice(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read_lines(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "", "is empty"),
        ("a.csv", NAMES + "\n", "holds no lines"),
        ("a.csv", NAMES + "\n1,2,3\n", "row 2 has 3 values, the first row 6 names"),
        ("a.csv", NAMES + "\n0,0,1,1,x,300\n", "row 2: width_mm is 'x', not a finite number"),
        ("a.csv", NAMES + "\n0,0,1,1,nan,300\n", "width_mm is 'nan'"),
        ("a.csv", NAMES.replace("width_mm", "width") + "\n0,0,1,1,1,1\n", "column 'width' is not known"),
        ("a.csv", NAMES.replace(",height_um", "") + "\n0,0,1,1,1\n", "height missing; give each with a unit"),
        ("a.csv", NAMES.replace("height_um", "width_m") + "\n0,0,1,1,1,1\n", "width is given twice"),
        ("a.csv", NAMES.replace("mm", "m") + "\n-10,0,10,2,1,300\n", "above 1 m; check the units"),
        ("a.csv", NAMES + "\n0,0,1,1,0,300\n", "a line 0 mm wide and 0.3 mm high is none; give a width above 0"),
        ("a.csv", NAMES.replace(",", ";") + "\n0;0;1,5;1;1;300\n", "separates its columns by ';'; use ','"),
        ("a.csv", NAMES.replace(",", "\t") + "\n0\t0\t1\t1\t1\t300\n", "separates its columns by '\\t'; use ','"),
        ("a.csv", NAMES + "\n0,0,1,1,1," + 5000 * "9" + "\n", "999..., not a finite number; write for example 1.5"),
        ("a.csv", 5000 * "x" + ",b\n1,2\n", "xxx...' is not known; use start_x"),
        ("a.yaml", "{lines: 3}", "is no list of mappings"),
        ("a.yaml", "a: [", "a.yaml': expected the node content"),
        ("a.txt", "x", "is no list of lines; give .csv"),
    ],
)
def test_errors_name_the_place(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as caught:
        read_lines(tmp_path / name)
    assert message in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_what_is_written_is_read(tmp_path):
    lines = [Line((-0.0123456, 0.02), (0.001, -0.025), 4.05e-4, 8.9e-4), Line((0.0, 0.0), (0.01, 0.0), 1e-3, 0.0)]
    write_lines(tmp_path / "lines.csv", lines)
    for found, line in zip(read_lines(tmp_path / "lines.csv"), lines, strict=True):
        for name in ("start_m", "end_m", "width_m", "height_m"):
            assert getattr(found, name) == pytest.approx(getattr(line, name), abs=1e-8)
    write_lines(tmp_path / "none.csv", [])
    with pytest.raises(InputError, match="holds no lines"):
        read_lines(tmp_path / "none.csv")


def test_a_long_list_in_yaml_is_told_to_be_csv(tmp_path):
    """Ten thousand lines are read as CSV; as YAML they are more than is parsed in seconds, and the mend is told."""
    keys, numbers = NAMES.split(","), ("-10.123", "-5.25", "10.5", "2.75", "1.500", "300.00")
    row = ", ".join(f"{key}: {number}" for key, number in zip(keys, numbers, strict=True))
    (tmp_path / "long.yaml").write_text("lines:\n" + f"- {{{row}}}\n" * 10_000)
    with pytest.raises(InputError, match=r"characters, of YAML at most 1000000 are read; write the lines as CSV"):
        read_lines(tmp_path / "long.yaml")
    (tmp_path / "long.csv").write_text(f"{NAMES}\n" + f"{','.join(numbers)}\n" * 10_000)
    assert len(read_lines(tmp_path / "long.csv")) == 10_000
