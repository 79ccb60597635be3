"""Records in JSON."""

import json

import numpy as np
import pytest

from warp_caustics.io.json_file import json_text, write_json


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (float("nan"), None), (np.float32(0.5), 0.5), (np.array([1.0, np.inf]), [1.0, None]), ((1, "a"), [1, "a"]),
        (np.int64(3), 3), (True, True), ({"k": {1: 2}}, {"k": {"1": 2}}), (complex(1, 2), "(1+2j)"),
    ],
)  # fmt: skip
def test_records_become_plain_json(value, expected):
    assert json.loads(json_text({"value": value})) == {"value": expected}


def test_a_file_holds_the_record_and_ends_with_a_line(tmp_path):
    write_json(tmp_path / "a.json", {"name": "\N{MICRO SIGN}", "value": float("inf")})
    assert (tmp_path / "a.json").read_text(encoding="utf-8") == '{\n  "name": "\\u00b5",\n  "value": null\n}\n'
