"""``nsfc plan``."""

import json

import pytest

from cli.main import main

FIBRE = ("--fibre-height", "0.1mm", "--fibre-width", "2mm")


def test_a_plan_in_words_and_as_record(capsys):
    assert main(["plan", *FIBRE, "--screen-distance", "1mm", "--lamp-size", "1mm", "--focal-length", "200mm"]) == 0
    shown = capsys.readouterr().out
    assert "2.28 mm below the plate" in shown and "folds      good" in shown
    assert "--set scene.screen_position_m='[0.0, 0.0, -0.001]'" in shown
    assert main(["plan", *FIBRE, "--screen-distance", "50mm", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["folds"] and record["scene"]["screen_position_m"][2] == -0.05
    assert record["advice"][0]["topic"] == "folds"


def test_settings_told_are_understood(capsys):
    import shlex

    assert main(["plan", *FIBRE, "--lamp-distance", "0.5m", "--lamp-size", "1mm"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("settings")]
    assert main(["plan", *FIBRE, *shlex.split(line)[1:], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["scene"]["light_position_m"][2] == pytest.approx(0.503)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--lamp-size", "1mm"], 2, "--lamp-size needs --focal-length"),
        (["--lamp-distance", "1m", "--focal-length", "1m"], 2, "not both"),
        (["--lamp-distance", "0m"], 3, "is not above 0"),
        (["--screen-distance", "100m"], 3, "too far away"),
        (["--fibre-width", "2m"], 3, "fibre width 2 m is not between"),
        (["--lamp-size", "1m", "--focal-length", "0.1m"], 3, "lamp half-angle"),
    ],
)
def test_what_makes_no_plan_is_refused(arguments, code, message, capsys):
    assert main(["plan", *FIBRE, *arguments]) == code
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1 and message in captured.err
