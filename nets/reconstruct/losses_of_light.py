"""Which losses of light an image shows that a scene leaves out: what every real plate does, and simulations may not.

Glass reflects, most where it is steep, and light that meets the relief again is scattered elsewhere. The true relief of
one plate of the suite ``lab`` has half the misfit on the told bench with both in the model as without.
"""

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
"""Heights refined with losses that are not told must leave less of an image than others, by this factor."""


def effects_of(scene: Scene) -> dict[str, Any]:
    """The losses that a scene has."""
    return {"fresnel": scene.fresnel, "second_hits": scene.second_hits}


def with_losses(scene: Scene, left: Callable[[Scene], float], *, both: bool = False) -> Scene:
    """The scene with the losses that leave least of an image; those that are told are never taken out.

    No margin is asked for here: a relief that is not yet refined is wrong enough to hide what losses do.

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
    return min(tried, key=left)  # the first of equals, which is what was told
