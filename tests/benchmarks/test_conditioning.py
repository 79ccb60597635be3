"""Ways to be told, compared: which trainings they are, who judges them, and what is made of their figures."""

import json
import time
from types import SimpleNamespace

import pytest
import torch

from benchmarks import conditioning
from benchmarks.conditioning import LOOKS, Options, judged, run_of, table, time_left, trained, versus
from nets.training.config import RunConfig

TINY = Options(None, 2, 4, 8, 2, 3, 1e-3, False, None)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Runs of 16 heights and 64 pixels."""
    whole = run_of

    def small_run(variant, options):
        tree = whole(variant, options).model_dump(mode="json")
        tree["scene"] |= {"height_samples": 16, "image_pixels": 64}
        tree["network"]["backbone"] |= {"widths": [8, 8], "depths": [1, 1], "attention_levels": []}
        return RunConfig.model_validate(tree)

    monkeypatch.setattr(conditioning, "run_of", small_run)


def test_variants_differ_in_how_they_are_told_and_in_nothing_else():
    plain = {variant: run_of(variant, TINY) for variant in conditioning.VARIANTS}
    assert [run.network.told_by for run in plain.values()] == ["film", "maps", "picture", "picture"]
    assert not any(run.network.feedback for run in plain.values())
    trainings = [run.training for run in plain.values()]
    assert trainings[0] == trainings[1] == trainings[2]
    assert trainings[3].told.nothing_share == 1.0
    assert trainings[3].model_copy(update={"told": trainings[0].told}) == trainings[0]
    assert conditioning.JUDGED_SEED not in (trainings[0].seed, trainings[0].validation.seed)


def test_from_training_to_the_table(tmp_path, monkeypatch, capsys):
    def one_after_another(variants, options, devices, at_once, until=None):
        for variant in variants:
            conditioning.work(variant, options, devices[0], tmp_path / f"{variant}.json")
        return {variant: json.loads((tmp_path / f"{variant}.json").read_text()) for variant in variants}

    monkeypatch.setattr(conditioning, "together", one_after_another)
    monkeypatch.setattr("nets.weights.weights_info", lambda path: pytest.fail("no weights were given"))
    monkeypatch.setattr(conditioning, "Options", lambda *values: Options(*values)._replace(weights=None))
    path = tmp_path / "found.json"
    sizes = ["--steps", "2", "--batch", "4", "--pool", "8", "--fresh", "2", "--benches", "3"]
    conditioning.main([*sizes, "--variants", "film", "maps", "--json", str(path)])
    printed, stored = capsys.readouterr().out, json.loads(path.read_text())
    assert list(stored["variants"]) == ["start", "film", "maps"]
    assert [row["steps"] for row in stored["variants"].values()] == [0, 2, 2]
    for row in stored["variants"].values():
        assert {look: len(errors) for look, errors in row["rmse_um"].items()} == dict.fromkeys(LOOKS, 3)
    assert printed.endswith("\n".join(table(stored)) + "\n")
    conditioning.main(["--read", str(path)])
    assert capsys.readouterr().out == "\n".join(table(stored)) + "\n"


def test_all_are_judged_by_the_same_whatever_they_were_told():
    """A network that answers with a flat plate: its errors are the plates'."""
    found = []
    for variant in ("film", "nothing"):
        config = conditioning.run_of(variant, TINY)
        network, _ = trained("start", config, "cpu")
        found.append(judged(network, config, 3, torch.device("cpu")))
    assert found[0] == found[1]
    first = found[0]["told"]
    assert all(errors == first for errors in found[0].values()) and min(first) > 1


def test_times_of_trainings():
    assert time_left(300, 40, 40, 240) == pytest.approx(180)
    assert time_left(600, 40, 40, 240) == 240
    with pytest.raises(SystemExit, match="10 s are left for each training, the least is 20; raise --within"):
        time_left(130, 40, 40, 240)


def test_differences_are_those_of_the_same_benches():
    errors = {look: [10.0, 20.0, 60.0] for look in LOOKS}
    rows = {
        "start": {"steps": 0, "rmse_um": errors},
        "film": {"steps": 5, "rmse_um": errors},
        "maps": {"steps": 6, "rmse_um": {look: [12.0, 21.0, 63.0] for look in LOOKS}},
    }
    assert versus(rows["maps"], rows["film"], "told") == (pytest.approx(2.0), pytest.approx(1 / 3**0.5))
    lines = table({"variants": rows})
    assert len({line.count("|") for line in lines}) == 1 and lines[3].startswith("| film | 5 | 30.0 |")
    assert lines[-1].startswith("| maps less film | | +2.0 +- 0.6 |")


@pytest.fixture
def processes(monkeypatch):
    """Stand-ins: ``film`` is done at once, ``maps`` fails, ``picture`` never ends."""

    class Process:
        def __init__(self, target, args):
            self.variant, self.file, self.exitcode = args[0], args[3], None

        def start(self):
            if self.variant == "film":
                self.file.write_text('{"steps": 1}')
            if self.variant != "picture":
                self.exitcode = 0 if self.variant == "film" else 1

        def kill(self):
            self.exitcode = self.exitcode if self.exitcode is not None else -9

        def is_alive(self):
            return self.exitcode is None

        def join(self):
            assert self.exitcode is not None

    monkeypatch.setattr(conditioning.multiprocessing, "get_context", lambda kind: SimpleNamespace(Process=Process))


def test_a_variant_that_fails_is_left_out(processes, capsys):
    assert conditioning.together(["film", "maps"], TINY, ["cpu"], 1) == {"film": {"steps": 1}}
    assert "maps: ended with 1, and has no figures" in capsys.readouterr().out


def test_what_takes_too_long_is_ended_and_the_others_are_kept(processes, capsys):
    found = conditioning.together(["picture", "film", "nothing"], TINY, ["cpu"], 2, time.monotonic() + 0.3)
    assert found == {"film": {"steps": 1}}
    assert "picture: ended with -9" in capsys.readouterr().out
