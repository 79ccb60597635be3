"""Types of options."""

import click
import pytest

from cli.options import length, plate_length

LENGTHS = [("50um", 5e-5), ("0.05mm", 5e-5), ("5e-5", 5e-5), ("50 \N{MICRO SIGN}m", 5e-5), ("1cm", 1e-2), ("0", 0.0)]


@pytest.mark.parametrize(("text", "value"), [*LENGTHS, ("25nm", 2.5e-8), (" 2 m ", 2.0), ("-1mm", -1e-3)])
def test_lengths_have_units(text, value):
    assert length(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["", "mm", "1 inch", "nan", "1e999", "1e mm", "5 5", "50UM"])
def test_what_is_no_length_is_refused(text):
    with pytest.raises(click.BadParameter, match="is no length|is not a finite number"):
        length(text)


def test_lengths_on_a_plate_are_below_a_metre():
    assert [plate_length(text) for text, _ in LENGTHS] == pytest.approx([value for _, value in LENGTHS])
    for text in ("-1um", "1m", "50"):
        with pytest.raises(click.BadParameter, match="not between 0 and 1 m; give a unit such as um"):
            plate_length(text)
