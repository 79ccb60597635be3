"""Tables as CSV: complete or absent, and readable after a crash."""

import hashlib

import pytest

from warp_caustics.errors import DamagedDataError
from warp_caustics.io.csv_table import CsvTable
from warp_caustics.io.hashes import file_sha256

ROWS = [{"name": "a, b", "value": 1}, {"name": 'line\nbreak "quoted"', "value": 0.5}]
READ = [{"name": "a, b", "value": "1"}, {"name": 'line\nbreak "quoted"', "value": "0.5"}]


@pytest.fixture
def table(tmp_path):
    return CsvTable(tmp_path / "table.csv", ("name", "value"))


def test_rows_come_back_as_text(table):
    table.write(ROWS)
    assert table.read() == READ == table.read(is_exact=True)
    assert table.path.read_bytes() == b'name,value\r\n"a, b",1\r\n"line\nbreak ""quoted""",0.5\r\n'


def test_appended_rows_follow_and_cells_left_out_are_empty(table):
    table.write()
    table.append({"value": 3})
    table.append({"name": "x", "value": 4})
    assert table.read() == [{"name": "", "value": "3"}, {"name": "x", "value": "4"}]


def test_unknown_columns_are_refused_and_leave_the_old_file(table):
    table.write(ROWS)
    with pytest.raises(ValueError, match="other"):
        table.write([{"other": 1}])
    with pytest.raises(ValueError, match="other"):
        table.append({"other": 1})
    assert table.read() == READ and [path.name for path in table.path.parent.iterdir()] == ["table.csv"]


def test_line_that_was_cut_off_is_left_out(table):
    table.write(ROWS)
    whole = table.path.read_bytes()
    for lost in range(len("0.5\r\n"), len(b'"line\nbreak ""quoted""",0.5\r\n')):
        table.path.write_bytes(whole[:-lost])
        assert table.read() in (READ[:1], [*READ[:1], {**READ[1], "value": ""}])
    # A person's editor may leave the last line without an end: that loses nothing.
    table.path.write_bytes(whole[:-2])
    assert table.read() == READ


def test_other_line_ends(tmp_path):
    table = CsvTable(tmp_path / "table.csv", ("name", "value"), line_end="\n")
    table.write([{"name": "x", "value": 1}])
    assert table.path.read_bytes() == b"name,value\nx,1\n"


def test_other_files_are_refused(table):
    with pytest.raises(FileNotFoundError):
        table.read()
    table.path.write_bytes(b"name,other\r\nx,1\r\n")
    assert table.read() == [{"name": "x", "other": "1"}]
    with pytest.raises(DamagedDataError, match="other columns"):
        table.read(is_exact=True)
    for content in (b"\xff\xfe\x00", b"name\x00,value\r\n\x00" * 3):
        table.path.write_bytes(content)
        with pytest.raises(DamagedDataError, match=r"table\.csv"):
            table.read(is_exact=True)


def test_hash_of_a_file(tmp_path):
    data = bytes(range(256)) * 5000
    (tmp_path / "file").write_bytes(data)
    assert file_sha256(tmp_path / "file") == hashlib.sha256(data).hexdigest()
    with pytest.raises(FileNotFoundError):
        file_sha256(tmp_path / "none")


@pytest.mark.parametrize("text", ["=1+1", "+x", "-cmd|' /C calc'!A0", "@SUM(A1)", "\tx", "'=x", "''+y"])
def test_text_that_spreadsheets_would_run_is_escaped_and_comes_back(tmp_path, text):
    table = CsvTable(tmp_path / "table.csv", ("name", "value"))
    table.write([{"name": text, "value": -1.5}])
    table.append({"name": text, "value": "-2e-3"})
    content = table.path.read_bytes().decode()
    assert content.count("'" + text) == 2 or ('"' in text and ",-1.5\r\n" in content and ",-2e-3\r\n" in content)
    assert [row["name"] for row in table.read()] == [text, text]
