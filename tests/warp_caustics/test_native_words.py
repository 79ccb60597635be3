"""What a library writes past Python is caught, Python's own words are not, and errors pass."""

import os
import sys

import pytest

from warp_caustics.native_words import native_words


def test_words_of_a_library_are_caught_in_order(capfd):
    print("before", file=sys.stderr)
    with native_words() as said:
        os.write(2, b"one\ntwo \xff\n")
        assert said == []
    print("after", file=sys.stderr)
    assert said == ["one", "two �"]
    assert capfd.readouterr().err == "before\nafter\n"


def test_they_are_told_where_an_error_passes(capfd):
    with pytest.raises(ValueError, match="so"), native_words() as said:
        os.write(2, b"because\n")
        raise ValueError("so")
    assert said == ["because"]
    assert capfd.readouterr().err == ""
