"""May a network be used for another scene than that it was trained for?

Exactly equal scenes are the rule. A scene whose images hardly differ (glass
instead of air in a gap of 1 um) is accepted too, because image noise changes
more; how much they differ is measured, by simulating printed reliefs in both.
"""

import json
import shlex
from collections.abc import Mapping
from functools import lru_cache

import torch

from data_gen.dataset_config import DatasetConfig
from data_gen.samples import Reliefs
from nets.seen_scene import SeenScene, in_own_lengths
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator

NEGLIGIBLE_DIFFERENCE = 1e-3
"""Relative difference of images between two scenes that is not worth a word: a tenth of a good camera's noise."""
MAX_IMAGE_DIFFERENCE = 0.01
"""Relative image difference ||a - b|| / ||b|| up to which scenes count as one: the noise of a good camera.
Measured on Tab. 3 reliefs: 0.001 for glass between plate and screen, 0.023 for the screen at 10 um, 0.016 for a
base 10 um thicker, 0.04 for a refractive index 0.3 % off."""

SHAPE_FIELDS = ("height_samples", "image_pixels", "plate_size_m", "wavelengths_m")
"""What must be equal: a network's input and output, and what a height of 1 mm means in pixels."""

_RELIEFS = 2
_SEED = 90_125


def working_scene(scene: Scene, trained: Scene) -> Scene:
    """The measured scene in the brightness that a network was trained with."""
    return scene.model_copy(update={"radiosity_W_m2": trained.radiosity_W_m2})


def differences(scene: Scene, trained: Scene) -> dict[str, str]:
    """Fields that differ, but for the brightness of wavelengths that have light in both, with a description."""
    ours, theirs = scene, trained
    if [value > 0 for value in scene.radiosity_W_m2] == [value > 0 for value in trained.radiosity_W_m2]:
        ours = working_scene(scene, trained)
    return {
        key: f"{key} is {getattr(theirs, key)} there and {getattr(ours, key)} here"
        for key in Scene.model_fields
        if getattr(ours, key) != getattr(theirs, key)
    }


@lru_cache(maxsize=16)
def image_difference(scene: Scene, trained: Scene, device: str = "cpu") -> float:
    """Largest relative difference of two printed reliefs' images, ||a - b|| / ||b||, of scenes of one shape.

    Args:
        scene: what was measured.
        trained: what a network knows.
        device: where to simulate.
    """
    config = DatasetConfig(kind="updater", n_samples=_RELIEFS, seed=_SEED, scene=trained)
    heights = Reliefs(config, device).true(range(_RELIEFS))
    found = []
    with torch.no_grad():
        for relief in heights:
            ours, theirs = (
                CausticSimulator(s, "lattice", device=device)(relief).double()
                for s in (working_scene(scene, trained), trained)
            )
            found.append(float((ours - theirs).norm() / theirs.norm()))
    return max(found)


def check_scene(
    scene: Scene,
    trained: Scene,
    name: str,
    kind: str,
    device: str = "cpu",
    settings: Mapping[str, str] | None = None,
    seen: SeenScene | None = None,
) -> tuple[str, ...]:
    """Warnings of using a network for a scene; none where both are equal, or their images to ``NEGLIGIBLE_DIFFERENCE``.

    Args:
        scene: what was measured.
        trained: what the network knows.
        name: of the network's file, for messages.
        kind: of network, for the command that trains one.
        device: where to simulate, if need be.
        settings: with which such a network is trained, for messages.
        seen: the scene as the network sees it, where images and heights are brought to its grid; None where not.

    Raises:
        MismatchError: the scenes differ by more than may be; says in what, and the command that trains for it.
    """
    ours = scene if seen is None else seen.scene
    found = differences(ours, trained)
    if not found:
        return ()
    shape = {*SHAPE_FIELDS, "radiosity_W_m2"}
    if seen is not None:
        # In the user's own lengths and wavelengths.
        found = differences(in_own_lengths(ours, seen.scale), in_own_lengths(trained, seen.scale))
        if "wavelengths_m" in found:
            found["wavelengths_m"] = f"wavelengths_m is {trained.wavelengths_m} there and {scene.wavelengths_m} here"
        # Which way is up is told by the dispersion, however little of the image it makes.
        shape = {"wavelengths_m"} if seen.shown < trained.n_wavelengths else set()
    listed = ", ".join(found.values())
    if found.keys() & shape:
        why = listed
    else:
        difference = image_difference(ours, trained, device)
        if difference <= NEGLIGIBLE_DIFFERENCE:
            return ()
        if difference <= MAX_IMAGE_DIFFERENCE:
            return (
                f"{name} was trained for another scene ({listed}); used because images of both differ by "
                f"{difference:.2%} only, at most {MAX_IMAGE_DIFFERENCE:.0%} is accepted",
            )
        why = f"{listed}; images differ by {difference:.1%}, at most {MAX_IMAGE_DIFFERENCE:.0%} is accepted"
    command = train_command(kind, scene if seen is None else on_grid_of(scene, trained), settings)
    raise MismatchError(f"{name} is for another scene: {why}; train one with: {command}")


def on_grid_of(scene: Scene, trained: Scene) -> Scene:
    """The scene with the pixels and samples of a network: to train for, since images are brought to them."""
    grid = {key: getattr(trained, key) for key in ("height_samples", "image_pixels")}
    return scene.model_copy(update=grid)


def train_command(kind: str, scene: Scene, settings: Mapping[str, str] | None = None) -> str:
    """The command that trains a network for a scene, with other settings besides."""
    default = Scene().model_dump(mode="json")
    changed = {key: value for key, value in scene.model_dump(mode="json").items() if value != default[key]}
    texts = {f"scene.{key}": v if isinstance(v, str) else json.dumps(v) for key, v in changed.items()}
    options = "".join(f" --set {shlex.quote(f'{key}={text}')}" for key, text in {**texts, **(settings or {})}.items())
    return f"nsfc train {kind} --fresh --max-time 17m{options} -o RUN"
