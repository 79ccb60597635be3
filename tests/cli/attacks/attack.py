"""One attack: a place with something in it, and a command that is told to write there."""

import hashlib
import json
import os

import numpy as np

from cli.design import DESIGN_FILES
from cli.inspection.files import INSPECTION, INSPECTION_FILES
from cli.main import main
from cli.output import ResultKind, check_target, result_folder
from cli.results import ALL_FILES, RECONSTRUCTION
from cli.testset import testset_kind as fields_kind

CONFIG = ("--config", "small", "--device", "cpu")
RUN = (
    "config.resolved.yaml", "metrics.csv", "weights.safetensors", "checkpoints/model.pt", "checkpoints/last.ckpt",
    "pictures/holiday.png", "tensorboard/notes.txt", ".lock",
)  # fmt: skip
SEARCH = ("search.yaml", "study.db", "best.yaml", "network.yaml", "trials.csv", "report.html", ".claims.lock")
COMPARISON = ("index.html", "table.csv", "table.json", "summary.csv", "cells/a.json", "images/a.npz")
STORE = ("config.json", "index.h5", "COMPLETE.json", "shards/00000.h5", "thesis.tex")


class Commands:
    """How each command is told to write to a path, with inputs that are right."""

    def __init__(self, folder):
        self.image, self.heights, self.lines = folder / "image.tif", folder / "heights.npy", folder / "lines.csv"
        self.picture = folder / "picture.npy"
        np.save(self.picture, np.eye(16))
        self.lines.write_text("start_x_mm,start_y_mm,end_x_mm,end_y_mm,width_mm,height_um\n-12,-10,12,8,6,300\n")

    def line(self, name, out):
        second = self.image.with_name("second.tif")
        check = ("--nominal", self.lines, "--tolerance", "50um")
        lines = {
            "reconstruct": ("reconstruct", self.image, "-o", out, *CONFIG),
            "batch": ("reconstruct", self.image, second, "-o", out, *CONFIG),
            "inspect": ("inspect", self.image, "-o", out, *check, *CONFIG),
            "series": ("inspect", self.image, second, "-o", out, *check, *CONFIG),
            "design": ("design", self.picture, "-o", out, "--max-time", "1e-6", *CONFIG),
            "testset": ("data", "testset", out, "--fields", "1", *CONFIG),
            "train": ("train", "direct", "--fresh", "-o", out, "--max-steps", "1", "--device", "cpu"),
            "search": ("search", "denoiser", "--fresh", "-o", out, "--n-trials", "1", "--device", "cpu"),
            "compare": ("compare", self.heights, "--methods", "flat", "-o", out, *CONFIG),
            "build": ("data", "build", "updater", out, "--n", "3", *CONFIG),
            "simulate": ("simulate", self.heights, "-o", out, *CONFIG),
            "capture": ("capture", self.image, "-o", out, "--config", "small"),
        }
        return [str(part) for part in lines[name]]


FOLDERS = {
    "reconstruct": ALL_FILES,
    "batch": ("summary.csv", "image/height.npy", "image/report.html", "second/result.json"),
    "inspect": INSPECTION_FILES,
    "series": ("plates.csv", "trend.png", "image/inspection.json", "image/height.npy", "image/report.html"),
    "design": DESIGN_FILES,
    "testset": fields_kind().files[:3],
    "train": RUN,
    "search": SEARCH,
    "compare": COMPARISON,
    "build": STORE,
}
NO_FORCE = ("build", "search", "compare", "simulate", "capture")
FILES = {"simulate": "caustic.tif", "capture": "irradiance.tif"}


def tree(folder):
    """Everything below a folder: kind and content by path."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = ("link", os.readlink(path))
        elif path.is_file():
            found[name] = ("file", hashlib.sha256(path.read_bytes()).hexdigest(), path.stat().st_ino)
        else:
            found[name] = ("folder",) if path.is_dir() else ("other",)
    return found


def attack(tmp_path, commands, name, out, force):
    """Run a command; returns its exit code, after all that was there was found again."""
    before = tree(tmp_path)
    code = main([*commands.line(name, out), *(["--force"] if force else [])])
    after = tree(tmp_path)
    lost = {path: entry for path, entry in before.items() if after.get(path) != entry}
    assert not lost, f"{name}, --force {force}: {lost}"
    assert code not in (0, 1), (name, code)
    hidden = [path for path in after if path not in before and os.path.basename(path).startswith(".nsfc-")]
    assert not hidden, hidden
    return code


def put(path, kind, tmp_path):
    """Something of somebody else in the place of a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    victim = tmp_path / "victim.txt"
    victim.write_text("years of work")
    if kind == "file":
        path.write_text("years of work")
    elif kind == "json":
        path.write_text(json.dumps({"method": "mine", "residual": 1, "kind": "run"}))
    elif kind == "folder":
        path.mkdir()
        (path / "thesis.tex").write_text("years of work")
    elif kind == "link":
        path.symlink_to(victim)
    elif kind == "pipe":
        os.mkfifo(path)
    return path


KINDS = ("file", "json", "folder", "link", "pipe")


def genuine(out, kind):
    """A result as this program leaves it."""
    check_target(out, True, kind)
    with result_folder(out, True, kind) as folder:
        for name in kind.files:
            (folder / name).write_text(f"result {name}")
    return out


KINDS_OF_RESULTS = (RECONSTRUCTION, INSPECTION, ResultKind("design", DESIGN_FILES), fields_kind())
