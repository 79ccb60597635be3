"""Beside a tracer written in Dr.Jit, on this machine: prints a table, writes JSON.

Both make the caustic of ``f_lines`` (``speed.py``), and take turns, call by call; times are medians of whole calls,
errors M as in ``speed.py``. Dr.Jit comes from its wheel into an environment of its own below ``build/``; without the
wheel, or without the LLVM library that it needs on a CPU, this says so in one line and ends well.

    python -m benchmarks.peer [--device cuda] [--rounds 15] [--json FILE]
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.accuracy import CONTACT, DATA, blurred_error, heights_of
from warp_caustics import CausticSimulator

ENVIRONMENT = Path(__file__).parents[1] / "build" / "peer"
WHEEL = "drjit==1.5.*"
TRACER = Path(__file__).with_name("peer_tracer.py")

OURS = (448, 680, 868, 1024)
"""Photons along x of a lattice."""

THEIRS = (("box", 1024), ("box", 2048), ("bilinear", 1024), ("bilinear", 2048))
"""Splat and photons along x."""


class NoPeer(Exception):
    """Dr.Jit cannot be had here; says why."""


def python_of_peer() -> Path:
    """Python of an environment that has Dr.Jit, made at the first use.

    Raises:
        NoPeer: it cannot be installed.
    """
    python = ENVIRONMENT / "bin" / "python"
    if not (ENVIRONMENT / "made").exists():
        venv.create(ENVIRONMENT, with_pip=True, clear=True)
        install = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", WHEEL, "numpy"]
        done = subprocess.run(install, capture_output=True, text=True, check=False)
        if done.returncode:
            raise NoPeer(f"pip cannot install {WHEEL}: {last_line(done.stderr)}")
        (ENVIRONMENT / "made").touch()
    return python


def last_line(text: str) -> str:
    """The last line with something on it."""
    return next((line for line in reversed(text.splitlines()) if line.strip()), "no word why")


def task_of(folder: Path) -> dict[str, Any]:
    """The scene as numbers, its coefficients in a file."""
    simulator = CausticSimulator(CONTACT, n_photons=1, dtype=torch.float64)
    np.save(
        folder / "coefficients.npy", simulator.engine.coefficients(torch.from_numpy(heights_of("f_lines")[None]))[0]
    )
    plate = CONTACT.plate_size_m[0]
    return {
        "coefficients": str(folder / "coefficients.npy"),
        "samples": CONTACT.height_samples,
        "pitch_m": CONTACT.sample_pitch_m[0],
        "plate_m": plate,
        "pixels": CONTACT.image_pixels,
        "channels": CONTACT.n_wavelengths,
        "base_m": CONTACT.base_thickness_m,
        "gap_m": -CONTACT.screen_position_m[2],
        "window_m": [at - plate / 2 for at in CONTACT.screen_position_m[:2]],
        "glass": list(CONTACT.glass_indices),
        "outside": list(CONTACT.exit_indices),
        "radiosity": list(CONTACT.radiosity_W_m2),
    }


class Peer:
    """The other process.

    Raises:
        NoPeer: it cannot be started.
    """

    def __init__(self, task: dict[str, Any], device: str):
        self._errors = tempfile.TemporaryFile(mode="w+")  # noqa: SIM115, closed by close()
        self._process = subprocess.Popen(
            [str(python_of_peer()), str(TRACER)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
        )
        backend = "cuda" if device.startswith("cuda") else "llvm"
        self.version = self.ask({"do": "setup", "task": task, "backend": backend, "threads": torch.get_num_threads()})
        self.ask({"do": "forward", "side": 64, "splat": "box"})

    def ask(self, command: dict[str, Any]) -> Any:
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(command) + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass
        line = self._process.stdout.readline()
        if not line:
            self._process.wait()
            self._errors.seek(0)
            raise NoPeer(f"Dr.Jit does not run here: {last_line(self._errors.read())}")
        return json.loads(line)

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(30)
        self._errors.close()


def ours(side: int, device: str) -> tuple[float, dict[str, Callable[[], float]]]:
    """M, and calls that return their time [ms]."""
    simulator = CausticSimulator(CONTACT, n_photons=side**2, device=device)
    heights = torch.from_numpy(heights_of("f_lines")).float().to(device)
    image = simulator(heights)
    weights = torch.randn_like(image)

    def timed(work: Callable[[], object]) -> float:
        started = time.perf_counter()
        work()
        if device.startswith("cuda"):
            torch.cuda.synchronize()
        return 1e3 * (time.perf_counter() - started)

    def both() -> None:
        leaf = heights.clone().requires_grad_()
        simulator(leaf).backward(weights)

    error = blurred_error(image.cpu().numpy(), np.load(DATA / "f_lines_image.npz")["image"])
    return error, {"forward": lambda: timed(lambda: simulator(heights)), "both": lambda: timed(both)}


def theirs(peer: Peer, splat: str, side: int, folder: Path) -> tuple[float, dict[str, Callable[[], float]]]:
    """The same of the peer; photons into one pixel have no gradient."""
    peer.ask({"do": "image", "side": side, "splat": splat, "to": str(folder / "image.npy")})
    error = blurred_error(np.load(folder / "image.npy"), np.load(DATA / "f_lines_image.npz")["image"])
    kinds = ("forward", "both") if splat == "bilinear" else ("forward",)
    return error, {kind: lambda kind=kind: peer.ask({"do": kind, "side": side, "splat": splat}) for kind in kinds}  # type: ignore[misc]


def in_turns(rows: list[dict[str, Any]], rounds: int) -> None:
    """Time every call once a round, after two that do not count; medians [ms] go into the rows."""
    calls = [(row, kind, call) for row in rows for kind, call in row.pop("calls").items()]
    times: list[list[float]] = [[] for _ in calls]
    for turn in range(rounds + 2):
        for found, (_, _, call) in zip(times, calls, strict=True):
            elapsed = call()
            if turn >= 2:
                found.append(elapsed)
    for found, (row, kind, _) in zip(times, calls, strict=True):
        row[kind] = {"median_ms": statistics.median(found), "low_ms": min(found)}


def measured(device: str, rounds: int) -> list[dict[str, Any]]:
    """One row for each of ours and theirs.

    Raises:
        NoPeer: there is nobody to compare with.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        peer = Peer(task_of(folder), device)
        rows: list[dict[str, Any]] = []
        for splat, side in THEIRS:
            error, calls = theirs(peer, splat, side, folder)
            rows.append({"who": f"Dr.Jit {peer.version}, {splat}", "n_photons": side**2, "M": error, "calls": calls})
        for side in OURS:
            error, calls = ours(side, device)
            rows.append({"who": "lattice", "n_photons": side**2, "M": error, "calls": calls})
        in_turns(rows, rounds)
        peer.close()
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--json", type=Path, help="where to write all figures")
    arguments = parser.parse_args()
    try:
        rows = measured(arguments.device, arguments.rounds)
    except NoPeer as reason:
        print(f"skipped: {reason}")
        sys.exit(0)
    on_gpu = arguments.device.startswith("cuda")
    name = torch.cuda.get_device_name() if on_gpu else f"CPU, {torch.get_num_threads()} threads"
    print(name)
    print(f"{'':<24} {'photons':>9} {'M %':>7} {'image ms':>10} {'image and gradient ms':>22}")
    for row in rows:
        image, both = (f"{row[kind]['median_ms']:.2f}" if kind in row else "" for kind in ("forward", "both"))
        print(f"{row['who']:<24} {row['n_photons']:>9} {100 * row['M']:>7.3f} {image:>10} {both:>22}", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps({"device": name, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
