"""A training run of seconds on a CPU."""

import warnings
from pathlib import Path

import pytest
import yaml

import nets.training.fit as fit_module
from nets.training.config import RunConfig, default_run
from nets.training.fit import fit
from nets.training.limits import Limits
from nets.training.progress import TrainingProgress
from tests.upright import upright_only

__all__ = ["upright_only"]

BACKBONE = {"widths": [8, 16], "depths": [1, 1], "attention_levels": [], "head_channels": 16}
TAB_2 = {"c_init": 4, "k_down": 3, "k_up": 2, "m_s": 2, "n_s": 2}
FAMILY = yaml.safe_load((Path(__file__).parents[3] / "configs" / "family.yaml").read_text())
PHOTONS = {"preset": "lattice", "n_photons": 64**2}


class Watcher:
    def __init__(self):
        self.seen: list[TrainingProgress] = []
        self.warnings: list[str] = []
        self.notes: list[str] = []
        self.stages: list[tuple[str, int, int]] = []
        self.ticks: list[tuple[int, float | None, float | None]] = []

    def stage(self, what, done, total):
        self.stages.append((what, done, total))

    def tick(self, step, share, left_s):
        self.ticks.append((step, share, left_s))

    def show(self, progress):
        self.seen.append(progress)

    def note(self, text):
        self.notes.append(text)

    def warn(self, text):
        self.warnings.append(text)


def _tiny_run(kind, *, network=None, data=None, **training):
    """A run of 16 heights and 64 pixels; keywords change ``training``."""
    tree = default_run(kind)
    tree["scene"] |= {"height_samples": 16, "image_pixels": 64}
    tree["data"] = data
    if kind in ("direct", "unrolled"):
        tree["network"]["backbone"] = BACKBONE
        if kind == "unrolled":
            tree["network"] |= {"hidden_channels": 2, "numbered_steps": 2}
    else:
        numbers = TAB_2 if kind == "denoiser" else {**TAB_2, "c_init": None}
        tree["network"]["network"] |= numbers
    tree["network"] |= network or {}
    tree["training"] |= {
        "batch_size": 4,
        "precision": "32",
        "total_steps": 12,
        "steps_per_epoch": 4,
        "log_every_steps": 2,
        "warmup_steps": 0,
        "photons": [{"photons_per_pixel": 1.0}],
        "noisy": {"preset": "paper", "n_photons": 500} if kind == "denoiser" else PHOTONS,
        "clean": PHOTONS,
        "validation": {"count": 4},
        **training,
    }
    return RunConfig.model_validate(tree)


@pytest.fixture
def tiny_run():
    return _tiny_run


@pytest.fixture
def told_run(tiny_run):
    """A tiny run on the family's benches."""

    def make(**training):
        plain = tiny_run("direct")
        tree = plain.model_dump(mode="json")
        tree["network"]["backbone"] |= FAMILY["network"]["backbone"]
        tree["training"] |= FAMILY["training"]
        for name, value in training.items():
            known = tree["training"].get(name)
            tree["training"][name] = known | value if isinstance(known, dict) and isinstance(value, dict) else value
        return RunConfig.model_validate(tree)

    return make


@pytest.fixture
def watcher():
    return Watcher()


@pytest.fixture(scope="session")
def fabric():
    from nets.training.devices import launched

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return launched("cpu", 1)


@pytest.fixture
def train(fabric, monkeypatch):
    """Trains in a folder; pictures are left out unless asked for."""

    def call(
        config, folder, *, max_steps=None, deadline=None, max_time_s=None, resume=False, pictures=False, watcher=None
    ):
        folder.mkdir(exist_ok=True)
        if not pictures:
            monkeypatch.setattr(fit_module, "write_sample", lambda *arguments: None)
        limits = Limits(max_steps, deadline, max_time_s)
        return fit(config, folder, fabric, watcher or Watcher(), limits, resume=resume)

    # TensorBoard's files are tested where they matter.
    monkeypatch.setattr("nets.training.record.RunRecord._tensorboard", lambda *arguments: None)
    return call
