"""Folders that may be written to."""

import pytest

from cli.output import checked_folder, made_folder, result_names, write_table
from warp_caustics.errors import InputError


def ours(name):
    return name.startswith("mine")


def test_a_new_folder_and_one_of_an_earlier_result(tmp_path):
    assert checked_folder(tmp_path / "new", ours) == (tmp_path / "new", [])
    (tmp_path / "mine.csv").touch()
    assert checked_folder(tmp_path, ours) == (tmp_path, ["mine.csv"])
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(InputError, match=r"holds other files \(thesis.tex\); ask"):
        checked_folder(tmp_path, ours, "ask")


def test_no_place_for_a_folder(tmp_path):
    (tmp_path / "file").touch()
    for function in (lambda path: checked_folder(path, ours), lambda path: made_folder(str(path))):
        with pytest.raises(InputError, match="create it first"):
            function(tmp_path / "none" / "out")
        with pytest.raises(InputError, match="is a file|cannot be made a folder"):
            function(tmp_path / "file")
    assert made_folder(str(tmp_path / "new")).is_dir() and made_folder(str(tmp_path / "new")).is_dir()


def test_results_of_one_name_are_refused():
    assert result_names(["a/x.tif", "b/y.z.png"]) == {"a/x.tif": "x", "b/y.z.png": "y.z"}
    with pytest.raises(InputError, match="'a/x.tif' and 'x.png' would both go to the folder 'x'"):
        result_names(["a/x.tif", "x.png"])


def test_a_table_is_whole_or_absent(tmp_path):
    write_table(tmp_path / "t.csv", ("a", "b"), [{"a": 1, "b": "x, y"}, {"a": 2}])
    assert (tmp_path / "t.csv").read_bytes() == b'a,b\r\n1,"x, y"\r\n2,\r\n'
    with pytest.raises(ValueError, match="c"):
        write_table(tmp_path / "t.csv", ("a",), [{"c": 1}])
    assert (tmp_path / "t.csv").read_bytes().startswith(b"a,b") and len(list(tmp_path.iterdir())) == 1
