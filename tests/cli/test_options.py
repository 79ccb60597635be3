"""Types of options."""

import click
import pytest

from cli.config import load_config
from cli.main import main
from cli.options import count, length, named_number, plate_length, seconds
from cli.train_config import new_run
from warp_caustics.determinism import VARIABLE, is_deterministic

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


@pytest.fixture
def repeating(monkeypatch):
    """Nothing is asked for yet, and nothing will be afterwards."""
    monkeypatch.setenv(VARIABLE, "0")
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", ":4096:8")


@pytest.mark.parametrize(
    "way", [["--deterministic"], ["--set", "simulation.deterministic=true"]], ids=["option", "key"]
)
def test_results_that_repeat_are_asked_for(repeating, inputs, tmp_path, way):
    """Of the whole process, and so of the next configuration; a CPU does the same, bit for bit."""
    plain, repeated = tmp_path / "plain.npy", tmp_path / "repeated.npy"
    common = ["simulate", str(inputs / "heights.npy"), "--config", "small", "--device", "cpu"]
    assert main([*common, "-o", str(plain)]) == 0
    assert not is_deterministic() and not load_config().simulation.deterministic
    assert main([*common, "-o", str(repeated), *way]) == 0
    assert is_deterministic() and load_config().simulation.deterministic
    assert plain.read_bytes() == repeated.read_bytes()


def test_a_wrong_value_of_the_environment_is_one_line(repeating, monkeypatch, inputs, tmp_path, capsys):
    monkeypatch.setenv(VARIABLE, "yes")
    arguments = ["simulate", str(inputs / "heights.npy"), "-o", str(tmp_path / "a.npy"), "--config", "small"]
    assert main(arguments) == 3
    assert "NSFC_DETERMINISTIC is 'yes', neither 0 nor 1; set it to 1" in capsys.readouterr().err


def test_a_training_reads_it_in_a_whole_configuration(repeating, tmp_path):
    path = tmp_path / "all.yaml"
    path.write_text("simulation: {deterministic: true}\n", encoding="utf-8")
    new_run("denoiser", None, str(path), [], {})
    assert is_deterministic()
