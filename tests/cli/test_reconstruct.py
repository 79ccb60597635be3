"""``nsfc reconstruct``: files in, files out, and nothing half-written."""

import dataclasses
import hashlib
import importlib.util
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import nets.reconstruct
from cli.config import load_config
from cli.main import main
from cli.marker import MARKER
from cli.output import check_target, result_folder
from cli.results import FILES, RECONSTRUCTION
from warp_caustics.errors import InputError
from warp_caustics.io.heights import read_heights
from warp_caustics.io.images import read_image, write_image


@pytest.fixture
def fake(monkeypatch):
    """Puts a method that only pretends in place of the real ones."""
    spec = importlib.util.spec_from_file_location("fake_method", Path(__file__).with_name("fake_method.py"))
    fake_method = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fake_method)
    module = fake_method.methods_module()
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setattr(nets.reconstruct, "methods", module, raising=False)
    return fake_method


def reconstruct(image, output, *options):
    arguments = ["reconstruct", str(image), "-o", str(output), "--config", "small", "--device", "cpu"]
    return main([*arguments, *map(str, options)])


def test_result_folder_is_complete(full_figures, fake, inputs, tmp_path, relief, capsys):
    options = "--initial", inputs / "heights.npy", "--reference", inputs / "heights.npy"
    assert reconstruct(inputs / "image.tif", tmp_path / "out", *options) == 0
    out = tmp_path / "out"
    assert os.listdir(tmp_path) == ["out"]
    assert sorted(os.listdir(out)) == sorted((*FILES, MARKER))
    np.testing.assert_array_equal(read_heights(out / "height.npy"), relief)
    np.testing.assert_allclose(read_heights(out / "height.tif"), relief, atol=1e-10)
    assert load_config(str(out / "config.resolved.yaml")) == load_config("small")
    assert (out / "overview.png").read_bytes().startswith(b"\x89PNG")

    record = json.loads((out / "result.json").read_text())
    assert record["errors"]["rmse_um"] == 0
    assert record["stop_reason"] == "max_iterations" and record["iterations"] == 3
    assert record["counters"]["landed"] == [1.0, 1.0, None]
    digest = hashlib.sha256((inputs / "image.tif").read_bytes()).hexdigest()
    assert record["inputs"]["image"] == {"path": str(inputs / "image.tif"), "sha256": digest}
    assert record["versions"]["nsfc"]
    captured = capsys.readouterr()
    assert "RMSE 0 um" in captured.out and str(out) in captured.out
    assert "warning: only a fake" in captured.err


def test_refine_recovers_a_weak_relief(inputs, tmp_path):
    """The real method, cut short: three stages of twenty iterations halve the error of a flat guess."""
    options = "--max-iterations", 20, "--reference", inputs / "heights.npy"
    assert reconstruct(inputs / "image.tif", tmp_path / "out", *options) == 0
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert record["method"] == "refine"
    assert record["errors"]["rmse_mean_removed_um"] < 0.5 * record["errors"]["reference_rms_um"]
    assert record["residual"] < 0.01
    assert record["counters"]["energy"]["landed"] == pytest.approx([1, 1, 1])


@pytest.mark.parametrize("method", ["refine", "transport"])
def test_trust_comes_first_and_says_the_same_everywhere(inputs, tmp_path, capsys, method):
    out = tmp_path / "out"
    options = "--method", method, "--max-iterations", 3
    assert reconstruct(inputs / "image.tif", out, *options) == 0
    lines = capsys.readouterr().out.splitlines()
    record = json.loads((out / "result.json").read_text())
    line = record["trust"]["line"]
    assert next(iter(record)) == "trust" and record["trust"]["noise_source"] in ("given", "estimated")
    assert record["trust"]["left_at_all"] == pytest.approx(record["residual"])
    assert lines[0] == f"trust      {line}"
    floor = f"{record['trust']['floor_at_all']:.2g}"
    is_all = record["trust"]["pixels"] is None
    at_all = "" if is_all else f" at all 128 pixels, where noise and simulation leave {floor}"
    assert f"residual   {record['residual']:.4g} of the image{at_all}" in lines
    assert f"uncertain  none, because {record['no_uncertainty']}" in lines and record["uncertainty"] is None
    page = (out / "report.html").read_text()
    assert page.index(line[1:]) < page.index("Relief from") and "Standard uncertainty: none, because" in page


def test_start_from_transport_is_on_record(inputs, tmp_path, capsys):
    """--initial transport: the record names the method of the start, its error, and what it had to say."""
    options = "--initial", "transport", "--max-iterations", 2, "--reference", inputs / "heights.npy"
    assert reconstruct(inputs / "image.tif", tmp_path / "out", *options) == 0
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert record["method"] == "refine"
    assert record["settings"]["initial"]["method"] == "transport"
    assert record["settings"]["initial"]["counters"]["mass_error"] < 0.05
    assert record["initial_errors"]["rmse_um"] < 0.2 * record["errors"]["reference_rms_um"]
    assert set(record["inputs"]) == {"image", "reference"}
    captured = capsys.readouterr()
    assert "start      RMSE" in captured.out
    assert "transport" in captured.err


def test_ctrl_c_during_the_start_writes_the_start(inputs, tmp_path, monkeypatch):
    """Interrupted before refine began: what transport had found is the result."""
    from warp_caustics.reconstruct.transport import transport_map

    pushed = []

    def push_forward(*args):
        pushed.append(args)
        if len(pushed) == 3:
            raise KeyboardInterrupt
        return original(*args)

    original = transport_map.push_forward
    monkeypatch.setattr(transport_map, "push_forward", push_forward)
    assert reconstruct(inputs / "image.tif", tmp_path / "out", "--initial", "transport") == 130
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert record["method"] == "transport" and record["stop_reason"] == "interrupted"
    assert (tmp_path / "out" / "height.npy").exists()


@pytest.mark.parametrize("method", ["transport", "hcccd"])
def test_transport_methods(inputs, tmp_path, method):
    options = "--method", method, "--max-time", 60, "--max-iterations", 8, "--reference", inputs / "heights.npy"
    assert reconstruct(inputs / "image.tif", tmp_path / "out", *options) == 0
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert record["method"] == method
    assert record["errors"]["rmse_mean_removed_um"] < 0.5 * record["errors"]["reference_rms_um"]
    assert ("base_drift_m" in record["counters"]) == (method == "hcccd")


def test_max_time_stops_refine(inputs, tmp_path):
    assert reconstruct(inputs / "image.tif", tmp_path / "out", "--max-time", 0.1) == 0
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert record["stop_reason"] == "max_time" and record["iterations"] < 100


def test_mesh_is_the_plate_in_millimetres(fake, inputs, tmp_path, relief):
    import trimesh

    assert reconstruct(inputs / "image.tif", tmp_path / "out", "--initial", inputs / "heights.npy") == 0
    mesh = trimesh.load(tmp_path / "out" / "surface.stl")
    np.testing.assert_allclose(mesh.bounds, [[-25, -25, 0], [25, 25, 3 + relief.max() * 1e3]], atol=1e-4)
    assert mesh.is_watertight


def test_json_is_all_there_is_on_stdout(fake, inputs, tmp_path, capsys):
    assert reconstruct(inputs / "image.tif", tmp_path / "out", "--json") == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out) == json.loads((tmp_path / "out" / "result.json").read_text())
    assert all(line.startswith("warning: ") for line in captured.err.splitlines())


def test_options_reach_the_method_and_the_resolved_configuration(fake, inputs, tmp_path):
    options = "--max-iterations", "7", "--max-time", "5", "--seed", "4"
    assert reconstruct(inputs / "image.tif", tmp_path / "out", *options) == 0
    assert json.loads((tmp_path / "out" / "result.json").read_text())["iterations"] == 7
    config = load_config(str(tmp_path / "out" / "config.resolved.yaml"))
    assert config.reconstruction.options == {"max_iterations": 7, "max_time_s": 5.0}
    assert config.simulation.seed == 4


def test_calibration_frames_are_used(fake, inputs, tmp_path):
    """Counts of a camera with vignetting come back as irradiance."""
    light = read_image(inputs / "image.tif").values
    vignetting = np.linspace(0.5, 1, 128)
    for name, frame in (("image", light), ("flat", np.ones_like(light)), ("dark", np.zeros_like(light))):
        counts = np.rint(200 + 5000 * vignetting * frame).astype(np.uint16)
        write_image(tmp_path / f"{name}.png", counts)
    frames = "--dark", tmp_path / "dark.png", "--flat", tmp_path / "flat.png"
    assert reconstruct(tmp_path / "image.png", tmp_path / "out", *frames, "--wavelength-order", "610,530,430") == 0
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    assert set(record["inputs"]) == {"image", "dark", "flat"}
    assert any("dark" in step for step in record["calibration"]["steps"])
    assert any("flat" in step for step in record["calibration"]["steps"])


def test_plain_log_lines_without_a_terminal(fake, inputs, tmp_path, capsys):
    assert reconstruct(inputs / "image.tif", tmp_path / "out") == 0
    assert "pretending: 1 of 3, residual 1.0000" in capsys.readouterr().err


BAD_INPUTS = [
    ("text", 3, "image.tif"),
    ("truncated", 4, "image.tif"),
    ("empty", 3, "empty"),
    ("missing", 3, "does not exist"),
    ("folder", 3, "folder"),
    ("nan", 3, "NaN"),
    ("black", 3, "black"),
    ("half", 5, "64 x 64"),
    ("one channel", 5, "has 1 channel, the scene 3 wavelengths"),
]


def bad_image(kind, good, path):
    values = read_image(good).values.copy()
    if kind == "text":
        path.write_text("no image at all\n")
    elif kind == "truncated":
        path.write_bytes(good.read_bytes()[:2000])
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "folder":
        path.mkdir()
    elif kind == "nan":
        values[0, 3, 4] = np.nan
        np.save(path.with_suffix(".npy"), values)
        path.with_suffix(".npy").rename(path)
    elif kind != "missing":
        values = {"black": 0 * values, "half": values[:, ::2, ::2], "one channel": values[:1]}[kind]
        write_image(path, values)


@pytest.mark.parametrize(("kind", "code", "reason"), BAD_INPUTS)
def test_bad_images_end_in_one_line_and_no_output(inputs, tmp_path, capsys, kind, code, reason):
    bad_image(kind, inputs / "image.tif", tmp_path / "image.tif")
    assert reconstruct(tmp_path / "image.tif", tmp_path / "out") == code
    assert_one_line(capsys, reason)
    assert not (tmp_path / "out").exists()
    assert [name for name in os.listdir(tmp_path) if name.startswith(".")] == []


@pytest.mark.parametrize(
    ("options", "code", "reason"),
    [
        (["--device", "cuda:9"], 6, "cuda:9"),
        (["--max-time", "nan"], 2, "not a finite number"),
        (["--transfer", "gamma"], 2, "gamma"),
        (["--set", "scene.wavelengths_m=[610, 530, 430]"], 3, "610 nm"),
        (["--set", "simulation.n_photons=0"], 3, "n_photons"),
        (["--set", "reconstruction.metod=x"], 3, "did you mean 'method'"),
        (["--wavelength-order", "610,530"], 3, "wavelength"),
        (["--wavelength-order", "650,530,430"], 5, "wavelength"),
        (["--max-iterations", "0"], 2, "'--max-iterations': '0' is not at least 1"),
        (["--max-time", "0"], 2, "'--max-time': '0' s is no time"),
        (["--set", "reconstruction.options.max_iteration=5"], 3, "max_iteration"),
        (["--method", "magic"], 3, "refine"),
        (["--page", "3"], 3, "page"),
        (["--initial", "{}/rows.npy"], 3, "rows.npy"),
        (["--reference", "{}/small.npy"], 5, "reference"),
        (["--reference", "{}/nan.npy"], 3, "NaN"),
        (["--dark", "{}/none.tif"], 3, "none.tif"),
    ],
)
def test_bad_options_end_in_one_line_and_no_output(inputs, tmp_path, capsys, options, code, reason):
    np.save(tmp_path / "rows.npy", np.zeros((4, 5)))
    np.save(tmp_path / "small.npy", np.zeros((16, 16)))
    np.save(tmp_path / "nan.npy", np.full((32, 32), np.nan))
    before = sorted(os.listdir(tmp_path))
    options = [option.format(tmp_path) for option in options]
    assert reconstruct(inputs / "image.tif", tmp_path / "out", *options) == code
    assert_one_line(capsys, reason)
    assert sorted(os.listdir(tmp_path)) == before


@pytest.mark.parametrize(
    ("kind", "code", "reason"), [("bug", 1, "unexpected KeyError"), ("memory", 6, "out of memory")]
)
def test_a_failing_method_leaves_nothing_behind(fake, inputs, tmp_path, capsys, monkeypatch, kind, code, reason):
    errors = tmp_path / "errors"
    errors.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(errors))
    assert reconstruct(inputs / "image.tif", tmp_path / "out", "--set", f"reconstruction.options.fail={kind}") == code
    assert reason in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["errors"]


def test_a_failure_while_writing_leaves_the_earlier_result(fake, inputs, tmp_path, capsys, monkeypatch):
    assert reconstruct(inputs / "image.tif", tmp_path / "out") == 0
    before = {name: (tmp_path / "out" / name).read_bytes() for name in FILES}

    def fail(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("cli.figures.write_figure", fail)
    assert reconstruct(inputs / "image.tif", tmp_path / "out", "--force", "--max-iterations", "5") == 6
    assert os.listdir(tmp_path) == ["out"]
    assert {name: (tmp_path / "out" / name).read_bytes() for name in FILES} == before


def test_force_replaces_an_earlier_result_and_nothing_else(fake, inputs, tmp_path, capsys):
    out = tmp_path / "out"
    assert reconstruct(inputs / "image.tif", out) == 0
    capsys.readouterr()
    assert reconstruct(inputs / "image.tif", out) == 3
    assert_one_line(capsys, "--force")
    assert reconstruct(inputs / "image.tif", out, "--force", "--max-iterations", "5") == 0
    assert json.loads((out / "result.json").read_text())["iterations"] == 5
    (out / "thesis.tex").write_text("years of work")
    capsys.readouterr()
    assert reconstruct(inputs / "image.tif", out, "--force") == 3
    assert_one_line(capsys, "thesis.tex")
    assert (out / "thesis.tex").exists()
    assert os.listdir(tmp_path) == ["out"]


def test_an_empty_folder_is_filled(fake, inputs, tmp_path):
    (tmp_path / "out").mkdir()
    assert reconstruct(inputs / "image.tif", tmp_path / "out") == 0
    assert (tmp_path / "out" / "result.json").exists()


@pytest.mark.parametrize("target", [".", "..", "missing/out", "file"])
def test_impossible_targets_are_refused(tmp_path, monkeypatch, target):
    (tmp_path / "file").write_text("")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(InputError):
        check_target("../file" if target == "file" else target, True, RECONSTRUCTION)


def test_a_folder_filled_meanwhile_is_not_replaced(tmp_path):
    target = check_target(tmp_path / "out", False, RECONSTRUCTION)
    with (
        pytest.raises(InputError, match="other files") as found,
        result_folder(target, False, RECONSTRUCTION) as folder,
    ):
        (folder / "height.npy").write_text("new")
        target.mkdir()
        (target / "notes.txt").write_text("mine")
    assert os.listdir(target) == ["notes.txt"]
    (kept,) = (path for path in tmp_path.iterdir() if path.name != "out")
    assert kept.name.startswith("out.") and str(kept) in str(found.value)
    assert (kept / "height.npy").read_text() == "new"  # what was computed is not lost


def assert_one_line(capsys, reason):
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: ") and captured.err.count("\n") == 1, captured.err
    assert reason in captured.err


def test_samples_are_written_told_and_shown(fake, inputs, tmp_path, capsys, monkeypatch):
    """Three reliefs, one of which has a little more in one place."""
    plain = fake.Fake.reconstruct

    def with_samples(self, image, *, initial=None, progress=None):
        found = plain(self, image, initial=initial, progress=progress)
        samples = np.repeat(found.heights_m[None], 3, axis=0)
        samples[0, 4:8, 4:8] += 2e-5
        told = {"count": 3, "line": "3: they differ by 11.5 um (root mean square) on 1.6 % of the plate"}
        return dataclasses.replace(found, samples_m=samples, counters=found.counters | {"samples": told})

    monkeypatch.setattr(fake.Fake, "reconstruct", with_samples)
    out = tmp_path / "out"
    assert reconstruct(inputs / "image.tif", out) == 0
    stored = np.load(out / "samples.npy")
    assert stored.shape[0] == 3 and stored.dtype == np.float32
    assert stored[0, 5, 5] - stored[1, 5, 5] == pytest.approx(2e-5, rel=1e-4)
    assert "samples    3: they differ by 11.5 um" in capsys.readouterr().out
    assert json.loads((out / "result.json").read_text())["counters"]["samples"]["count"] == 3
    page = (out / "report.html").read_text(encoding="utf-8")
    assert 'id="samples"' in page and "Samples 3: they differ by 11.5 um" in page
    assert page.count("Map of sample") == 3


@pytest.mark.parametrize(
    ("method", "count", "code", "told"), [("refine", "2", 3, "refine finds one relief"), ("direct", "6", 2, "6")]
)
def test_samples_of_a_method_that_has_none_are_refused(inputs, tmp_path, capsys, method, count, code, told):
    assert reconstruct(inputs / "image.tif", tmp_path / "out", "--method", method, "--samples", count) == code
    message = capsys.readouterr().err
    assert "--samples" in message and told in message
