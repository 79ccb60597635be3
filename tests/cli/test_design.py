"""``nsfc design``."""

import json

import imagecodecs
import numpy as np
import pytest
import trimesh

from cli.design import DESIGN_FILES
from cli.main import main
from cli.marker import MARKER
from warp_caustics.io.images import read_image

SMALL = (
    "--set",
    "scene.height_samples=32",
    "--set",
    "scene.image_pixels=64",
    "--max-iterations",
    "6",
    "--device",
    "cpu",
)


def letter_f():
    """8 bits, drawn row by row from the top, shape [64, 64]."""
    picture = np.zeros((64, 64), np.uint8)
    picture[10:54, 20:27] = 255
    picture[10:17, 20:46] = 255
    picture[28:35, 20:40] = 255
    return picture


def write_png(path, picture):
    path.write_bytes(imagecodecs.png_encode(np.ascontiguousarray(picture)))
    return path


def design(picture, output, *options):
    return main(["design", str(picture), "-o", str(output), "--floor", "0.3", *SMALL, *options])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder of a design, with the picture beside it."""
    folder = tmp_path_factory.mktemp("design")
    assert design(write_png(folder / "letter.png", letter_f()), folder / "out") == 0
    return folder / "out"


def record_of(folder):
    return json.loads((folder / "result.json").read_text())


def test_folder_holds_its_files(made):
    assert {path.name for path in made.iterdir()} == {*DESIGN_FILES, MARKER}
    assert [path.name for path in made.parent.iterdir() if path.name.startswith(".")] == []


def test_simulating_the_heights_gives_the_caustic_again(made, tmp_path):
    again = tmp_path / "again.tif"
    arguments = ["simulate", str(made / "height.npy"), "-o", str(again), "--config", str(made / "config.resolved.yaml")]
    assert main([*arguments, "--device", "cpu"]) == 0
    np.testing.assert_allclose(read_image(again).values, read_image(made / "caustic.tif").values, atol=1e-5)


def test_caustic_is_upright_like_the_picture(made):
    for name in ("caustic.tif", "caustic.png", "target.tif"):
        image = read_image(made / name).values.mean(axis=0)
        agreement = np.corrcoef(image.ravel(), letter_f().ravel())[0, 1]
        assert agreement > 0.8, name
        assert np.corrcoef(image[:, ::-1].ravel(), letter_f().ravel())[0, 1] < agreement - 0.3, name


def test_solid_is_closed_and_in_millimetres(made):
    mesh = trimesh.load(made / "surface.stl")
    heights = np.load(made / "height.npy")
    assert mesh.is_watertight
    np.testing.assert_allclose(mesh.extents, [50, 50, 3 + heights.max() * 1e3], rtol=1e-5)


def test_record_has_the_figures(made):
    record = record_of(made)
    heights = np.load(made / "height.npy")
    assert record["relief"]["height_range_m"] == pytest.approx(np.ptp(heights))
    assert record["picture"]["psnr_dB"] > 15
    assert record["settings"]["floor"] == 0.3
    assert record["stop_reason"] == "max_iterations"
    assert record["inputs"]["target"]["path"].endswith("letter.png")


def test_mirrored_picture_for_the_other_side(made, tmp_path):
    assert design(made.parent / "letter.png", tmp_path / "out", "--mirror") == 0
    one, other = (read_image(folder / "target.tif").values[0] for folder in (made, tmp_path / "out"))
    np.testing.assert_allclose(other, one[:, ::-1], rtol=1e-6)


def test_integers_are_srgb_and_floats_linear(tmp_path):
    counts = np.full((64, 64), 188, np.uint8)  # half the light of 255 on the sRGB curve
    counts[:, 32:] = 255
    ratios = {}
    for name, options in (("srgb", ()), ("linear", ("--transfer", "linear"))):
        picture = write_png(tmp_path / f"{name}.png", counts)
        assert design(picture, tmp_path / name, "--floor", "0", "--max-time", "1e-6", *options) == 0
        target = read_image(tmp_path / name / "target.tif").values[0]
        ratios[name] = target[:, :20].mean() / target[:, -20:].mean()
    assert ratios["srgb"] == pytest.approx(0.5, abs=0.01)
    assert ratios["linear"] == pytest.approx(188 / 255, abs=0.01)
    np.save(tmp_path / "floats.npy", counts.astype(np.float32))
    assert design(tmp_path / "floats.npy", tmp_path / "floats", "--floor", "0", "--max-time", "1e-6") == 0
    target = read_image(tmp_path / "floats" / "target.tif").values[0]
    assert target[:, :20].mean() / target[:, -20:].mean() == pytest.approx(188 / 255, abs=0.01)


def test_lengths_have_units(full_figures, made, tmp_path):
    options = (
        "--screen-distance",
        "300mm",
        "--plate-size",
        "8cm",
        "--base-thickness",
        "4000um",
        "--max-height",
        "0.004",
    )
    assert design(made.parent / "letter.png", tmp_path / "out", "--max-time", "1e-6", *options) == 0
    record = record_of(tmp_path / "out")
    assert record["settings"]["screen_distance_m"] == pytest.approx(0.3)
    assert record["settings"]["max_height_m"] == pytest.approx(4e-3)
    config = (tmp_path / "out" / "config.resolved.yaml").read_text()
    assert "plate_size_m: [0.08, 0.08]" in config
    assert "base_thickness_m: 0.004" in config
    assert "screen_position_m: [0.0, 0.0, -0.3]" in config


def test_distance_of_the_configuration_counts_unless_it_is_contact(made, tmp_path):
    picture = made.parent / "letter.png"
    assert (
        design(picture, tmp_path / "out", "--max-time", "1e-6", "--set", "scene.screen_position_m=[0, 0, -0.25]") == 0
    )
    settings = record_of(tmp_path / "out")["settings"]
    assert settings["screen_distance_m"] == 0.25
    assert not settings["distance_was_chosen"]
    assert record_of(made)["settings"]["distance_was_chosen"]


def test_ctrl_c_keeps_the_best_relief_so_far(made, tmp_path, capsys, monkeypatch):
    from contextlib import contextmanager

    from cli.console import Console

    @contextmanager
    def impatient(self):
        def show(state):
            if state.stage.startswith("descent"):
                raise KeyboardInterrupt

        yield show

    monkeypatch.setattr(Console, "progress", impatient)
    assert design(made.parent / "letter.png", tmp_path / "out") == 130
    assert "interrupted; the best relief so far is in" in capsys.readouterr().err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*DESIGN_FILES, MARKER}
    assert record_of(tmp_path / "out")["stop_reason"] == "interrupted"


def test_summary_is_readable(made, tmp_path, capsys):
    assert design(made.parent / "letter.png", tmp_path / "out", "--max-time", "1e-6") == 0
    captured = capsys.readouterr()
    words = [line.split()[0] for line in captured.out.splitlines()]
    assert words == ["result", "search", "screen", "picture", "light", "relief"]
    assert "stopped by max time" in captured.out


def test_json_is_all_there_is_on_stdout(made, tmp_path, capsys):
    assert design(made.parent / "letter.png", tmp_path / "out", "--max-time", "1e-6", "--json") == 0
    assert json.loads(capsys.readouterr().out)["stop_reason"] == "max_time"


def test_earlier_result_is_replaced_only_by_force(made, tmp_path, capsys):
    options = (made.parent / "letter.png", tmp_path / "out", "--max-time", "1e-6")
    assert design(*options) == 0
    capsys.readouterr()
    assert design(*options) == 3
    assert_one_line(capsys, "--force")
    assert design(*options, "--force") == 0
    (tmp_path / "out" / "notes.txt").write_text("mine")
    capsys.readouterr()
    assert design(*options, "--force") == 3
    assert_one_line(capsys, "notes.txt")


def test_help_names_the_patents(capsys):
    assert main(["design", "--help"]) == 0
    assert "EP2963464B1" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "picture", "reason"),
    [
        ("black.png", np.zeros((16, 16), np.uint8), "black everywhere"),
        ("dot.png", np.full((1, 1), 200, np.uint8), "1 x 1 pixels"),
        ("huge.png", np.zeros((8001, 8001), np.uint8), "at most 6.4e+07 pixels"),
        ("glass.png", np.full((16, 16, 4), 128, np.uint8), "without an alpha channel"),
        ("nan.npy", np.full((16, 16), np.nan), "NaN"),
        ("photo.jpg", b"\xff\xd8\xff\xe0 no more", "JPEG"),
    ],
)
def test_pictures_of_no_use_end_in_one_line(tmp_path, capsys, name, picture, reason):
    path = tmp_path / name
    if isinstance(picture, bytes):
        path.write_bytes(picture)
    elif path.suffix == ".npy":
        np.save(path, picture)
    else:
        write_png(path, picture)
    assert design(path, tmp_path / "out") == 3
    assert_one_line(capsys, reason)
    assert [entry.name for entry in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(
    ("options", "code", "reason"),
    [
        (["--screen-distance", "1 inch"], 2, "is no length"),
        (["--screen-distance", "0"], 3, "screen_distance_m"),
        (["--screen-distance", "-0.1m"], 3, "screen_distance_m"),
        (["--screen-distance", "11m"], 3, "screen_distance_m"),
        (["--plate-size", "50"], 3, "did you mean 0.05"),
        (["--max-height", "2"], 3, "max_height_m"),
        (["--floor", "1"], 3, "floor 1"),
        (["--floor", "nan"], 2, "not a finite number"),
        (["--margin", "3cm"], 3, "margin 0.03"),
        (["--smoothness", "-1"], 3, "smoothness"),
        (["--max-iterations", "0"], 2, "'--max-iterations': '0' is not at least 1"),
        (["--set", "scene.emission_half_angle_rad=0.1"], 3, "collimated"),
        (["--device", "tpu"], 3, "tpu"),
    ],
)
def test_bad_options_end_in_one_line_and_no_output(made, tmp_path, capsys, options, code, reason):
    capsys.readouterr()
    assert design(made.parent / "letter.png", tmp_path / "out", *options) == code
    assert_one_line(capsys, reason)
    assert list(tmp_path.iterdir()) == []


def assert_one_line(capsys, reason):
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1, captured.err
    assert reason in captured.err
