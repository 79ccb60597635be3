"""One method on one image."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch

from nets.evaluation.fields import Field
from nets.evaluation.method_spec import FLAT, MethodSpec, Stage
from warp_caustics.errors import CausticsError, InputError, known_names
from warp_caustics.metrics import relative_residual
from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor
from warp_caustics.reconstruct.transport.transport import with_initial
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.types import FloatArray


class FlatGuess(Reconstructor):
    """Finds nothing; every method should do better."""

    name = FLAT

    def __init__(self, scene: Scene, device: str | torch.device):
        self.scene, self.device = scene, device

    def reconstruct(
        self,
        image: CausticImage,
        *,
        initial: FloatArray | None = None,
        progress: ProgressCallback | None = None,
    ) -> Reconstruction:
        """A flat relief, whatever the image."""
        n = self.scene.height_samples
        level = np.array(self.scene.radiosity_W_m2)[:, None, None]
        simulated = np.broadcast_to(level, image.irradiance.shape).astype(np.float32)
        residual = relative_residual(simulated, image.irradiance)
        return Reconstruction(FLAT, np.zeros((n, n)), simulated, residual, "converged")


def create_method(name: str, scene: Scene, device: str, options: Mapping[str, Any]) -> Reconstructor:
    """The method of that name; learned ones too.

    Raises:
        InputError: unknown method or setting.
    """
    if name == FLAT:
        return FlatGuess(scene, device)
    from nets.reconstruct.methods import create

    return create(name, scene, device=device, **options)


def known_methods() -> tuple[str, ...]:
    """Names that a stage may have."""
    from nets.reconstruct.methods import ALL_METHODS

    return (FLAT, *ALL_METHODS)


def check_methods(specs: Sequence[MethodSpec], scene: Scene, device: str) -> list[str]:
    """Make every method once, so that mistakes show before anything is computed.

    Returns:
        One line for every method that cannot be made (a setting, a missing network); its cells will fail.

    Raises:
        InputError: a method that does not exist, or none that can be made.
    """
    truth = np.zeros((scene.height_samples, scene.height_samples))
    problems: list[str] = []
    broken = set()
    for spec in specs:
        for stage in spec.stages:
            if stage.name not in known_methods():
                raise InputError(f"method {stage.name!r} is not known; {known_names(stage.name, known_methods())}")
            try:
                create_method(stage.name, scene, device, _options(stage, truth))
            except CausticsError as error:
                problems.append(f"{spec.label}: {error}")
                broken.add(spec.label)
                if len(broken) == len(specs):
                    raise type(error)(problems[0]) from error
    return problems


def reconstruct(spec: MethodSpec, field: Field, scene: Scene, device: str) -> Reconstruction:
    """Run all stages of a method, each from where the one before ended.

    Raises:
        KeyboardInterrupt: Ctrl-C; half a result is no cell.
    """
    result: Reconstruction | None = None
    for stage in spec.stages:
        method = create_method(stage.name, scene, device, _options(stage, field.heights_m))
        before = result
        result = method.reconstruct(field.image, initial=None if before is None else before.heights_m)
        if result.stop_reason == "interrupted":
            raise KeyboardInterrupt
        if before is not None:
            result = with_initial(result, before)
    assert result is not None
    if result.heights_m.shape != field.heights_m.shape or not np.isfinite(result.heights_m).all():
        raise InputError(f"{spec.label} returned heights that are not finite or of another shape; report it")
    return result


def warm_up(scene: Scene, device: str) -> None:
    """Compile what nearly every method uses, so that the first one timed does not pay for it."""
    simulator = CausticSimulator(scene, device=device)
    n = scene.height_samples
    heights = torch.zeros(n, n, dtype=simulator.dtype, device=simulator.device, requires_grad=True)
    for _ in range(2):
        simulator(heights).square().mean().backward()


def privileged_knowledge(result: Reconstruction) -> tuple[str, ...]:
    """What a method was told of the true relief; nothing for most."""
    found = []
    settings: Any = result.settings
    while isinstance(settings, Mapping):
        knowledge = settings.get("knowledge", {})
        found += [name for name, source in knowledge.items() if source == "oracle" and name not in found]
        # A method that made the start may have been told something too.
        initial = settings.get("initial")
        settings = initial.get("settings") if isinstance(initial, Mapping) else None
    return tuple(found)


def _options(stage: Stage, truth: FloatArray) -> dict[str, Any]:
    options = dict(stage.options)
    if stage.wants_truth:
        options["oracle_heights_m"] = truth
    return options
