"""``nsfc reconstruct --set-up``, ``--prior`` and what a calibrated bench tells besides its scene."""

import pytest
import torch

from cli.bench_told import told_options
from cli.config import Config, ReconstructionConfig
from cli.main import main
from cli.report.tables import bench_rows
from cli.results import found_bench_lines
from warp_caustics.calibration.bench_file import Bench, BenchParameter, scene_tree, write_bench
from warp_caustics.camera.config import CameraConfig
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.bench_record import FoundBench, FoundNumber
from warp_caustics.found_bench.thin_relief import MAGNIFICATION
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=16, image_pixels=64)


def of(method="direct", **options):
    return Config(scene=SCENE, reconstruction=ReconstructionConfig(method=method, options=options))


@pytest.fixture
def bench(tmp_path):
    def parameter(name, sigma):
        return BenchParameter(name=name, unit="1", value=0.0, sigma=sigma, before=0.0, prior=1.0, verdict="found")

    names = {
        "gap_m": 2e-5,
        "vergence_per_m": 0.02,
        "ambient.0": 1e-3,
        "ambient.1": 2e-3,
        "ambient.2": 3e-3,
        "psf_px.0": 0.1,
        "shift_x_px": 0.1,
        MAGNIFICATION: 1e-4,
    }
    found = tuple(parameter(name, sigma) for name, sigma in names.items())
    camera = CameraConfig(ambient=(0.01, 0.02, 0.03))
    covariance = tuple(map(tuple, torch.eye(len(found)).tolist()))
    write_bench(
        tmp_path / "bench.yaml",
        Bench(nsfc_bench=1, scene=scene_tree(SCENE), camera=camera, parameters=found, covariance=covariance),
    )
    return str(tmp_path / "bench.yaml")


def options(*arguments):
    return told_options(*arguments).reconstruction.options


def test_nothing_said_changes_nothing():
    config = of(refine=False)
    assert options(config, None, None, ()) == {"refine": False}
    assert options(of("refine"), None, "known", ()) == {}


def test_set_up_and_widths_are_options_of_the_method():
    found = options(of(priors={"gap_m": 1e-3, AMBIENT: 0.1}), None, "estimate", ("gap_m=1e-4",))
    assert found == {"set_up": "estimate", "priors": {"gap_m": 1e-4, AMBIENT: 0.1}}


def test_widths_are_of_the_uncertainty_too():
    assert options(of(), None, None, ("gap_m=1e-4",)) == {"priors": {"gap_m": 1e-4}}


def test_a_search_and_widths_need_a_method_that_knows_them():
    with pytest.raises(InputError, match="--prior is for --method auto, direct, fibres, not refine"):
        told_options(of("refine"), None, None, ("gap_m=1e-4",))
    with pytest.raises(InputError, match="is for --method auto, direct, fibres, not sfc"):
        told_options(of("sfc"), None, "estimate", ())


def test_a_bench_tells_its_stray_light_and_its_deviations(bench):
    widths = {"gap_m": 2e-5, "vergence_per_m": 0.02, AMBIENT: pytest.approx(2e-3), MAGNIFICATION: 1e-4}
    widths["screen_x_m"] = pytest.approx(0.1 * SCENE.pixel_size_m[0])  # the camera's shift, in its pixels
    assert options(of(), bench, None, ()) == {"ambient": pytest.approx(0.02), "priors": widths}
    found = options(of(), bench, "estimate", ("vergence_per_m=0.5",))
    assert found["priors"] == widths | {"vergence_per_m": 0.5}
    assert options(of(ambient=0.0), bench, None, ())["ambient"] == 0.0  # what a configuration says wins
    assert options(of("refine"), bench, None, ()) == {}


def test_an_unknown_word_is_refused(capsys):
    assert main(["reconstruct", "image.tif", "-o", "out", "--set-up", "guess"]) == 2
    assert "known" in capsys.readouterr().err


def record():
    numbers = BenchNumbers.of(SCENE)
    by_name = {p.name: p for p in (*numbers.parameters, *numbers.not_told)}
    found = FoundNumber.of(by_name["vergence_per_m"], 0.0, 1.01, 0.05, is_used=True)
    as_told = FoundNumber.of(by_name[AMBIENT], 0.0, 0.001, 0.004, is_used=True)
    return FoundBench((found, as_told, FoundNumber.not_told(by_name["gap_m"], 1e-6)), True, "why", 2).record


def test_the_terminal_says_what_was_found_and_what_is_not_told():
    image = torch.ones(3, 64, 64).numpy()
    result = Reconstruction("direct", image[0], image, 0.1, "converged", counters={"bench": record()})
    lines = found_bench_lines(result)
    assert lines[0] == "bench      vergence_per_m 1.01 +- 0.05 1/m, told 0"
    assert lines[1].startswith("bench      ambient 0 +- 0.004") and lines[1].endswith("as told")
    assert lines[2] == "bench      not told by this image: gap_m"
    assert found_bench_lines(Reconstruction("direct", image[0], image, 0.1, "converged")) == []


def test_a_number_in_doubt_is_not_called_as_told():
    by_name = {p.name: p for p in BenchNumbers.of(SCENE).parameters}
    doubted = FoundNumber.of(by_name["vergence_per_m"], 0.0, 1.01, 0.05, is_used=False)
    counters = {"bench": FoundBench((doubted,), False, "why", 2).record}
    image = torch.ones(3, 64, 64).numpy()
    (line,) = found_bench_lines(Reconstruction("direct", image[0], image, 0.1, "converged", counters=counters))
    assert line == "bench      vergence_per_m 0 +- 0.05 1/m, as told, in doubt: the image looks as of 1.01"


def test_the_report_has_a_row_for_each_number():
    rows = bench_rows({"counters": {"bench": record()}})
    assert [row[0] for row in rows] == ["vergence_per_m", AMBIENT, "gap_m"]
    assert rows[0][1:] == ["0", "1.01", "0.05", "1/m", "found"]
    assert rows[2][5].startswith("not told by this image: heights")
    assert bench_rows({}) == []
