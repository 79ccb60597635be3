"""Folders that may be written to."""

import pytest

from cli.output import checked_folder, made_folder, result_names
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
