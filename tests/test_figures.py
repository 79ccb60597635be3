"""Figures of README and docs are those of stored results."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import conditioning
from benchmarks.stored_robustness import DEVELOPMENT_ROWS, OWN_ROWS, row
from data_gen.dataset_config import sample_generator
from data_gen.patterns import draw_strokes
from data_gen.testset import fields_config
from nets.reconstruct.refinement import DEFAULT_ITERATIONS
from nets.reconstruct.uncertainty import DIRECT_CALIBRATION
from warp_caustics.height_field import cell_centres

ROOT = Path(__file__).parents[1]
STORED = json.loads((ROOT / "benchmarks" / "robustness_h200.json").read_text(encoding="utf-8"))
ITERATED = json.loads((ROOT / "benchmarks" / "learned_h200.json").read_text(encoding="utf-8"))["iterations/full"]
BENCH = json.loads((ROOT / "benchmarks" / "bench.json").read_text(encoding="utf-8"))["suites"]
LINES = BENCH["ideal"]["fibres"]["field"]
AUTO_CPU = json.loads((ROOT / "benchmarks" / "auto_cpu.json").read_text(encoding="utf-8"))
RELEASE = json.loads((ROOT / "benchmarks" / "release.json").read_text(encoding="utf-8"))["cells"]
CPU, GPU = "two CPU cores", "one H200"


def page(name):
    return (ROOT / name).read_text(encoding="utf-8")


def table(text, head):
    """Rows of the table whose head begins so, without emphasis."""
    rows = text.split(f"{head}")[1].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip().replace("*", "") for cell in row.strip("|").split("|")] for row in rows]


def without_emphasis(rows):
    return [[cell.replace("*", "") for cell in cells] for cells in rows]


def figures(cell):
    return [float(number) for number in re.findall(r"\d+(?:\.\d+)?", cell)]


def errors(method, device):
    """RMSE of the ten development fields [um], in their order."""
    found = STORED["development"][device]["ideal"][method]["rmse_um"]
    assert len(found) == 10
    return np.array(found)


ROWS = {
    "flat guess": np.array(STORED["flat_rmse_um"]),
    "nsfc": np.array(ITERATED)[:, 10],
    "direct cpu": errors("direct", CPU),
    "direct gpu": errors("direct", GPU),
    "symmetries": errors("direct:refine=false", CPU),
    "fibres": np.array(LINES["rmse_um"]),
    "auto cpu": np.array(AUTO_CPU["rmse_um"]),
}


def agrees(printed, values):
    """Mean, median and worst, as far as they are printed, to half of their last digit."""
    for text, value in zip(printed, (values.mean(), np.median(values), values.max()), strict=False):
        digits = len(text.partition(".")[2])
        assert abs(float(text) - value) <= 0.5001 * 10.0**-digits, (text, value)


def printed(cell):
    """mean / median of a cell, before any time."""
    return re.findall(r"\d+(?:\.\d+)?", cell.split(",")[0])


def released(method):
    """Errors of a method on the thirty test fields [um]."""
    return np.array([cell["rmse_um"] for cell in RELEASE if cell["method"] == method])


def test_readme():
    rows = {row[0]: row[1:] for row in table(page("README.md"), "| relief RMSE, mean / median |")}
    agrees(printed(rows["flat guess"][0]), ROWS["flat guess"])
    nsfc = next(cells for name, cells in rows.items() if name.startswith("`nsfc`"))
    agrees(printed(nsfc[1]), ROWS["nsfc"])
    direct = next(cells for name, cells in rows.items() if name.startswith("`direct`"))
    agrees(printed(direct[0]), ROWS["direct cpu"])
    agrees(printed(direct[1]), ROWS["direct gpu"])
    lines = next(cells for name, cells in rows.items() if name.startswith("`fibres`"))
    assert len(rows) == 4
    for cell, of, times in ((lines[0], "auto cpu", AUTO_CPU["time_s"]), (lines[1], "fibres", LINES["time_s"])):
        agrees(printed(cell), ROWS[of])
        assert [round(min(times)), round(max(times))] == figures(cell.split(",")[1])
    assert direct[0].endswith(STORED["times"][CPU]["direct"])
    assert direct[1].endswith("0.42 s") and STORED["times"][GPU]["direct"] == "422 ms"


def test_readme_on_an_ordinary_bench():
    (stated,) = re.findall(r"`fibres` ends ([\d.]+) um off on an H\d00", page("README.md"))
    agrees([stated], np.array(BENCH["lab"]["fibres"]["ordinary"]["rmse_um"]))


def test_lines_on_benches_of_a_lab():
    rows = {
        row[0].partition(",")[0]: row[2:] for row in table(page("docs/fibres.md"), "| bench | `direct`, bench as told")
    }
    for name in ("careful", "ordinary", "poor", "another"):
        for cell, method in zip(rows[name], ("direct", "fibres"), strict=True):
            agrees([cell], np.array(BENCH["lab"][method][name]["rmse_um"]))


def test_readme_on_test_fields():
    text = " ".join(page("README.md").split())
    (flat,) = re.findall(r"one H200; flat guess ([\d.]+ / [\d.]+) um, mean / median\)", text)
    found = dict(re.findall(r"`(\w+)` ([\d.]+ / [\d.]+) um", text.split("flat guess 450")[1])) | {"flat": flat}
    assert set(found) == {"flat", "fibres", "direct", "nsfc"}
    for method, cell in found.items():
        agrees(printed(cell), released(method))
    (least,) = re.findall(r"which know nothing of prints, (\d+) um and more", text)
    others = ("refine", "sfc", "hcccd", "transport")
    agrees([least], min((released(method) for method in others), key=np.mean))


def test_test_fields():
    """The whole table, every cell of which is of one code version and one device, and of thirty fields."""
    assert {(cell["code"], cell["device_name"], cell["image"]["set"]) for cell in RELEASE} == {
        (RELEASE[0]["code"], "NVIDIA H200", "test")
    }
    rows = {row[0]: row[1:] for row in table(page("docs/learned.md"), "| thirty test fields |")}
    assert {name.strip("`").replace("flat guess", "flat") for name in rows} == {cell["method"] for cell in RELEASE}
    for name, (*errors, covered) in rows.items():
        method = name.strip("`").replace("flat guess", "flat")
        errors = [text.strip("*") for text in errors]
        assert len(released(method)) == 30
        agrees(errors, released(method))
        within = [cell["within"] for cell in RELEASE if cell["method"] == method and "within" in cell]
        assert (covered == "") == (not within)
        if within:
            assert covered == ", ".join(f"{100 * share:.0f}" for share in np.mean(within, axis=0)) + " %"


def test_readme_on_cameras():
    (text,) = re.findall(
        r"0\.3 px\s+apart, or blurred by 1 px, the ten plates are ([\d.]+) and ([\d.]+) um off on an H200 instead of "
        r"([\d.]+)\.\s",
        page("README.md"),
    )
    conditions = STORED["development"][GPU]
    for said, condition in zip(text, ("opposite-0.3", "blur-1", "ideal"), strict=True):
        agrees([said], np.array(conditions[condition]["direct"]["rmse_um"]))


def test_plates_as_simulated_are_the_same_everywhere():
    """`direct` on the ten plates on an H200: one stored figure, wherever it is quoted."""
    (said,) = re.findall(r"development fields, one H200: ([\d.]+) um", page("docs/training.md"))
    agrees([said], ROWS["direct gpu"])


@pytest.mark.parametrize("name", ["README.md", "docs/fibres.md"])
def test_lines_against_the_network(name):
    """How many times as exact ``fibres`` is as ``direct``, plate by plate."""
    (low, high) = re.search(r"(\d+) to (\d+) times as\s+exact", page(name)).groups()
    ratio = ROWS["direct gpu"] / ROWS["fibres"]
    assert (int(low), int(high)) == (round(ratio.min()), round(ratio.max()))


def test_conditions():
    """The first table of docs/learned.md, and its table of own fields."""
    before = STORED["symmetries_before"]
    conditions = STORED["development"][GPU]
    rows = [[name, *row(conditions[key], key), before.get(key, "")] for name, key in DEVELOPMENT_ROWS.items()]
    assert table(page("docs/learned.md"), "| image of the ten plates |") == without_emphasis(rows)
    own = [[name, *row(STORED["own_fields"][GPU][key], key)] for name, key in OWN_ROWS.items()]
    text = page("docs/learned.md").split("On 60 own fields")[1]
    assert table(text, "| image |") == without_emphasis(own)


def test_figures_are_of_as_many_steps_as_are_taken_by_default():
    """And the page says of how many; weights do not tell."""
    assert {"cuda": STORED["steps"][GPU], "cpu": STORED["steps"][CPU]} == DEFAULT_ITERATIONS
    rows = {row[0]: row for row in table(page("docs/learned.md"), "| ten plates as simulated |")}
    for device, name in (("cuda", "a GPU"), ("cpu", "a CPU")):
        (said,) = [row for row in rows if row.startswith(f"`direct` on {name}: these, and ")]
        assert f"{DEFAULT_ITERATIONS[device]} steps" in said
    times = [rows["mean of eight symmetries (`refine=false`)"], rows[next(row for row in rows if "on a GPU" in row)]]
    assert [row[4] for row in times] == [STORED["times"][GPU][name] for name in ("direct:refine=false", "direct")]


def on_top_of_each_other(field, lines=3):
    """Share of a development plate's samples that so many of its lines cover, or more."""
    config = fields_config()
    strokes = draw_strokes(config.reliefs, sample_generator(config.sample_fingerprint(), "relief", field))
    size, n = np.array(config.scene.plate_size_m), config.scene.height_samples
    along_x, along_y = (cell_centres(n, side) for side in size)
    points = np.stack(np.meshgrid(along_x, along_y), axis=-1)
    count = np.zeros((n, n), dtype=int)
    for start, end, width in zip(strokes[:, 1:3], strokes[:, 3:5], strokes[:, 5], strict=True):
        way = end - start
        along = np.clip((points - start) @ way / (way @ way), 0, 1)
        count += np.linalg.norm(points - start - along[..., None] * way, axis=-1) < width / 2
    return np.mean(count >= lines)


def test_sections_that_stay_above_what_was_wanted():
    """By how much, and which plates make up the means."""
    text = " ".join(page("docs/learned.md").split())
    wanted = {"ellipse": 24, "parabola": 16, "gaussian": 15, "quarter": 15, "squashed": 15}
    found = {name: np.array(STORED["development"][GPU][name]["direct"]["rmse_um"]) for name in wanted}
    said = re.search(
        r"Gaussian \(([\d.]+)\) and squashed \(([\d.]+)\) are there; ellipse \(([\d.]+)\), parabola \(([\d.]+)\) and "
        r"quarter \(([\d.]+)\) stay (\d+), (\d+) and (\d+) % above",
        text,
    )
    told = ("gaussian", "squashed", "ellipse", "parabola", "quarter")
    for name, mean in zip(told, said.groups()[:5], strict=True):
        agrees([mean], found[name])
    above = {name: round(100 * (found[name].mean() / wanted[name] - 1)) for name in told}
    assert [above[name] for name in told[2:]] == [int(share) for share in said.groups()[5:]]
    assert max(above[name] for name in told[:2]) <= 0
    (low, high) = re.search(
        r"make up (\d+) to (\d+) % of the means of these three and of the first row: 1, 5, 4 and 3", text
    ).groups()
    rows = np.stack([ROWS["direct gpu"], *(found[name] for name in told[2:])])
    shares = 100 * rows[:, [1, 3, 4, 5]].sum(axis=1) / rows.sum(axis=1)
    assert (int(low), int(high)) == (round(shares.min()), round(shares.max()))
    (least, most) = re.search(
        r"The other six, .* end at ([\d.]+) to ([\d.]+) um with any of these three", text
    ).groups()
    easy = [0, 2, 6, 7, 8, 9]
    agrees([least], np.array([rows[1:, easy].min()]))
    agrees([most], np.array([rows[1:, easy].max()]))
    covered = np.array([100 * on_top_of_each_other(field) for field in range(10)])
    (hard_share, easy_share) = re.search(r"over at least ([\d.]+) % .* at most ([\d.]+) % of it, end", text).groups()
    agrees([hard_share], np.array([covered[[1, 3, 4, 5]].min()]))
    agrees([easy_share], np.array([covered[easy].max()]))


def test_refinements_that_made_a_result_worse():
    """Of those of own fields; the page says how many there are, and by how much the worst is."""
    pairs = np.array(
        [
            [found["direct"]["rmse_um"], found["direct:refine=false"]["rmse_um"]]
            for found in STORED["own_fields"][GPU].values()
        ]
    )
    worse = (pairs[:, 0] - pairs[:, 1])[pairs[:, 0] > 1.0005 * pairs[:, 1]]
    assert len(worse) == 1 and round(float(worse[0]), 1) == 0.9 and pairs[:, 0].size == 240
    text = " ".join(page("docs/learned.md").split())
    assert "of the 240 refinements in this table **one made a result worse than the network's answer, by 0.9 um" in text


def test_ten_plates():
    rows = {row[0]: row[1:] for row in table(page("docs/learned.md"), "| ten plates as simulated |")}
    beginnings = {
        "flat guess": "flat guess",
        "`nsfc`": "nsfc",
        "mean of eight": "symmetries",
        "`direct` on a CPU": "direct cpu",
        "`direct` on a GPU": "direct gpu",
        "`auto` on a CPU": "auto cpu",
        "`fibres`": "fibres",
    }
    assert len(rows) == len(beginnings)
    for beginning, stored in beginnings.items():
        cells = next(cells for name, cells in rows.items() if name.startswith(beginning))
        agrees([cell for cell in cells[:3] if cell], ROWS[stored])
    fields = {row[0]: row[1:] for row in table(page("docs/learned.md"), "| field, H200 |")}
    for name, stored in (("`direct`", "direct gpu"), ("`fibres`", "fibres")):
        for text, value in zip(fields[name], ROWS[stored], strict=True):
            agrees([text], np.array([value]))


def test_the_ten_are_easier_than_most():
    flat = np.array(STORED["random_fields"]["flat_rmse_um"])
    ten = ROWS["flat guess"]
    assert len(flat) == 2000
    text = " ".join(page("docs/learned.md").split())
    said = re.search(
        r"median of (\d+) um on these ten, of (\d+) um on 2,000 random fields \(mean (\d+) and (\d+); quartiles "
        r"(\d+) and (\d+)\), of which (\d+) %",
        text,
    )
    share = 100 * (flat > np.median(ten)).mean()
    true = np.median(ten), np.median(flat), ten.mean(), flat.mean(), *np.quantile(flat, (0.25, 0.75)), share
    np.testing.assert_allclose([float(number) for number in said.groups()], true, atol=0.6)
    assert STORED["development_fingerprint"] == fields_config().sample_fingerprint()


def test_uncertainty_covers_what_it_says_on_own_fields():
    """Over all four ways of seeing them; results and page tell these shares."""
    found = [own["direct"] for own in STORED["own_fields"][GPU].values()]
    covered = [float(np.mean([each[name] for each in found])) for name in ("within_one", "within_two")]
    assert covered == pytest.approx([DIRECT_CALIBRATION.within_one, DIRECT_CALIBRATION.within_two], abs=6e-4)
    assert {len(each["within_one"]) for each in found} == {DIRECT_CALIBRATION.fields}
    text = " ".join(page("docs/learned.md").split())
    assert f"covers {100 * covered[0]:.0f} % of the points and twice of it {100 * covered[1]:.0f} %" in text


def test_uncertainty_covers_what_it_says_on_fields_that_did_not_make_its_factor():
    """Of one, two and three standard uncertainties; errors have longer tails than a normal distribution."""
    (ratios,) = STORED["error_over_spread"]["of"].values()
    covered = [float(np.mean(np.array(ratios) <= k * DIRECT_CALIBRATION.scale)) for k in (1, 2, 3)]
    assert 0.6 <= covered[0] <= 0.8 and covered[1] >= 0.87 and covered[2] >= 0.94, covered
    (said,) = re.findall(
        r"lie (\d+), (\d+) and (\d+) % within one, two and three", " ".join(page("docs/learned.md").split())
    )
    np.testing.assert_allclose([float(share) for share in said], 100 * np.array(covered), atol=0.6)


def test_what_a_gpu_takes_by_default():
    """The table of ``direct`` and ``fibres`` beside it, cell by cell, in docs/learned.md."""
    stored = STORED["by_default"]
    rows = table(page("docs/learned.md"), "| image of the ten plates | `direct`, by default |")
    assert len(rows) == len(stored) - 2  # what it is about, and a camera without a row
    of_rows = [name for name in stored if name not in ("about", "camera")]
    for (_, *cells), name in zip(rows, sorted(of_rows, key=list(ORDER).index), strict=True):
        for method, error, covered in (("direct", *cells[:2]), ("fibres", *cells[2:])):
            if method not in stored[name]:
                assert not error and not covered
                continue
            found = stored[name][method]
            agrees(printed(error), np.array(found["rmse_um"]))
            shares = [100 * np.mean(found[which]) for which in ("within_one", "within_two")]
            assert figures(covered) == [pytest.approx(share, abs=0.5001) for share in shares]


ORDER = (
    "ideal", "apart-0.1", "apart-0.3", "apart-0.5", "blur-0.5", "blur-1", "blur-2", "ellipse", "parabola", "gaussian",
    "quarter", "squashed", "noise-10", "merge",
)  # fmt: skip
"""Of the rows of that table."""


def test_ways_to_be_told():
    """The table is what the stored comparison prints; neither is there without the other."""
    text, path = page("docs/training.md"), ROOT / "benchmarks" / "conditioning.json"
    assert ("| told by | steps |" in text) == path.exists()
    if path.exists():
        assert "\n".join(conditioning.table(json.loads(path.read_text(encoding="utf-8")))) in text


def test_the_paper_s_recipe():
    """Its row, samples, epochs and losses are those of the stored training."""
    stored = json.loads((ROOT / "benchmarks" / "paper_recipe.json").read_text(encoding="utf-8"))
    text = page("docs/learned.md")
    means = np.mean(stored["iterations/full"], axis=0)
    row = " | ".join(f"{value:.0f}" for value in means[1:])
    assert f"| denoiser, gradient, updater | {row} |" in text
    assert f"on {stored['different_samples']:,} different samples" in text
    assert f"({stored['steps']:,} steps of {stored['batch']} in 1,000 s" in text
    assert f"in {stored['loss_above_1']} of {stored['loss_records']} records" in text
    epochs = [f"{epoch['val_rmse_um']:.0f}" for epoch in stored["epochs"]]
    assert f"{', '.join(epochs[:-1])} and {epochs[-1]} um" in text


def test_bench_looked_for_on_a_cpu():
    """Means of docs/found_bench.md over the plates that are stored."""
    stored = json.loads((ROOT / "benchmarks" / "found_bench_cpu.json").read_text(encoding="utf-8"))["rows"]
    rows = table(page("docs/found_bench.md"), "| what differs | plates | known, um | estimate, um |")
    means = {
        (len(row["known"]["rmse_um"]), *(np.mean(row[how][what]) for what in ("rmse_um", "time_s") for how in HOW))
        for row in stored.values()
    }
    assert len(rows) == len(stored)
    for _, plates, *cells in rows:
        near = [
            mean
            for mean in means
            if mean[0] == int(plates)
            and all(
                abs(float(c) - m) <= 0.5001 * 10.0 ** -len(c.partition(".")[2])
                for c, m in zip(cells, mean[1:], strict=True)
            )
        ]
        assert near, cells


def test_lines_on_another_bench():
    """Each plate of the table in docs/found_bench.md is one that is stored, in the same order."""
    stored = json.loads((ROOT / "benchmarks" / "lines_elsewhere.json").read_text(encoding="utf-8"))["plates"]
    rows = table(page("docs/found_bench.md"), "| what differs | flat guess | `direct` | `auto` |")
    assert len(rows) == len(stored)
    for (_, flat, direct, auto, by), plate in zip(rows, stored, strict=True):
        assert (
            flat == f"{plate['flat_um']:.0f} um"
            and by == {"fibres": "lines", "network": "`direct`"}[plate["explained_by"]]
        )
        for cell, name in ((direct, "direct"), (auto, "auto")):
            assert cell == f"{plate[f'{name}_um']:.2f} um, {plate[f'{name}_s']:.0f} s"


HOW = ("known", "estimate")
