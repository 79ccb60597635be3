"""Weights that are replaced without what was measured with them do not pass."""

import dataclasses
import json
import re
from pathlib import Path

import pytest

from benchmarks.of_weights import EARLIER, PLACES, main, out_of_date, shipped

ROOT = Path(__file__).parents[2]


def test_every_place_is_of_the_weights_that_ship():
    assert out_of_date(shipped()) == [], "measure these again: CONTRIBUTING.md, New weights"
    assert main([]) == 0 and main(["--all"]) == 0


def test_other_weights_name_the_places_that_quote_them():
    other = shipped() | {"direct": "00000000"}
    told = out_of_date(other)
    assert len(told) == sum(place.weights.get("direct", EARLIER) != EARLIER for place in PLACES) >= 9
    assert any(line.startswith("README.md") and f"{shipped()['direct']} -> 00000000" in line for line in told)
    mended = [dataclasses.replace(p, weights={**p.weights, "direct": "00000000"}) for p in PLACES]
    assert out_of_date(other, tuple(mended)) == []


@pytest.mark.parametrize("place", PLACES, ids=lambda place: f"{place.file} {place.mark}")
def test_places_are_there(place):
    text = (ROOT / place.file).read_text(encoding="utf-8")
    assert place.mark in text
    if EARLIER in place.weights.values():
        section = re.split(r"\n#{2,3} ", text.split(place.mark, 1)[1])[0]
        assert re.search(r"weights\s+(of\s+`direct`\s+)?before|earlier\s+weights", section, re.IGNORECASE), (
            "the page must say so"
        )


def test_stored_figures_name_the_same_weights():
    stored = json.loads((ROOT / "benchmarks" / "robustness_h200.json").read_text(encoding="utf-8"))["weights"]
    (place,) = [place for place in PLACES if place.file == "benchmarks/robustness_h200.json"]
    assert stored == place.weights


def test_no_section_with_scores_of_networks_is_missing():
    """A section that gives errors of `direct`, `fibres` or `nsfc` in a table is one of the places."""
    known = {(place.file, place.mark.lstrip("# ")) for place in PLACES}
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        name = str(path.relative_to(ROOT))
        for section in re.split(r"\n(?=#{2,3} )", path.read_text(encoding="utf-8")):
            rows = re.findall(r"^\| [^|]*`(?:direct|fibres|nsfc)\b[^|]*\|.*\d", section, re.MULTILINE)
            if rows and re.search(r"\bum\b", section):
                assert (name, section.split("\n")[0].lstrip("# ")) in known, (name, section.split("\n")[0])
