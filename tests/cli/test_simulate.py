"""``nsfc simulate``."""

import json
from pathlib import Path

import numpy as np
import pytest

from cli.main import main
from warp_caustics.io.images import read_image


def simulate(heights, output, *options):
    return main(["simulate", str(heights), "-o", str(output), "--config", "small", "--device", "cpu", *options])


def test_flat_plate_lets_the_radiosity_through(tmp_path):
    np.save(tmp_path / "flat.npy", np.full((32, 32), 2e-4))
    assert simulate(tmp_path / "flat.npy", tmp_path / "out.npy", "--set", "scene.radiosity_W_m2=[1, 2, 3]") == 0
    image = np.load(tmp_path / "out.npy")
    assert image.shape == (3, 128, 128)
    inner = image[:, 4:-4, 4:-4]
    np.testing.assert_allclose(inner, np.broadcast_to(np.array([1, 2, 3])[:, None, None], inner.shape), rtol=0.01)


def test_file_records_wavelengths(inputs):
    image = read_image(inputs / "image.tif")
    assert image.wavelengths_m == (610e-9, 530e-9, 430e-9)
    assert image.values.shape == (3, 128, 128)
    assert image.values.max() > 1.2  # a caustic


def test_summary_is_readable(inputs, tmp_path, capsys):
    assert simulate(inputs / "heights.npy", tmp_path / "out.tif") == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    words = {line.split()[0] for line in captured.out.splitlines()}
    assert words == {"image", "photons", "time", "irradiance", "light"}
    assert "10000 per wavelength, lattice" in captured.out
    assert "610 nm: 100 % landed" in captured.out


def test_json_is_all_there_is_on_stdout(inputs, tmp_path, capsys):
    assert simulate(inputs / "heights.npy", tmp_path / "out.tif", "--json", "--n-photons", "9e4") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["settings"]["n_photons"] == 90_000
    assert record["energy"]["landed"] == pytest.approx([1, 1, 1])
    image = read_image(tmp_path / "out.tif").values
    np.testing.assert_allclose(record["max_irradiance_W_m2"], image.max(axis=(1, 2)), rtol=1e-6)


def test_seed_selects_the_photons(inputs, tmp_path):
    images = []
    for seed in ("1", "1", "2"):
        options = ("--preset", "paper", "--n-photons", "2000", "--smoothing", "2", "--seed", seed)
        assert simulate(inputs / "heights.npy", tmp_path / "out.npy", "--force", *options) == 0
        images.append(np.load(tmp_path / "out.npy"))
    np.testing.assert_allclose(images[0], images[1], atol=1e-4)  # atomics add in any order
    assert np.abs(images[0] - images[2]).max() > 0.1


@pytest.mark.parametrize(
    ("options", "code", "reason"),
    [
        (["--n-photons", "0"], 3, "--n-photons"),
        (["--n-photons", "1.5"], 2, "not a whole number"),
        (["--n-photons", "inf"], 2, "not a finite number"),
        (["--smoothing", "nan"], 2, "not a finite number"),
        (["--smoothing", "-1"], 3, "smoothing"),
        (["--seed", "abc"], 2, "'abc'"),
        (["--seed", "-1"], 3, "seed"),
        (["--placement", "grid"], 3, "placement"),
        (["--preset", "papr"], 3, "did you mean 'paper'"),
        (["--device", "cuda:99"], 6, "use --device cpu"),
        (["--device", "tpu"], 3, "tpu"),
        (["--set", "scene.height_samples=16"], 5, "--set scene.height_samples=32"),
        (["--set", "scene.wavelengths_m=[610, 530, 430]"], 3, "610 nm"),
        (["--set", "scene.imagepixels=64"], 3, "did you mean 'image_pixels'"),
    ],
)
def test_bad_options_end_in_one_line_and_no_output(inputs, tmp_path, capsys, options, code, reason):
    assert simulate(inputs / "heights.npy", tmp_path / "out.tif", *options) == code
    assert_one_line(capsys, reason)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["out", "out.bmp", "missing/out.tif"])
def test_bad_outputs_are_refused_before_the_simulation(inputs, tmp_path, capsys, monkeypatch, name):
    import warp_caustics.simulator

    monkeypatch.setattr(warp_caustics.simulator, "CausticSimulator", None)  # calling it would be a bug: exit code 1
    assert simulate(inputs / "heights.npy", tmp_path / name) == 3
    assert_one_line(capsys, name.removesuffix("/out.tif"))
    assert list(tmp_path.iterdir()) == []


def test_the_input_is_not_overwritten(tmp_path, relief, capsys):
    path = tmp_path / "heights.npy"
    np.save(path, relief)
    before = path.read_bytes()
    assert simulate(path, path) == 3
    assert_one_line(capsys, "is the input")
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("name", "content", "code", "reason"),
    [
        ("nan.npy", np.full((32, 32), np.nan), 3, "NaN"),
        ("mm.npy", np.full((32, 32), 0.5), 3, "did you mean"),
        ("row.npy", np.zeros(32), 3, "shape"),
        ("text.npy", "no heights", 3, "text.npy"),
    ],
)
def test_bad_heights_end_in_one_line(tmp_path, capsys, name, content, code, reason):
    path = tmp_path / name
    path.write_text(content) if isinstance(content, str) else np.save(path, content)
    assert simulate(path, tmp_path / "out.tif") == code
    assert_one_line(capsys, reason)
    assert not (tmp_path / "out.tif").exists()


def assert_one_line(capsys, reason):
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1, captured.err
    assert reason in captured.err


def test_light_over_the_border_is_told(inputs, tmp_path, capsys):
    """Of few wide footprints the image holds less than what landed."""
    assert simulate(inputs / "heights.npy", tmp_path / "out.npy", "--preset", "paper", "--n-photons", "2000") == 0
    assert "% over the border of the image" in capsys.readouterr().out


def test_a_black_image_is_not_written(inputs, tmp_path, capsys):
    out = tmp_path / "out.npy"
    assert simulate(inputs / "heights.npy", out, "--set", "scene.screen_position_m=[1, 0, -1e-6]") == 3
    assert "no light reaches the image" in capsys.readouterr().err and not out.exists()


LINES = "start_x_mm,start_y_mm,end_x_mm,end_y_mm,width_mm,height_mm\n-10,-8,12,9,3,0.2\n"


def test_a_list_of_lines_is_simulated_as_its_relief(tmp_path):
    from warp_caustics.prints.line import Line, line_relief

    (tmp_path / "design.csv").write_text(LINES)
    np.save(tmp_path / "map.npy", line_relief([Line((-0.01, -0.008), (0.012, 0.009), 3e-3, 2e-4)], 32, (0.05, 0.05)))
    images = []
    for name in ("design.csv", "map.npy"):
        assert simulate(tmp_path / name, tmp_path / "out.npy", "--force") == 0
        images.append(np.load(tmp_path / "out.npy"))
    np.testing.assert_array_equal(*images)


def test_the_map_tells_the_number_of_samples(tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((20, 20)))
    arguments = ["simulate", str(tmp_path / "map.npy"), "-o", str(tmp_path / "out.npy"), "--device", "cpu"]
    assert main([*arguments, "--set", "scene.image_pixels=32"]) == 0
    assert main([*arguments, "--set", "scene.image_pixels=32", "--set", "scene.height_samples=32"]) == 5


def test_noise_is_that_of_flat_light(tmp_path):
    np.save(tmp_path / "flat.npy", np.zeros((32, 32)))
    options = ("--noise", "0.02", "--set", "scene.radiosity_W_m2=[1, 2, 3]")
    assert simulate(tmp_path / "flat.npy", tmp_path / "out.npy", *options) == 0
    inner = np.load(tmp_path / "out.npy")[:, 8:-8, 8:-8]
    np.testing.assert_allclose(inner.std(axis=(1, 2)), [0.02, 0.04, 0.06], rtol=0.05)


@pytest.mark.parametrize("noise", ["-1", "2"])
def test_noise_outside_its_range_is_refused(tmp_path, noise, capsys):
    np.save(tmp_path / "flat.npy", np.zeros((32, 32)))
    assert simulate(tmp_path / "flat.npy", tmp_path / "out.npy", "--noise", noise) == 3
    assert "0.01 is 1 %" in capsys.readouterr().err


@pytest.mark.parametrize("count", [1, 5, 64])
def test_any_number_of_wavelengths(tmp_path, inputs, count):
    from cli.main import main

    wavelengths = ", ".join(f"{400 + 5 * k}nm" for k in range(count))
    settings = [
        "--set",
        f"scene.wavelengths_m=[{wavelengths}]",
        "--set",
        f"scene.radiosity_W_m2=[{', '.join('1' * count)}]",
    ]
    settings += ["--set", "scene.image_pixels=80", "--n-photons", "1e3", "--device", "cpu"]
    assert (
        main(["simulate", str(inputs / "heights.npy"), "-o", str(tmp_path / "x.npy"), "--config", "small", *settings])
        == 0
    )
    assert np.load(tmp_path / "x.npy").shape == (count, 80, 80)


def test_a_design_is_simulated_as_its_relief(tmp_path):
    """Of the examples, and one that overhangs is refused with its contact angle before anything is computed."""
    from warp_caustics.prints.design_file import design_relief, read_design

    file = Path(__file__).parents[2] / "examples" / "designs" / "fibre.yaml"
    np.save(tmp_path / "map.npy", design_relief(read_design(file), 32, (0.05, 0.05)))
    images = []
    for name in (file, tmp_path / "map.npy"):
        assert simulate(name, tmp_path / "out.npy", "--force") == 0
        images.append(np.load(tmp_path / "out.npy"))
    np.testing.assert_array_equal(*images)


def test_a_design_that_overhangs_is_refused(tmp_path, capsys):
    (tmp_path / "design.yaml").write_text(
        "fibre_diameter_mm: 0.4\nlines:\n- {start_x_mm: 0, start_y_mm: 0, end_x_mm: 9, end_y_mm: 0, width_mm: 0.4}\n"
    )
    assert simulate(tmp_path / "design.yaml", tmp_path / "out.npy") == 3
    error = capsys.readouterr().err
    assert "line 1: 0.1257 mm^2 of glass on a foot of 0.4 mm has a contact angle of" in error
    assert "at least 0.566 mm wide" in error and not (tmp_path / "out.npy").exists()
