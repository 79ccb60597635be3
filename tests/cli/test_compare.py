"""``nsfc compare``: right numbers, nothing computed twice, one failure fails one cell."""

import csv
import html.parser
import json
import os

import numpy as np
import pytest

import cli.comparison.page as page_module
import nets.evaluation.run as run_module
from cli.main import main
from warp_caustics.errors import InputError
from warp_caustics.reconstruct.base import Reconstruction, Reconstructor


class Lab:
    """Methods that only pretend, and a record of what they were asked."""

    def __init__(self):
        self.calls = []
        self.raises = {}

    def create(self, name, scene, device, options):
        if "unknown" in options:
            raise InputError(f"{name}.unknown: unknown key; remove it or check its spelling")
        return Level(self, name, scene, dict(options))


class Level(Reconstructor):
    """A level relief of 100 um after the first iteration, halved by each further one; starts at the initial one."""

    def __init__(self, lab, name, scene, options):
        self.lab, self.name, self.scene, self.options = lab, name, scene, options

    def reconstruct(self, image, *, initial=None, progress=None):
        iterations = self.options.get("max_iterations", 20)
        self.lab.calls.append((self.name, iterations, image.irradiance.copy()))
        error = self.lab.raises.get((self.name, len(self.lab.calls)), self.lab.raises.get(self.name))
        if error is not None:
            raise error
        n = self.scene.height_samples
        start = np.zeros((n, n)) if initial is None else initial
        heights = start + self.options.get("level_m", 1e-4) * 0.5 ** (iterations - 1)
        settings = {"knowledge": {"mask": "oracle"}} if "oracle_heights_m" in self.options else {}
        history = [{"iteration": k + 1, "residual": 0.1} for k in range(iterations)]
        return Reconstruction(
            self.name, heights, image.irradiance, 0.1, "max_iterations", history, settings=settings,
            warnings=("level",),
        )  # fmt: skip


@pytest.fixture
def lab(monkeypatch):
    found = Lab()
    monkeypatch.setattr(run_module, "create_method", found.create)
    monkeypatch.setattr(run_module, "known_methods", lambda: ("refine", "sfc", "transport", "direct"))
    return found


@pytest.fixture
def no_page(monkeypatch):
    """Leaves the page out, which takes longer to draw than everything else here."""
    monkeypatch.setattr(page_module, "write_page", lambda path, *everything: None)


@pytest.fixture
def plates(tmp_path, relief):
    """Two plates of 32 x 32 samples, the second three times as high."""
    for name, factor in (("low", 1.0), ("high", 3.0)):
        np.save(tmp_path / f"{name}.npy", factor * relief)
    return [str(tmp_path / f"{name}.npy") for name in ("low", "high")]


def compare(plates, output, methods, *options):
    arguments = ["compare", *plates, "--methods", methods, "-o", str(output), "--config", "small", "--device", "cpu"]
    return main([*arguments, "--n-photons", "2e4", *map(str, options)])


def table(folder):
    return json.loads((folder / "table.json").read_text(encoding="utf-8"))


def test_table_holds_the_known_errors(lab, no_page, plates, tmp_path, relief, capsys):
    out = tmp_path / "out"
    assert compare(plates, out, "refine,transport+refine,sfc:mask=oracle", "--iterations", "1,3,converged") == 0
    rows = {(row["field"], row["method"], row["budget"]): row for row in table(out)["rows"]}
    assert len(rows) == 2 * 3 * 3
    for name, true in (("low", relief), ("high", 3 * relief)):
        for budget, iterations in (("1", 1), ("3", 3), ("converged", 20)):
            row = rows[name, "refine", budget]
            error = 1e-4 * 0.5 ** (iterations - 1) - true
            assert row["rmse_um"] == pytest.approx(1e6 * np.sqrt(np.mean(error**2)))
            assert row["rmse_mean_removed_um"] == pytest.approx(1e6 * error.std())
            assert row["quantile95_um"] == pytest.approx(1e6 * np.quantile(np.abs(error), 0.95))
            assert row["iterations"] == iterations and row["status"] == "done" and row["privileged"] == []
            assert row["time_s"] > 0 and row["peak_memory_MB"] > 50 and row["stop_reason"] == "max_iterations"
        # The second stage starts where the first ended, after its own 20 iterations.
        chained = rows[name, "transport+refine", "1"]
        error = 1e-4 * (1 + 0.5**19) - true
        assert chained["rmse_um"] == pytest.approx(1e6 * np.sqrt(np.mean(error**2)))
        assert chained["warnings"] == ["start: level", "level"]
        assert rows[name, "sfc:mask=oracle", "1"]["privileged"] == ["mask"]
    summary = {(row["method"], row["budget"]): row for row in table(out)["summary"]}
    both = [rows[name, "refine", "3"]["rmse_um"] for name in ("low", "high")]
    assert summary["refine", "3"]["rmse_um_mean"] == pytest.approx(np.mean(both))
    assert summary["refine", "3"]["done"] == 2
    with open(out / "table.csv", encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    assert [float(line["rmse_um"]) for line in lines] == pytest.approx([row["rmse_um"] for row in rows.values()])
    # All methods saw one image per field.
    images = {image.tobytes() for _, _, image in lab.calls}
    assert len(images) == 2
    assert "refine, 3" in capsys.readouterr().out


def test_nothing_is_computed_twice(lab, no_page, plates, tmp_path):
    out = tmp_path / "out"
    options = "--iterations", "1,converged"
    assert compare(plates[:1], out, "refine,direct", *options) == 0
    first = table(out)["rows"]
    assert len(lab.calls) == 3
    assert compare(plates[:1], out, "refine,direct", *options) == 0
    assert len(lab.calls) == 3 and table(out)["rows"] == first
    # Another setting, another method, another field: only these.
    assert compare(plates[:1], out, "refine:level_m=2e-4,direct,sfc", *options) == 0
    assert [name for name, _, _ in lab.calls[3:]] == ["refine", "refine", "sfc", "sfc"]
    assert compare(plates, out, "direct", *options) == 0
    assert [name for name, _, _ in lab.calls[7:]] == ["direct"]
    assert compare(plates[:1], out, "direct", "--noise", "0.02") == 0
    assert compare(plates[:1], out, "direct", "--set", "scene.base_thickness_m=0.004") == 0
    assert len(lab.calls) == 10
    assert compare(plates[:1], out, "refine,direct", *options, "--force") == 0
    assert len(lab.calls) == 13


def test_changed_code_and_damaged_cells_are_computed_anew(lab, no_page, plates, tmp_path, monkeypatch):
    out = tmp_path / "out"
    assert compare(plates[:1], out, "direct,sfc:max_iterations=2") == 0
    for number, suffix in enumerate((".json", ".npz")):
        cell = sorted((out / "cells").glob(f"*{suffix}"))[0]
        cell.write_bytes(cell.read_bytes()[:-20])
        assert compare(plates[:1], out, "direct,sfc:max_iterations=2") == 0
        assert len(lab.calls) == 3 + number
    monkeypatch.setattr("nets.evaluation.cells.code_version", lambda: "another")
    assert compare(plates[:1], out, "direct") == 0
    assert len(lab.calls) == 5


def test_interrupted_comparison_goes_on(lab, no_page, plates, tmp_path, capsys):
    out = tmp_path / "out"
    lab.raises["sfc", 4] = KeyboardInterrupt()
    assert compare(plates, out, "direct,sfc", "--iterations", "1,2,3") == 130
    assert "interrupted; 3 cells were computed and are kept" in capsys.readouterr().err
    assert not (out / "table.json").exists()
    assert len(list((out / "cells").glob("*.json"))) == 3
    lab.raises.clear()
    assert compare(plates, out, "direct,sfc", "--iterations", "1,2,3") == 0
    assert len(lab.calls) == 4 + 5
    assert len(table(out)["rows"]) == 8


def test_two_comparisons_into_one_folder(lab, no_page, plates, tmp_path, capsys, monkeypatch):
    """The second is refused as a second training is; the first ends as if nothing had been."""
    out, codes = tmp_path / "out", []
    reconstruct = Level.reconstruct

    def meanwhile(self, image, **options):
        if not codes:
            codes.append(None)
            codes[0] = compare(plates, out, "direct", "--iterations", "1")
        return reconstruct(self, image, **options)

    monkeypatch.setattr(Level, "reconstruct", meanwhile)
    assert compare(plates, out, "direct,sfc", "--iterations", "1") == 0
    assert codes == [5]
    assert f"is being written by process {os.getpid()}" in capsys.readouterr().err
    assert len(table(out)["rows"]) == 4 and not [name for name in os.listdir(tmp_path) if name.startswith(".nsfc")]
    assert compare(plates, out, "direct", "--iterations", "1") == 0


def test_a_failing_method_fails_alone(lab, no_page, plates, tmp_path, capsys):
    out = tmp_path / "out"
    lab.raises["sfc"] = InputError("the image holds 0 W/m^2; record it again")
    lab.raises["direct"] = ZeroDivisionError("on purpose")
    assert compare(plates[:1], out, "sfc,direct,refine", "--iterations", "1") == 0
    err = capsys.readouterr().err
    assert "warning: low, sfc, 1 iteration: failed, the image holds 0 W/m^2; record it again" in err
    assert "2 of 3 cells failed" in err
    rows = {row["method"]: row for row in table(out)["rows"]}
    assert rows["sfc"]["status"] == "failed" and rows["sfc"]["rmse_um"] is None
    assert rows["direct"]["reason"] == "unexpected ZeroDivisionError: on purpose"
    assert rows["refine"]["status"] == "done"
    (trace,) = (out / "cells").glob("*.traceback.txt")
    assert "in reconstruct" in trace.read_text(encoding="utf-8")
    # What failed is tried again, what worked is not.
    lab.raises.clear()
    before = len(lab.calls)
    assert compare(plates[:1], out, "sfc,direct,refine", "--iterations", "1") == 0
    assert sorted(name for name, _, _ in lab.calls[before:]) == ["direct", "sfc"]


def test_exit_code_where_nothing_worked(lab, no_page, plates, tmp_path):
    lab.raises["sfc"] = InputError("no")
    lab.raises["refine"] = MemoryError()
    assert compare(plates[:1], tmp_path / "out", "sfc", "--iterations", "1") == 3
    assert compare(plates[:1], tmp_path / "out", "sfc,refine", "--iterations", "1") == 6
    lab.raises["refine"] = KeyError("bug")
    assert compare(plates[:1], tmp_path / "out", "sfc,refine", "--iterations", "1") == 1


def test_nonsense_heights_are_a_failure(lab, no_page, plates, tmp_path, capsys):
    """NaN is a valid setting of the method that only pretends; it must not become a score."""
    assert compare(plates[:1], tmp_path / "out", "direct:level_m=nan,refine", "--iterations", "1") == 0
    assert "direct:level_m=nan: failed, direct:level_m=nan returned heights that are not finite" in (
        capsys.readouterr().err
    )


def test_a_method_that_cannot_be_made_is_named_at_once(lab, no_page, plates, tmp_path, capsys):
    assert compare(plates[:1], tmp_path / "out", "sfc:unknown=1,direct") == 0
    err = capsys.readouterr().err
    assert err.startswith("warning: sfc:unknown=1: sfc.unknown: unknown key")
    assert compare(plates[:1], tmp_path / "other", "sfc:unknown=1") == 3
    assert compare(plates[:1], tmp_path / "other", "sfz") == 3
    assert "method 'sfz' is not known; did you mean 'sfc'?" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


class Page(html.parser.HTMLParser):
    """Checks nesting; collects tags, links and heads."""

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


def test_page_stands_alone(lab, plates, tmp_path):
    out = tmp_path / "out"
    lab.raises["direct"] = InputError("the image holds < 1 W/m^2")
    assert compare(plates, out, "refine,sfc:max_iterations=2,direct", "--iterations", "1,2,converged") == 0
    text = (out / "index.html").read_text(encoding="utf-8")
    page = Page()
    page.feed(text)
    assert page.open == []
    assert page.links and all(link.startswith("data:image/png;base64,iVBOR") for link in page.links)
    # Curves, scatter, truth, three sheets of refine and one of sfc; nothing was found by direct.
    assert page.tags.count("img") == 3 + 3 + 1
    # Failures, summary, by field, warnings, all; both fields have few folds, so there is no table by folds.
    assert page.tags.count("table") == 5
    assert text.count("the image holds &lt; 1 W/m^2") == 1
    assert "the image holds &lt; 1 W/m^2" in text
    assert "http" not in text and str(tmp_path) not in text
    rows = table(out)["rows"]
    assert f"{rows[0]['rmse_um']:.4g}" in text


def test_real_methods_in_two_processes(no_page, plates, tmp_path, capsys):
    """The same cells as one process finds, and the flat guess as good as it must be."""
    options = "--iterations", "20", "--set", "scene.image_pixels=64", "--n-photons", "1e5"
    assert compare(plates, tmp_path / "two", "flat,refine", *options, "--jobs", "2") == 0
    assert compare(plates, tmp_path / "one", "flat,refine", *options) == 0
    one, two = (table(tmp_path / name)["rows"] for name in ("one", "two"))
    for here, there in zip(one, two, strict=True):
        assert (here["field"], here["method"], here["key"]) == (there["field"], there["method"], there["key"])
        assert there["rmse_um"] == pytest.approx(here["rmse_um"], rel=1e-3)
    relief = np.load(plates[0])
    assert one[0]["rmse_um"] == pytest.approx(1e6 * np.sqrt(np.mean(relief**2)))
    assert one[1]["method"] == "refine" and one[1]["image_error"] < one[0]["image_error"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--testset"], "give either height maps or --testset"),
        (["--fields", "2"], "add --testset"),
        (["--noise", "2"], "noise 2 is not between 0 and 1"),
        (["--jobs", "0"], "0 jobs; give 1 to 64"),
        (["--iterations", "often"], "'often' is no whole number"),
    ],
)
def test_wrong_options_are_explained(lab, plates, tmp_path, capsys, options, message):
    assert compare(plates[:1], tmp_path / "out", "direct", *options) == 3
    assert message in capsys.readouterr().err
    assert lab.calls == []


def test_a_folder_of_something_else_is_left_alone(lab, plates, tmp_path, capsys):
    assert compare(plates[:1], tmp_path, "direct") == 3
    assert "holds other files (high.npy, low.npy)" in capsys.readouterr().err
    assert compare(plates[:1], plates[0], "direct") == 3
    assert compare(plates[:1], tmp_path / "a" / "b", "direct") == 3
    assert "create it first" in capsys.readouterr().err
