"""``auto``: the method that suits the image, the scene, the start and the networks at hand."""

import dataclasses
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import pydantic
import torch

from nets.reconstruct.direct_options import BENCH_OPTIONS
from nets.reconstruct.fibres.options import FibresOptions
from nets.shipped import shipped_weights
from warp_caustics.errors import CausticsError, InputError, MismatchError
from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor
from warp_caustics.reconstruct.folds import has_folds
from warp_caustics.reconstruct.pyramid import check_image
from warp_caustics.reconstruct.refine.options import RefineOptions
from warp_caustics.reconstruct.run_log import following
from warp_caustics.reconstruct.transport.transport import FOLDED_RESIDUAL, transport_initial, with_initial
from warp_caustics.scene import Scene
from warp_caustics.simulator import usable_device
from warp_caustics.types import FloatArray

Create = Callable[..., Reconstructor]
"""``create`` of the registry: name, scene, device and options to a method."""

Plan = Literal["refine", "direct", "fibres", "transport+refine"]

NETWORKED = ("direct", "fibres")
"""Plans whose methods ask a network, and take options about the bench."""

LEFT_ALONE = 40
"""Lines from which on a CPU leaves them to ``direct``: thirty take two cores a minute, on other benches three."""


@dataclass(frozen=True)
class Choice:
    """What was chosen, and why."""

    plan: Plan
    why: str


def choose(
    has_start: bool, has_folds: bool, refusal: str | None, device_type: str = "cpu", *, is_timed: bool = False
) -> Choice:
    """The plan for an image.

    Args:
        has_start: a relief to start from is given.
        has_folds: light paths cross, by the brightness of the image.
        refusal: why no direct network can be used; None if one can.
        device_type: where to compute: on a GPU lines take seconds.
        is_timed: whether there is a time limit.
    """
    if has_start:
        return Choice("refine", "a start is given, and refine makes the most of one")
    if not has_folds:
        return Choice("refine", "the image shows no folds, and descent from flat finds weak reliefs exactly")
    if refusal is None:
        if is_timed and device_type == "cpu":
            why = "a trained network knows this scene, and within a time limit a CPU does not look for lines"
            return Choice("direct", why)
        why = "a trained network knows this scene, and lines that explain the image are more exact than its answer"
        return Choice("fibres", why)
    return Choice("transport+refine", f"no network can be used ({refusal})")


def _check_options(options: Mapping[str, Any]) -> None:
    """Refuse options that no method ``auto`` may choose would take.

    Raises:
        pydantic.ValidationError: what refine says of them.
    """
    try:
        FibresOptions(**options)
    except pydantic.ValidationError:
        RefineOptions(**options)


class Auto(Reconstructor):
    """Chooses a method for each image and runs it.

    The method's name in the result is that of the method that was chosen; ``settings["auto"]`` says why.

    Args:
        scene: the set-up of the measurement.
        options: of whatever is chosen.
        device: where to compute.
        create: makes a method by name.
    """

    name = "auto"

    def __init__(self, scene: Scene, options: Mapping[str, Any], device: str | torch.device, create: Create):
        self.scene, self.options, self.device, self._create = scene, dict(options), usable_device(device), create
        self._made: dict[str, Reconstructor] = {}
        self._is_timed = self.options.get("max_time_s") is not None
        self._networked = choose(False, True, None, self.device.type, is_timed=self._is_timed).plan
        if "weights" not in self.options:
            _check_options(self.options)

    def choose(self, image: CausticImage, initial: FloatArray | None = None) -> Choice:
        """What :meth:`reconstruct` would do with these; the method is made, so that wrong options are found.

        Raises:
            InputError: the image does not fit the scene, or options the method does not know.
        """
        image = check_image(image, self.scene)
        folds = has_folds(image, self.scene)
        # A network is loaded only where it may be used.
        refusal = self._refusal() if initial is None and folds else None
        choice = choose(initial is not None, folds, refusal, self.device.type, is_timed=self._is_timed)
        self._method(choice.plan if choice.plan in NETWORKED else "refine")
        return choice

    def reconstruct(
        self,
        image: CausticImage,
        *,
        initial: FloatArray | None = None,
        progress: ProgressCallback | None = None,
    ) -> Reconstruction:
        """Recover the relief; see :class:`~warp_caustics.reconstruct.base.Reconstructor`."""
        choice = self.choose(image, initial)
        why = choice.why
        if choice.plan != "transport+refine":
            result = self._method(choice.plan).reconstruct(image, initial=initial, progress=progress)
        else:
            refine = self._method("refine")
            started = time.perf_counter()
            start = transport_initial(self.scene, image, self.device, progress)
            after = following(progress, len(start.history), started)
            if start.stop_reason == "interrupted":
                result = start
            elif start.residual <= FOLDED_RESIDUAL:
                why += f"; transport leaves {start.residual:.1%} of the image, so refine starts there"
                result = with_initial(refine.reconstruct(image, initial=start.heights_m, progress=after), start)
            else:
                why += f"; transport leaves {start.residual:.0%} of the image unexplained, so refine starts from flat"
                result = refine.reconstruct(image, progress=after)
        if self.options.get("samples") and choice.plan not in NETWORKED:
            line = f"none, because {result.method}, which auto chose, finds one relief and knows of no other"
            result = dataclasses.replace(result, counters=result.counters | {"samples": {"count": 0, "line": line}})
        return dataclasses.replace(result, settings=result.settings | {"auto": {"plan": choice.plan, "why": why}})

    def _refusal(self) -> str | None:
        """Why no method with a network can be made; None if it was."""
        if not shipped_weights() and self.options.get("weights") is None:
            return "none comes with this software"
        try:
            if self._networked not in self._made:
                made = self._create(self._networked, self.scene, device=self.device, **self._taken(self._networked))
                self._made[self._networked] = made
        except (InputError, MismatchError) as error:
            if "weights" in self.options:
                raise  # these and no others are wanted
            return str(error)
        return None

    def _method(self, name: str) -> Reconstructor:
        if name not in self._made:
            try:
                self._made[name] = self._create(name, self.scene, device=self.device, **self._taken(name))
            except CausticsError as error:
                raise type(error)(f"auto chose {name}: {error}") from error
        return self._made[name]

    def _taken(self, name: str) -> dict[str, Any]:
        """Options of a method: those that were given and are its own."""
        if name == "fibres" and self.device.type == "cpu":
            return {"left_alone": LEFT_ALONE} | self.options
        return {key: value for key, value in self.options.items() if name in NETWORKED or key not in BENCH_OPTIONS}
