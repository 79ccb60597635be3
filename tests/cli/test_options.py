"""Types of options."""

import click
import pytest

from cli.options import count, length, named_number, plate_length, seconds

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


@pytest.mark.parametrize(
    ("text", "value"),
    [("gap_m=5um", 5e-6), ("gap_m = 1e-4", 1e-4), ("vergence_per_m=0.3", 0.3), ("tilt_x_rad=1e-3", 1e-3)],
)
def test_numbers_of_a_set_up_take_the_unit_of_a_length(text, value):
    assert named_number(text, "--prior") == (text.partition("=")[0].strip(), pytest.approx(value))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gap_m", "is not NAME=NUMBER; write for example gap_m=5um"),
        ("gap_m=wide", "gap_m: 'wide' is no length; write 50um"),
        ("vergence_per_m=3mm", "vergence_per_m: '3mm' is not a finite number"),
    ],
)
def test_a_number_of_a_set_up_that_is_none_is_named(text, message):
    with pytest.raises(click.BadParameter) as caught:
        named_number(text, "--prior")
    assert message in caught.value.message and caught.value.param_hint == "--prior"


@pytest.mark.parametrize(("option", "text"), [(count, "0"), (count, "-1"), (seconds, "0"), (seconds, "-5")])
def test_nothing_is_no_number_of_steps_nor_a_time(option, text):
    with pytest.raises(click.BadParameter, match="at least 1|is no time"):
        option(text)
    assert option("1e2") == 100
