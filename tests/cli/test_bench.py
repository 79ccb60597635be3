"""``nsfc bench``: lists, runs that go on, scores of others, exports; wrong input in one line."""

import html.parser
import json
import shutil

import numpy as np
import pytest

import nets.evaluation.run as run_module
from cli.main import main
from cli.marker import MARKER
from data_gen.suites.light import true_heights
from data_gen.suites.suites import suite_cases
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_record import FoundBench, FoundNumber
from warp_caustics.io.heights import write_heights
from warp_caustics.reconstruct.base import Reconstruction, Reconstructor
from warp_caustics.setup.parameter import Parameter

ROWS = "careful,another"


class Level(Reconstructor):
    """A level relief, with an uncertainty of as much."""

    name = "direct"

    def __init__(self, lab, scene, level_m=1e-4):
        self.lab, self.scene, self.level_m = lab, scene, level_m

    def reconstruct(self, image, *, initial=None, progress=None):
        self.lab.calls.append((self.scene.base_thickness_m, image.irradiance.copy()))
        if self.lab.stops_at == len(self.lab.calls):
            raise KeyboardInterrupt
        if self.lab.fails:
            raise InputError("no")
        n = self.scene.height_samples
        heights = np.full((n, n), self.level_m)
        gap = Parameter("gap_m", "g", "m", 0.0, 1.0, 1e-5, "screen", "")
        bench = FoundBench((FoundNumber.of(gap, 1e-6, 7e-6, 4e-6, is_used=True),), True, "", 1)
        counters = {"doubt": {"is_doubtful": False}, "bench": bench.record}
        return Reconstruction(
            "direct", heights, image.irradiance, 0.1, "converged", uncertainty_m=heights, counters=counters
        )


class Lab:
    def __init__(self):
        self.calls, self.stops_at, self.fails = [], None, False

    def create(self, name, scene, device, options):
        return Level(self, scene, **options)


@pytest.fixture
def lab(monkeypatch):
    return installed(monkeypatch)


def installed(patch):
    """A laboratory in place of the methods."""
    found = Lab()
    patch.setattr(run_module, "create_method", found.create)
    patch.setattr(run_module, "known_methods", lambda: ("direct",))
    patch.setattr("nets.evaluation.cells.warm_up", lambda scene, device: None)
    return found


def run(output, *options, methods="direct"):
    arguments = ["bench", "run", "--suite", "lab", "--methods", methods, "-o", str(output), "--fields", "1"]
    return main([*arguments, "--rows", ROWS, "--device", "cpu", "--n-photons", "2e4", *options])


@pytest.fixture
def images(made, tmp_path):
    """A folder of results whose images are there already."""
    return with_images(made, tmp_path / "out")


def with_images(made, out):
    out.mkdir()
    shutil.copytree(made / "images", out / "images")
    shutil.copy(made / MARKER, out / MARKER)
    return out


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run of two cells, in its folder; not to be changed."""
    with pytest.MonkeyPatch.context() as patch:
        installed(patch)
        out = tmp_path_factory.mktemp("bench") / "out"
        assert run(out) == 0
    return out


def table(folder):
    return json.loads((folder / "table.json").read_text(encoding="utf-8"))


def test_list(capsys):
    assert main(["bench", "list"]) == 0
    out = capsys.readouterr().out
    assert [line.split()[0] for line in out.splitlines()] == ["ideal", "one-thing", "lab", "prints"]
    assert main(["bench", "list", "--suite", "lab", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found["rows"]) == ["careful", "ordinary", "poor", "another"] and len(found["cases"]) == 20


def test_run_scores_pictures_and_goes_on(lab, images, capsys):
    out = images
    lab.stops_at = 2
    assert run(out) == 130
    assert "interrupted; 1 cells were computed and are kept" in capsys.readouterr().err
    assert not (out / "table.json").exists()
    lab.stops_at = None
    assert run(out) == 0
    said = capsys.readouterr().out
    assert "stated     1 of 2 results are off by more than 3 times" in said
    # Both found as told, a gap of 1 um +- 4; 6 um and 1.02 mm are there.
    assert (
        "numbers    of 2 that images told of their benches 0% are within one standard deviation, 50% within two" in said
    )
    assert [round(1e6 * number["true"], 6) for number in table(out)["numbers"]] == [6.0, 1020.0]
    # The one that was interrupted, not the one before; and each is told the scene of its bench.
    assert [told for told, _ in lab.calls] == [3e-3, 3.2e-3, 3.2e-3]
    rows = table(out)["rows"]
    for row, case in zip(rows, suite_cases("lab", 1, tuple(ROWS.split(","))), strict=True):
        error = 1e-4 - true_heights(case)
        assert row["case"] == case.name and row["status"] == "done" and row["warned"] is False
        assert row["rmse_um"] == pytest.approx(1e6 * np.sqrt(np.mean(error**2)), rel=1e-6)
        assert row["within_one"] == pytest.approx(np.mean(np.abs(error) <= 1e-4), abs=1e-3)
        assert row["rmse_aligned_um"] <= row["rmse_um"] and row["time_s"] > 0
    before = (out / "table.json").read_bytes()
    assert run(out) == 0 and len(lab.calls) == 3
    assert table(out)["rows"] == json.loads(before)["rows"]
    # An image that is lost is the same again.
    min((out / "images").iterdir()).unlink()
    assert run(out) == 0 and len(lab.calls) == 3
    assert run(out, methods="direct:level_m=2e-4") == 0 and len(lab.calls) == 5
    np.testing.assert_array_equal(lab.calls[0][1], lab.calls[3][1])
    assert run(out, "--force") == 0 and len(lab.calls) == 7


class Page(html.parser.HTMLParser):
    """Checks nesting; collects tags and links."""

    VOID = ("meta", "img", "br")

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.links = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href", "action")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def test_page_stands_alone(made):
    text = (made / "index.html").read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert page.open == [] and page.tags.count("img") == 2 and page.tags.count("table") == 3
    assert all(link.startswith("data:image/png;base64,iVBOR") for link in page.links)
    assert "http" not in text and str(made.parent) not in text
    assert f"{table(made)['rows'][0]['rmse_um']:.4g}" in text
    assert "results are off by more than 3 times what they state" in text and "points where light paths cross" in text
    assert "not comparable" in text  # fewer light paths than the suite's


def test_a_method_that_fails_everywhere(lab, images, capsys):
    lab.fails = True
    assert run(images) == 3
    assert "2 of 2 cells failed: direct: no" in capsys.readouterr().err
    assert "<h2>Failed</h2>" in (images / "index.html").read_text(encoding="utf-8")


def test_export_and_score_of_its_truth(tmp_path, capsys):
    suite = ["--suite", "lab", "--fields", "1", "--rows", "poor"]
    target = tmp_path / "suite"
    assert main(["bench", "export", str(target), *suite, "--n-photons", "2e4", "--device", "cpu", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["written"] == 1
    assert main(["bench", "score", str(target / "truth"), *suite, "-o", str(tmp_path / "scores"), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert row["rmse_um"] == row["rmse_aligned_um"] == row["slope_error"] == 0 and row["method"] == "given"
    assert table(tmp_path / "scores")["about"]["suite"] == "lab"
    # Another suite's folder is not this one's.
    assert main(["bench", "export", str(target), "--suite", "ideal", "--fields", "1", "--device", "cpu"]) == 3
    assert "holds other files" in capsys.readouterr().err


def test_scores_of_files(tmp_path, capsys):
    case = suite_cases("prints", 1, ("text",))[0]
    write_heights(tmp_path / "text_0.tif", true_heights(case) + 3e-6)
    assert main(["bench", "score", str(tmp_path), "--suite", "prints", "--rows", "text", "--name", "mine"]) == 0
    found = capsys.readouterr()
    assert "text, mine" in found.out and "1 of 5 plates" in found.out
    assert "warning: 4 of 5 cases have no heights: text_1, text_2, text_3, text_4" in found.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--fields", "6"], "6 plates of each row of lab; there are 5, give 1 to 5"),
        (["--rows", "carful"], "suite lab has no row 'carful'; did you mean 'careful'?"),
        (["--methods", "dirict"], "method 'dirict' is not known"),
        (["--n-photons", "0"], "--n-photons 0 is not between 1 and 1e9"),
    ],
)
def test_wrong_options_are_explained(lab, tmp_path, capsys, options, message):
    arguments = ["bench", "run", "--suite", "lab", "-o", str(tmp_path / "out"), "--device", "cpu"]
    methods = [] if "--methods" in options else ["--methods", "direct"]
    assert main([*arguments, *methods, *options]) == 3
    assert message in capsys.readouterr().err
    assert lab.calls == [] and not (tmp_path / "out").exists()


def test_an_unknown_suite_and_a_foreign_folder(lab, tmp_path, capsys):
    assert main(["bench", "run", "--suite", "labs", "--methods", "direct", "-o", str(tmp_path / "out")]) == 2
    assert "'labs' is not one of" in capsys.readouterr().err
    (tmp_path / "own.txt").write_text("mine")
    assert run(tmp_path) == 3
    assert "holds other files (own.txt)" in capsys.readouterr().err


def test_plates_of_another_seed(made, tmp_path, lab, capsys):
    own = with_images(made, tmp_path / "own")
    assert run(own) == 0 and run(tmp_path / "other", "--seed", "7") == 0
    own, other = (json.loads((tmp_path / name / "table.json").read_text()) for name in ("own", "other"))
    assert (own["about"]["seed"], other["about"]["seed"], other["about"]["jobs"]) == (None, 7, 1)
    assert own["rows"][0]["flat_um"] != other["rows"][0]["flat_um"]
    assert [row["title"] for row in own["rows"]] == [row["title"] for row in other["rows"]]
    assert ". Plates of seed 7 instead of the suite's own" in (tmp_path / "other" / "index.html").read_text()
    assert "Plates of seed" not in (tmp_path / "own" / "index.html").read_text()
    capsys.readouterr()
    assert run(tmp_path / "wrong", "--seed", "-1") == 3
    assert "seed -1 is not between 0 and 2^62" in capsys.readouterr().err


def test_several_processes_find_the_same(made, tmp_path, capsys):
    """And what they computed is kept: the same command computes nothing anew."""
    assert run(with_images(made, tmp_path / "one"), methods="flat") == 0
    assert run(tmp_path / "two", "--jobs", "2", methods="flat") == 0
    assert "2 jobs share this machine" in capsys.readouterr().err
    one, two = (json.loads((tmp_path / name / "table.json").read_text())["rows"] for name in ("one", "two"))
    assert [row | {"time_s": 0} for row in one] == [row | {"time_s": 0} for row in two]
    assert run(tmp_path / "two", methods="flat") == 0
    assert "2 cells, 0 computed now" in capsys.readouterr().out
    assert run(tmp_path / "two", "--jobs", "0", methods="flat") == 3
    assert "0 jobs; give 1 to 64" in capsys.readouterr().err


def test_cells_keep_what_a_result_states(images, lab):
    assert run(images) == 0
    cells = sorted((images / "cells").glob("*.npz"))
    assert len(cells) == 2
    for path in cells:
        with np.load(path) as file:
            assert set(file) == {"heights_m", "uncertainty_m"} and np.all(file["uncertainty_m"] == np.float32(1e-4))
        counters = json.loads(path.with_suffix(".json").read_text())["counters"]
        assert counters["doubt"] == {"is_doubtful": False} and counters["bench"]["numbers"][0]["sigma"] == 4e-6
