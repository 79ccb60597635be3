"""A bench as a file: what was found of scene and camera, how sure it is, and from what.

nsfc_bench: 1
scene: {gap and all that a scene has but for the samples of a relief}
camera: {as nsfc simulate --camera takes it}
parameters: [{name: gap_m, unit: m, value: 0.00104, sigma: 3.0e-06, before: 0.001, prior: 5.0e-05, verdict: found}, ...]
covariance: [[...], ...]
provenance: {...}
"""

import os
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import pydantic
import yaml
from pydantic import Field, model_validator

from warp_caustics.camera.config import CameraConfig
from warp_caustics.errors import InputError
from warp_caustics.io.atomic import PathLike, regular_file, write_text
from warp_caustics.io.yaml_file import read_yaml
from warp_caustics.scene import Scene, validation_lines
from warp_caustics.strict import Finite, Strict

VERSION = 1
PER_RELIEF = ("height_samples",)
"""Fields of a scene that are the relief's, not the bench's."""
EXAMPLE = "nsfc_bench: 1"


class BenchParameter(Strict):
    """One number of the bench, in SI units and pixels of the capture."""

    name: str
    unit: str
    value: Finite
    sigma: Annotated[Finite, Field(ge=0)]
    """Standard deviation."""
    before: Finite
    """What was believed before."""
    prior: Annotated[Finite, Field(gt=0)]
    """Standard deviation of that."""
    verdict: Literal["found", "not told", "at its bound"]


class Bench(Strict):
    """A bench that was calibrated."""

    nsfc_bench: Literal[1]
    """Version of this format."""
    scene: dict[str, Any]
    """Fields of a scene without those of the relief."""
    camera: CameraConfig
    """As it shows the window."""
    parameters: tuple[BenchParameter, ...] = ()
    """What was looked for."""
    covariance: tuple[tuple[Finite, ...], ...] = ()
    """Of their errors, in their order and units."""
    provenance: dict[str, Any] = Field(default_factory=dict)
    """Captures, versions and time."""

    @model_validator(mode="after")
    def _consistent(self) -> "Bench":
        count = len(self.parameters)
        if len(self.covariance) != count or any(len(row) != count for row in self.covariance):
            raise ValueError(f"covariance is not {count} x {count}, one row for each of the parameters; write it anew")
        held = [name for name in PER_RELIEF if name in self.scene]
        if held:
            raise ValueError(f"scene holds {held[0]}, which is a relief's; leave it out")
        self.whole_scene()
        return self

    def whole_scene(self, height_samples: int = 128) -> Scene:
        """The scene, for reliefs of n samples.

        Raises:
            pydantic.ValidationError: fields that make no scene.
        """
        return Scene.model_validate({**self.scene, "height_samples": height_samples})

    def priors(self) -> dict[str, float]:
        """What is not known of each parameter, standard deviations, for whoever goes on from here."""
        return {p.name: p.sigma for p in self.parameters if p.sigma > 0}


def scene_tree(scene: Scene) -> dict[str, Any]:
    """What of a scene is the bench's."""
    return scene.model_dump(mode="json", exclude=set(PER_RELIEF))


def read_bench(path: str | os.PathLike[str]) -> Bench:
    """Read a bench.

    Raises:
        InputError: unreadable, no bench, or values out of range.
    """
    file = regular_file(path)
    tree = read_yaml(file, EXAMPLE)
    if "nsfc_bench" not in tree:
        raise InputError(f"{str(file)!r} is no bench of nsfc calibrate: it has no nsfc_bench; give its bench.yaml")
    try:
        return Bench.model_validate(tree)
    except pydantic.ValidationError as error:
        raise InputError("; ".join(validation_lines(error, str(file))[:3])) from error


def write_bench(path: PathLike, bench: Bench) -> None:
    """Write a bench, complete or not at all; :func:`read_bench` gives it back."""
    tree: Mapping[str, Any] = bench.model_dump(mode="json")
    text = "# Found by nsfc calibrate; every command that takes a scene takes this file with --bench.\n"
    text += yaml.safe_dump(dict(tree), sort_keys=False, default_flow_style=None, width=120)
    write_text(path, text)
