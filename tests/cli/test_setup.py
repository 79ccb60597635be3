"""``nsfc setup``."""

import json

import numpy as np
import pytest

from cli.main import main
from warp_caustics.height_field import cell_centres

SMALL = ("--set", "scene.image_pixels=32", "--set", "scene.screen_position_m=[0,0,-1e-3]", "--border", "4")


@pytest.fixture
def relief(tmp_path):
    """A hill, as a file of 16 x 16 heights."""
    place = cell_centres(16, 0.05)
    path = tmp_path / "hill.npy"
    np.save(path, 5e-4 * np.exp(-(place[None, :] ** 2 + (place[:, None] - 3e-3) ** 2) / (2 * 8e-3**2)))
    return str(path)


@pytest.fixture
def lines(tmp_path):
    path = tmp_path / "lines.csv"
    path.write_text("start_x_m,start_y_m,end_x_m,end_y_m,width_m,height_m\n-0.02,-0.01,0.02,0.015,6e-3,2e-4\n")
    return str(path)


def test_a_table_for_people(relief, capsys):
    assert main(["setup", relief, "--camera", "ordinary", "--free", "gap_m,psf_px", "--noise", "0.001", *SMALL]) == 0
    head, gap, *psf, least = capsys.readouterr().out.splitlines()
    assert head.split()[:4] == ["parameter", "unit", "before", "alone"] and "trades off with" in head
    assert gap.split()[:3] == ["gap_m", "um", "50"] and "heights" in gap
    assert [line.split()[0] for line in psf] == [f"psf_px.{c}" for c in range(3)]
    assert least.startswith("least told ") and "of what was unknown is left" in least


def test_a_record_for_programs(relief, capsys):
    """The same numbers with all that is needed to go on: information, names, directions."""
    arguments = ["setup", relief, "--free", "gap_m,tilt_x_rad", "--prior", "gap_m=2e-4", "--json", *SMALL]
    assert main([*arguments, "--unknown-heights", "0"]) == 0
    known = json.loads(capsys.readouterr().out)
    assert known["names"] == ["gap_m", "tilt_x_rad"] and known["camera"] is None
    gap = known["parameters"][0]
    assert gap["prior"] == 2e-4 and gap["value"] == 1e-3 and gap["unit"] == "m" and gap["symbol"] == "g"
    assert gap["with_heights"] == gap["together"] < gap["prior"]
    information = np.array(known["fisher_information"])
    assert gap["alone"] == pytest.approx(information[0, 0] ** -0.5)
    assert gap["together"] == pytest.approx(np.linalg.inv(information + np.diag([2e-4**-2, 5e-3**-2]))[0, 0] ** 0.5)
    assert main([*arguments, "--noise", "0.02", "--unknown-heights", "0"]) == 0
    worse = json.loads(capsys.readouterr().out)["parameters"][0]
    assert worse["alone"] == pytest.approx(2 * gap["alone"])
    assert main(arguments) == 0
    assert json.loads(capsys.readouterr().out)["parameters"][0]["with_heights"] > gap["together"]


def test_numbers_of_lines_may_be_unknown(lines, relief, capsys):
    arguments = ["--free", "index_offset", "--unknown-heights", "lines", "--set", "scene.height_samples=32", *SMALL]
    assert main(["setup", lines, *arguments, "--json"]) == 0
    (index,) = json.loads(capsys.readouterr().out)["parameters"]
    assert index["with_heights"] > index["together"] and index["trades"][-1]["with"] == "heights"
    assert main(["setup", relief, "--unknown-heights", "lines", *SMALL]) == 3
    assert "needs a list of lines" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--free", "gap"], 3, "parameter 'gap' is not known; did you mean 'gap_m'?"),
        (["--free", "psf_px"], 3, "parameter 'psf_px' is not known"),
        (["--noise", "0"], 3, "--noise 0 is not above 0: without noise an image tells everything; 0.01 is usual"),
        (["--noise", "nan"], 2, "not a finite number"),
        (["--border", "16"], 3, "--border 16 leaves nothing of 32 pixels"),
        (["--prior", "gap_m"], 2, "'gap_m' is not NAME=NUMBER"),
        (["--prior", "gap_m=0"], 3, "prior width of gap_m 0 is not above 0"),
        (["--unknown-heights", "many"], 2, "'many' is neither a number nor lines"),
        (["--unknown-heights", "99"], 3, "grid of 99 x 99 heights is not between 1 and 32"),
        (["--camera", "ordnary"], 3, "did you mean 'ordinary'?"),
    ],
)
def test_what_tells_nothing_is_refused(relief, arguments, code, message, capsys):
    assert main(["setup", relief, *SMALL[:4], *arguments]) == code
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.count("\n") == 1 and message in captured.err
