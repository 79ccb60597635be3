"""Captures of known plates as a person lists them: on the command line, or in a file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pydantic
from pydantic import Field

from cli.options import named_number
from warp_caustics.calibration.plate_file import read_plate
from warp_caustics.calibration.plates import FLAT, KnownPlate
from warp_caustics.capture.settings import CaptureSettings, capture_files, capture_settings
from warp_caustics.errors import InputError
from warp_caustics.io.yaml_file import read_yaml
from warp_caustics.scene import validation_lines
from warp_caustics.strict import Finite, Strict

EXAMPLE = "captures: [{image: lens.tif, plate: lens.yaml, dark: dark.tif, flat: flat.tif}]"


class ListedShot(Strict):
    """One entry of a list of captures; paths are relative to the list."""

    image: str
    plate: str
    """flat, or a file."""
    capture: str | None = None
    """Capture file with all that follows."""
    dark: str | None = None
    flat: str | None = None
    corners: str | None = None
    tolerances: dict[str, Finite] = Field(default_factory=dict)
    """Standard deviations of the plate's numbers."""


class ShotList(Strict):
    """A list of captures."""

    captures: tuple[ListedShot, ...] = Field(min_length=1)


@dataclass(frozen=True, eq=False)
class Shot:
    """A capture with its plate.

    Attributes:
        name: of the image without its suffix.
        image: path.
        plate: as it was given.
        settings: how to read it.
        tolerances: of the plate's numbers.
    """

    name: str
    image: str
    plate: str
    settings: CaptureSettings
    tolerances: Mapping[str, float] = field(default_factory=dict)

    @property
    def files(self) -> dict[str, str]:
        """Every file that is read, by its role."""
        found = capture_files(self.image, self.settings)
        return found if self.plate == FLAT else found | {"plate": self.plate}

    def known_plate(self) -> KnownPlate:
        """The plate."""
        return read_plate(self.plate, self.tolerances)


def given_shots(
    images: Sequence[str], plates: Sequence[str], tolerances: Mapping[str, float], capture: Mapping[str, Any]
) -> list[Shot]:
    """Captures of the command line; a single .yaml with ``captures`` is a list of them.

    Raises:
        InputError: another number of plates than of captures, or a list that is none.
    """
    listed = _listed(images[0]) if len(images) == 1 else None
    if listed is not None:
        if plates or capture or tolerances:
            raise InputError(
                f"{images[0]!r} lists captures with their plates and frames; leave other options for them out"
            )
        return _named([_of_list(entry, Path(images[0]).parent) for entry in listed.captures])
    if len(plates) != len(images):
        raise InputError(
            f"{len(plates)} plates for {len(images)} captures; give --plate once for each, in their order: "
            f"flat, or a file"
        )
    shots = []
    for image, plate in zip(images, plates, strict=True):
        options = dict(capture)
        if plate == FLAT:
            # What is divided by a flat frame tells nothing of a flat plate.
            options["flat"] = options["flat_dark"] = None
        settings = capture_settings(options, image)
        if plate == FLAT:
            settings = settings.model_copy(update={"flat": None, "flat_dark": None})
        shots.append(Shot(Path(image).stem, image, plate, settings, {} if plate == FLAT else tolerances))
    return _named(shots)


def _named(shots: list[Shot]) -> list[Shot]:
    """Each with a name of its own."""
    names = [shot.name for shot in shots]
    return [
        shot
        if names.count(shot.name) == 1
        else Shot(f"{shot.name}-{k}", shot.image, shot.plate, shot.settings, shot.tolerances)
        for k, shot in enumerate(shots, 1)
    ]


def _listed(path: str) -> ShotList | None:
    if Path(path).suffix.lower() not in (".yaml", ".yml"):
        return None
    tree = read_yaml(Path(path), EXAMPLE)
    if "captures" not in tree:
        return None
    try:
        return ShotList.model_validate(tree)
    except pydantic.ValidationError as error:
        raise InputError("; ".join(validation_lines(error, path)[:3])) from error


def _of_list(entry: ListedShot, folder: Path) -> Shot:
    options = {
        name: str(folder / value) for name in ("capture", "dark", "flat") if (value := getattr(entry, name)) is not None
    }
    if entry.corners is not None:
        options["corners"] = entry.corners if entry.corners == "auto" else str(folder / entry.corners)
    image = str(folder / entry.image)
    settings = capture_settings(options, image)
    if entry.plate == FLAT:
        settings = settings.model_copy(update={"flat": None, "flat_dark": None})
    plate = entry.plate if entry.plate == FLAT else str(folder / entry.plate)
    return Shot(Path(image).stem, image, plate, settings, entry.tolerances)


def named_numbers(given: Sequence[str], option: str) -> dict[str, float]:
    """NAME=NUMBER options as a mapping; of one name, the last."""
    return dict(named_number(text, option) for text in given)
