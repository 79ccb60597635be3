"""The benchmark of coverage and warnings: what counts as wrong, flagged and covered."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import trusted
from benchmarks.trusted import constants, is_result_wrong, plates, spread_alone, summary
from nets.reconstruct.with_bench import with_bench
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.scene import Scene


def row(name, rmse, sigma, flagged, causes=()):
    covered = [0.6, 0.9]
    return {
        "row": name, "plate": 0, "rmse_um": rmse, "uncertainty_um": sigma, "alone_um": sigma / 2,
        "within": covered, "within_relief": covered, "alone_within": [0.4, 0.7], "alone_within_relief": [None, None],
        "ratio": 1.0, "causes": list(causes), "is_flagged": flagged,
    }  # fmt: skip


def test_the_spread_alone_is_what_was_before_the_bench_and_its_base():
    scene, x = Scene(height_samples=32, image_pixels=64), np.linspace(-1, 1, 32)
    found = Reconstruction(
        "direct", 4e-4 * np.exp(-4 * (x[:, None] ** 2 + x**2)), np.zeros((3, 64, 64)), 0.1, "converged",
        uncertainty_m=np.full((32, 32), 1e-6), counters={"rest": {"of_contrast": 0.0, "ratio": 0.5, "causes": []}},
        settings={"network": {"file": "direct.safetensors"}},
    )  # fmt: skip
    whole = with_bench(found, BenchNumbers.of(scene))
    assert whole.uncertainty_m.max() > 2e-6
    np.testing.assert_allclose(spread_alone(whole, scene), 1e-6, rtol=1e-6)


def test_a_process_measures_the_plate_it_is_given(monkeypatch):
    """Of a row and a number, by the method that it began with."""
    scene, heights = Scene(), np.full((128, 128), 1e-4)
    counters = {
        "rest": {"of_contrast": 0.0, "ratio": 0.5, "causes": []},
        "doubt": {"is_doubtful": False, "times": 1.0},
        "uncertainty": {"numbers": {}, "care": {"times": 1.0}},
    }
    settings = {"network": {"file": "direct.safetensors"}}

    class Method:
        def reconstruct(self, image):
            return Reconstruction(
                "direct", heights, image, 0.1, "converged", uncertainty_m=heights / 50, counters=counters,
                settings=settings,
            )  # fmt: skip

    asked = []
    monkeypatch.setattr(trusted, "create", lambda name, told, device: asked.append((name, told, device)) or Method())
    monkeypatch.setattr(trusted, "plate", lambda *what: asked.append(what) or (np.zeros((3, 8, 8)), heights + 3e-6))
    trusted.begin("auto", 7, "cpu")
    found = trusted.work(("careful", 3))
    assert asked == [("auto", scene, "cpu"), ("careful", 3, 7, "cpu")]
    assert (found["row"], found["plate"], found["within"]) == ("careful", 3, [0.0, 1.0])
    assert found["rmse_um"] == pytest.approx(3) and found["uncertainty_um"] == pytest.approx(2)
    assert found["seconds"] >= 0


def test_wrong_is_three_times_what_is_stated():
    assert is_result_wrong(row("a", 31, 10, False)) and not is_result_wrong(row("a", 29, 10, False))
    assert is_result_wrong(row("a", 29, 10, False), "alone_um")


def test_the_summary_counts_wrong_and_good_ones_apart():
    rows = [row("a", 40, 10, True, [["ambient", 0.02, 0.004]]), row("a", 5, 10, False), row("b", 40, 10, False)]
    lines = summary([*rows, row("b", 5, 10, True)])
    assert "wrong by all: 1 of 2 flagged; good: 1 of 2 flagged" in lines
    assert any(line.startswith("a ") and "ambient 1" in line for line in lines)
    assert any("0.60/0.90" in line for line in lines)


STORED = json.loads(Path("benchmarks/trusted.json").read_text())


def test_stored_coverage_is_of_the_constants_that_ship():
    """A factor, floor or share of another size has to be measured, and told on the page."""
    assert {file: pytest.approx(values) for file, values in STORED["constants"].items()} == constants()
    text = " ".join(Path("docs/trust.md").read_text().split())
    pattern = r"k = ([\d.]+), c = ([\d.]+) for the scene's own network, ([\d.]+), ([\d.]+) and a floor f of ([\d.]+) um"
    own, told = constants().values()
    wanted = own["scale"], own["shared"], told["scale"], told["shared"], told["floor_um"]
    assert [float(value) for value in re.search(pattern, text).groups()] == pytest.approx(wanted)


@pytest.mark.parametrize("network", ["direct.safetensors", "direct-family.safetensors"])
def test_benches_told_nearly_are_covered_on_relief(network):
    """Plates that the constants were not fitted to: 68 and 95 % of a normal distribution, within what few plates tell."""
    rows = [row for row in STORED["rows"] if row["row"] in ("nothing", "careful") and row["network"] == network]
    covered = np.mean([row["within_relief"] for row in rows], axis=0)
    assert len(rows) >= 2 and 0.6 < covered[0] < 0.95 and covered[1] > 0.9, covered


def test_the_page_says_what_the_detector_is_worth():
    """Of results that are wrong and of good ones, and how many are flagged; the rows of its table."""
    rows, text = STORED["rows"], Path("docs/trust.md").read_text().split("## What that is worth")[1]
    said = re.search(
        r"(\d+) results, (\d+) are wrong, (\d+) of them flagged; of the (\d+) others (\d+)", " ".join(text.split())
    )
    wrong, good = ([row for row in rows if is_result_wrong(row) == is_so] for is_so in (True, False))
    flagged = [sum(row["is_flagged"] for row in each) for each in (wrong, good)]
    assert [int(number) for number in said.groups()] == [len(rows), len(wrong), flagged[0], len(good), flagged[1]]
    table = [[cell.strip() for cell in line.split("|")] for line in text.splitlines() if line.startswith("| `")]
    assert {cells[1].strip("`") for cells in table} == {row["row"] for row in rows}
    for _, name, plates_of, errors, _, within, kept, worse, found, *_ in table:
        own = [row for row in rows if row["row"] == name.strip("`")]
        assert [int(plates_of), int(worse), int(found)] == [
            len(own), sum(map(is_result_wrong, own)), sum(row["is_flagged"] for row in own)
        ]  # fmt: skip
        assert int(kept) == sum(bool(row["is_kept"]) for row in own)
        means = [np.mean([row[key] for row in own]) for key in ("rmse_um", "uncertainty_um")]
        assert [float(value) for value in errors.split(", ")] == [pytest.approx(mean, abs=0.501) for mean in means]
        covered = 100 * np.mean([row["within_relief"] for row in own], axis=0)
        assert [float(value) for value in re.findall(r"\d+", within)] == pytest.approx(covered, abs=0.501)


ON_GPU = json.loads(Path("benchmarks/trusted_h200.json").read_text())


def test_the_page_says_what_a_gpus_results_are_worth():
    """Its constants are those that ship; the rows of its table are those of the file."""
    assert {file: pytest.approx(values) for file, values in ON_GPU["constants"].items()} == constants()
    text = Path("docs/trust.md").read_text()
    found = re.findall(
        r"\| (\w+), H200 \| (\d+) \| (\d+), (\d+) \| (\d+), (\d+) % \| (\d+), (\d+) % \| ([\d.]+) \| (\d+) \| (\d+) \|",
        text,
    )
    assert {name for name, *_ in found} == {row["row"] for row in ON_GPU["rows"]}
    for name, *cells in found:
        own = [row for row in ON_GPU["rows"] if row["row"] == name]
        means = [np.mean([row[key] for row in own]) for key in ("rmse_um", "uncertainty_um")]
        shares = [100 * np.mean([row[key] for row in own], axis=0) for key in ("within_relief", "without_bow")]
        care = np.median([row["care"] for row in own])
        counts = [sum(map(is_result_wrong, own)), sum(row["is_flagged"] for row in own)]
        assert [float(cell) for cell in cells] == pytest.approx(
            [len(own), *means, *shares[0], *shares[1], care, *counts], abs=0.501
        )


def test_the_page_counts_the_wrong_ones_of_another_gpu():
    """Benches, and how many results were wrong and flagged."""
    rows = json.loads(Path("benchmarks/trusted_h100.json").read_text())["rows"]
    text = " ".join(Path("docs/trust.md").read_text().split("plates more on an H100")[1].split())
    wrong, good = ([row for row in rows if is_result_wrong(row) == is_so] for is_so in (True, False))
    flagged = [sum(row["is_flagged"] for row in each) for each in (wrong, good)]
    said = re.search(
        r"Of these (\d+) results (\d+) (?:is|are) wrong, (\d+) of them flagged; of the (\d+) others (\d+) is", text
    )
    assert [int(n) for n in said.groups()] == [len(rows), len(wrong), flagged[0], len(good), flagged[1]]
    for name, error in re.findall(r"(careful|ordinary|poor),? ([\d.]+)(?=,| um)", text.split("Of these")[0]):
        assert float(error) == pytest.approx(np.mean([r["rmse_um"] for r in rows if r["row"] == name]), abs=0.051)


@pytest.mark.slow
def test_its_plates_are_of_its_seed():
    one, same, other = (next(plates("nothing", 1, seed, "cpu"))[1] for seed in (5, 5, 6))
    assert np.array_equal(one, same) and not np.array_equal(one, other)
