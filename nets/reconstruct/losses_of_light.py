"""Which losses of light an image shows that a scene leaves out: what every real plate does, and simulations may not.

Glass reflects, most where it is steep, and light that meets the relief again is scattered elsewhere. Lines at the right
place on the told bench leave half as much of an image of the suite ``lab`` with both in the model as without.
"""

import math
from collections.abc import Callable
from typing import Any

from warp_caustics.scene import Scene

EFFECTS: tuple[dict[str, Any], ...] = (
    {},
    {"fresnel": True},
    {"second_hits": "lost"},
    {"fresnel": True, "second_hits": "lost"},
)
LOSS_FACTOR = 0.98
"""Losses other than those told must lower what is left of the image by this factor."""


def effects_of(scene: Scene) -> dict[str, Any]:
    """The losses that a scene has."""
    return {"fresnel": scene.fresnel, "second_hits": scene.second_hits}


def with_losses(scene: Scene, left: Callable[[Scene], float], *, both: bool = False) -> Scene:
    """The scene with the losses that leave least of an image; those that are told are never taken out.

    Args:
        scene: as it is told.
        left: what a relief leaves of the image in a scene, in any unit.
        both: try all losses together or none, which compiles fewer kernels.
    """
    tried: list[Scene] = []
    for effects in (EFFECTS[0], EFFECTS[-1]) if both else EFFECTS:
        other = scene.model_copy(update=effects)
        if all(effects_of(other) != effects_of(each) for each in tried):
            tried.append(other)
    best, least = scene, math.inf
    for number, each in enumerate(tried):
        found = left(each)
        if found < (LOSS_FACTOR if best is scene and number else 1.0) * least:
            best, least = each, found
    return best
