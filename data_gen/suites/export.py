"""A suite as files for other programs: 16-bit captures with dark and flat frames, the scene as it is told, the truth.

captures/CASE.tif, CASE_dark.tif, CASE_flat.tif, CASE_capture.yaml    what is measured
scenes/CASE.yaml                                                      what is told, for ``--config``
truth/CASE.npy, CASE.json                                             heights [m], and the bench as it is
suite.json, README.md, SHA256SUMS                                     list of cases, card, checksums
"""

import importlib.metadata
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from data_gen.suites.card import card
from data_gen.suites.case import Case
from data_gen.suites.light import Light
from data_gen.suites.shot import Measured, measured
from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.files import photograph_files, write_photographs
from warp_caustics.camera.operator import Camera
from warp_caustics.camera.photographs import FULL_SCALE, Photographs
from warp_caustics.io.atomic import write_text
from warp_caustics.io.hashes import file_sha256
from warp_caustics.io.heights import write_heights
from warp_caustics.io.json_file import plain, write_json
from warp_caustics.io.regular import read_regular

FOLDERS = ("captures", "scenes", "truth")
CARD, LIST, SUMS = "README.md", "suite.json", "SHA256SUMS"
NAMES = (*FOLDERS, CARD, LIST, SUMS)
"""All that an exported suite holds."""

BLACK = 256
"""Counts without light, in frames of cases that have no camera."""
FLAT_COUNTS = 3000
"""Counts of a flat plate's light on top of it, where the brightest pixel leaves room for so many."""


def export_suite(
    cases: Sequence[Case], folder: Path, light: Light, code: str, report: Callable[[Case], None] = lambda case: None
) -> dict[str, Any]:
    """Write cases; what is there already, made by the same code, is left as it is.

    Args:
        cases: of one suite.
        folder: exists.
        light: simulates.
        code: hash of what made the images, for the card.
        report: called after every case that was written.

    Returns:
        What ``suite.json`` holds.
    """
    for name in FOLDERS:
        (folder / name).mkdir(exist_ok=True)
    for case in cases:
        made = {**case.record(), "n_photons": light.n_photons, "code": code}
        if not _is_written(folder, case, made):
            _write_case(folder, case, measured(case, light))
            # Last: it tells that all others are complete.
            write_json(_truth_record(folder, case), made)
            report(case)
    record = {
        "suite": cases[0].suite,
        "cases": [_listed(case) for case in cases],
        "version": importlib.metadata.version("nsfc"),
        "licence": importlib.metadata.metadata("nsfc").json.get("license_expression"),
        "code": code,
        "n_photons": light.n_photons,
    }
    write_json(folder / LIST, record)
    write_text(folder / CARD, card(cases, record))
    write_text(folder / SUMS, checksums(folder))
    return record


def checksums(folder: Path) -> str:
    """SHA-256 of every file of an export, as ``sha256sum -c`` reads them."""
    files = [path for name in FOLDERS for path in (folder / name).iterdir() if path.is_file()]
    names = sorted(path.relative_to(folder).as_posix() for path in [*files, folder / CARD, folder / LIST])
    return "".join(f"{file_sha256(folder / name)}  {name}\n" for name in names)


def light_as_frames(case: Case, found: Measured) -> Photographs:
    """Irradiance of a case without a camera as counts, beside frames of a camera without noise.

    One count is at most 0.13 % of flat light, unless a pixel is brighter than 85 times as much; masked pixels are at
    full scale.
    """
    level = np.array(case.told.radiosity_W_m2)[:, None, None]
    relative = found.image.irradiance / level
    mask = np.ones(relative.shape, bool) if found.image.mask is None else found.image.mask
    flat_counts = int(min(FLAT_COUNTS, 0.98 * (FULL_SCALE - BLACK) / float(relative[mask].max())))
    photo = np.where(mask, np.rint(BLACK + flat_counts * relative), FULL_SCALE).astype(np.uint16)
    frames: list[npt.NDArray[np.uint16]] = [np.full(photo.shape, BLACK + add, np.uint16) for add in (0, flat_counts)]
    return Photographs(photo, frames[0], frames[1], tuple(map(float, (~mask).mean(axis=(1, 2)))))


def told_config(case: Case) -> str:
    """The scene that methods are told, as a configuration file."""
    tree = {"scene": plain(case.told.record())}
    text: str = yaml.safe_dump(tree, sort_keys=False, default_flow_style=None, width=120)
    return text


def _write_case(folder: Path, case: Case, found: Measured) -> None:
    # Of a case without one, a perfect camera: its frames need no corners and no mixing.
    camera = Camera(case.camera or CameraConfig(), case.told)
    frames = light_as_frames(case, found) if found.frames is None else found.frames
    files = photograph_files(folder / "captures" / f"{case.name}.tif", camera)
    write_photographs(files, frames, camera)
    write_text(folder / "scenes" / f"{case.name}.yaml", told_config(case))
    write_heights(folder / "truth" / f"{case.name}.npy", found.heights_m)


def _truth_record(folder: Path, case: Case) -> Path:
    return folder / "truth" / f"{case.name}.json"


def _is_written(folder: Path, case: Case, made: Mapping[str, Any]) -> bool:
    try:
        return bool(json.loads(read_regular(_truth_record(folder, case))) == plain(made))
    except (OSError, ValueError):
        return False


def _listed(case: Case) -> dict[str, Any]:
    """What a person who solves a suite may know of a case."""
    return {
        "name": case.name,
        "row": case.row,
        "title": case.title,
        "plate": case.plate.number,
        "capture": f"captures/{case.name}.tif",
        "told": f"scenes/{case.name}.yaml",
        "truth": f"truth/{case.name}.npy",
    }
