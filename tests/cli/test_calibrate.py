"""``nsfc calibrate``, and its bench in other commands."""

import json

import numpy as np
import pytest
import yaml

from cli.main import main
from warp_caustics.calibration.bench_file import read_bench
from warp_caustics.calibration.plate_file import read_plate

SIZE = (
    "--set", "scene.height_samples=24", "--set", "scene.image_pixels=32", "--set", "scene.wavelengths_m=[530e-9]",
    "--set", "scene.radiosity_W_m2=[1.0]", "--set", "scene.lamp_half_angle_rad=0.008",
)  # fmt: skip
BELIEVED = ("--set", "scene.screen_position_m=[0,0,-3e-3]")
TRUE = ("--set", "scene.screen_position_m=[0,0,-3.1e-3]")
FREE = ("--free", "gap_m,psf_px,shift_x_px,shift_y_px", "--border", "3", "--noise", "0.005", "--device", "cpu")


@pytest.fixture(scope="module")
def bench_folder(tmp_path_factory):
    """A calibration from photos that nsfc simulate --camera takes on another bench than is believed."""
    folder = tmp_path_factory.mktemp("calibrate")
    (folder / "lens.yaml").write_text("kind: lens\nradius_m: 150mm\ndiameter_m: 40mm\n")
    np.save(folder / "lens.npy", read_plate(folder / "lens.yaml").relief(24, (0.05, 0.05)))
    (folder / "camera.yaml").write_text("psf_px: 0.8\nshift_px: [0.5, -0.3]\nlight: [0.03, 0, 0, 0, 0]\n")
    (folder / "believed.yaml").write_text("psf_px: 0.5\n")
    simulate = ["simulate", str(folder / "lens.npy"), "-o", str(folder / "lens.tif"), "--device", "cpu"]
    assert main([*simulate, "--camera", str(folder / "camera.yaml"), *SIZE, *TRUE]) == 0
    return folder


def calibrated(folder, output, *options):
    dark, flat = (str(folder / f"lens_{kind}.tif") for kind in ("dark", "flat"))
    arguments = ["calibrate", str(folder / "lens.tif"), "--plate", str(folder / "lens.yaml"), "--dark", dark]
    arguments += ["--flat", flat, "-o", str(output), "--camera", str(folder / "believed.yaml"), *SIZE, *BELIEVED, *FREE]
    return main([*arguments, *options])


@pytest.fixture(scope="module")
def found(bench_folder):
    assert calibrated(bench_folder, bench_folder / "found") == 0
    return bench_folder / "found"


def test_files_hold_what_was_found(found):
    bench = read_bench(found / "bench.yaml")
    values = {p.name: p for p in bench.parameters}
    assert values["shift_x_px"].value == pytest.approx(0.5, abs=0.05)
    assert values["psf_px.0"].value == pytest.approx(0.8, abs=0.1)
    assert abs(values["gap_m"].value - 3.1e-3) < 3 * values["gap_m"].sigma
    assert bench.camera.psf_px == pytest.approx((values["psf_px.0"].value,))
    assert -bench.scene["screen_position_m"][2] == pytest.approx(values["gap_m"].value)
    deviations = np.sqrt(np.diag(np.array(bench.covariance)))
    assert deviations == pytest.approx([p.sigma for p in bench.parameters])
    assert set(bench.provenance["inputs"]) == {"lens, image", "lens, dark", "lens, flat", "lens, plate"}
    record = json.loads((found / "result.json").read_text())
    assert record["captures"][0]["kind"] == "lens" and record["advice"]
    page = (found / "report.html").read_text()
    assert "What was found" in page and "What to measure or photograph next" in page and "data:image/png" in page
    assert (found / "residuals.png").stat().st_size > 1000


def test_an_earlier_result_is_not_replaced_unasked(bench_folder, found, capsys):
    assert calibrated(bench_folder, found) == 3
    assert "replace it with --force" in capsys.readouterr().err
    assert calibrated(bench_folder, found, "--force", "--no-advice", "--iterations", "1", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["advice"] == [] and {p["name"] for p in told["parameters"]} > {"gap_m", "brightness.0"}


def test_a_list_of_captures(bench_folder, tmp_path, capsys):
    entries = [
        {"image": "lens.tif", "plate": "lens.yaml", "dark": "lens_dark.tif", "flat": "lens_flat.tif"},
        {"image": "lens_flat.tif", "plate": "flat", "dark": "lens_dark.tif"},
    ]
    (bench_folder / "list.yaml").write_text(yaml.safe_dump({"captures": entries}))
    listed = ["calibrate", str(bench_folder / "list.yaml"), "-o", str(tmp_path / "out"), "--no-advice", "--json"]
    options = ["--free", "light_x,psf_px", "--border", "3", "--noise", "0.005", "--iterations", "2", "--device", "cpu"]
    assert main([*listed, *SIZE, *TRUE, *options]) == 0
    told = {(p["capture"], p["name"]): p for p in json.loads(capsys.readouterr().out)["parameters"]}
    assert told[None, "light_x.0"]["value"] == pytest.approx(0.03, abs=3e-3)
    assert ("lens_flat", "brightness.0") in told


def test_other_commands_take_the_bench(bench_folder, found, tmp_path, capsys):
    """Scene and camera are those that were found; --set wins over the file."""
    bench = read_bench(found / "bench.yaml")
    gap = -bench.scene["screen_position_m"][2]
    given = ["--bench", str(found / "bench.yaml"), "--json"]
    lens = str(bench_folder / "lens.npy")
    photo = str(tmp_path / "again.tif")
    assert main(["simulate", lens, "-o", photo, "--camera", "bench", "--device", "cpu", *given]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["camera"]["psf_px"] == pytest.approx(list(bench.camera.psf_px))
    assert main(["setup", lens, "--free", "gap_m", "--device", "cpu", "--border", "4", *given]) == 0
    told = json.loads(capsys.readouterr().out)
    prior = next(p.sigma for p in bench.parameters if p.name == "gap_m")
    assert told["parameters"][0]["prior"] == pytest.approx(prior) and told["camera"]["psf_px"]
    assert told["parameters"][0]["value"] == pytest.approx(gap)
    frames = ["--dark", str(bench_folder / "lens_dark.tif"), "--flat", str(bench_folder / "lens_flat.tif")]
    assert main(["capture", str(bench_folder / "lens.tif"), "-o", str(tmp_path / "light.npy"), *frames, *given]) == 0
    assert "bench" in json.loads(capsys.readouterr().out)["inputs"]
    result = [
        "reconstruct",
        str(bench_folder / "lens.tif"),
        *frames,
        "-o",
        str(tmp_path / "heights"),
        "--device",
        "cpu",
    ]
    options = ["--method", "refine", "--max-iterations", "1", "--set", "scene.height_samples=24"]
    assert main([*result, *options, *given]) == 0
    capsys.readouterr()
    resolved = yaml.safe_load((tmp_path / "heights" / "config.resolved.yaml").read_text())
    assert resolved["scene"]["screen_position_m"][2] == pytest.approx(-gap)
    assert "bench" in json.loads((tmp_path / "heights" / "result.json").read_text())["inputs"]
    assert main(["plan", "--fibre-height", "0.1mm", "--fibre-width", "2mm", *given]) == 0


def test_a_calibration_goes_on_from_another(bench_folder, found, tmp_path, capsys):
    """What was found is what is believed, as well as it was found."""
    options = ["--bench", str(found / "bench.yaml"), "--no-advice", "--iterations", "1", "--json"]
    arguments = ["calibrate", str(bench_folder / "lens.tif"), "--plate", str(bench_folder / "lens.yaml"), "-o"]
    frames = ["--dark", str(bench_folder / "lens_dark.tif"), "--flat", str(bench_folder / "lens_flat.tif")]
    samples = ["--set", "scene.height_samples=24"]
    assert main([*arguments, str(tmp_path / "next"), *frames, *FREE, *samples, *options]) == 0
    told = {p["name"]: p for p in json.loads(capsys.readouterr().out)["parameters"] if p["capture"] is None}
    first = {p.name: p for p in read_bench(found / "bench.yaml").parameters}
    assert told["gap_m"]["prior"] == pytest.approx(first["gap_m"].sigma)
    assert told["gap_m"]["before"] == pytest.approx(first["gap_m"].value)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["x.tif"], "0 plates for 1 captures; give --plate once for each"),
        (["x.tif", "--plate", "flat", "--noise", "0"], "--noise 0 is not above 0"),
        (["x.tif", "--plate", "flat", "--finest", "8"], "is too small"),
        (["x.tif", "--plate", "flat", "--bench", "none.yaml"], "'none.yaml' does not exist"),
    ],
)
def test_wrong_usage_is_told(arguments, message, capsys, tmp_path):
    assert main(["calibrate", *arguments, "-o", str(tmp_path / "out")]) == 3
    assert message in capsys.readouterr().err


def test_a_prior_that_is_no_number_is_told(capsys, tmp_path):
    arguments = ["x.tif", "--plate", "flat", "-o", str(tmp_path / "out"), "--prior"]
    assert main(["calibrate", *arguments, "gap_m"]) == 2
    assert (
        "Invalid value for --prior: 'gap_m' is not NAME=NUMBER; write for example gap_m=5um" in capsys.readouterr().err
    )


def test_other_files_are_no_bench(tmp_path, capsys):
    path = tmp_path / "scene.yaml"
    path.write_text("scene: {image_pixels: 32}\n")
    assert main(["plan", "--fibre-height", "0.1mm", "--fibre-width", "2mm", "--bench", str(path)]) == 3
    assert "is no bench of nsfc calibrate" in capsys.readouterr().err
    assert main(["simulate", "x.npy", "-o", "y.tif", "--camera", "bench"]) == 3
