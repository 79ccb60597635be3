"""A result that says what the rest of its image looks like."""

import dataclasses

import numpy as np
import torch

from nets.reconstruct.with_doubt import with_doubt
from warp_caustics.found_bench.bench_numbers import BenchNumbers
from warp_caustics.found_bench.relief_left import relief_left, size_of
from warp_caustics.found_bench.rest_causes import rest_causes
from warp_caustics.reconstruct.base import CausticImage, Reconstruction
from warp_caustics.reconstruct.pyramid import check_image
from warp_caustics.reconstruct.result import Resimulation
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator, usable_device
from warp_caustics.types import FloatArray

SEEN_TIMES = 5.0
"""Lines that leave nothing but noise may leave so many times of an image what heights do that are off by what they
state: what is left there beside noise is the lens's and the simulation's. On thirty blurred plates of the test bench,
0.06 to 0.5 um off, there would be 1.5 to 2.4 times as much at 1, and an alarm on twelve of them."""


def with_causes(
    found: Reconstruction,
    image: CausticImage,
    simulator: CausticSimulator,
    numbers: BenchNumbers | None,
    answer: FloatArray | None = None,
    *,
    is_exact: bool = False,
) -> Reconstruction:
    """The result with ``counters["rest"]``; as it is where the image's noise cannot be told.

    Nor where heights are those on another bench than the simulator's: its numbers are in ``counters["bench"]``.

    Args:
        found: on the grid of the simulator's scene.
        image: without the stray light of that bench.
        simulator: of the bench as it is told, or as it was found.
        numbers: of that scene; None where it was found in the image, and is not asked again.
        answer: heights before they were refined, which have made up for less of the bench [m], shape [n, n].
        is_exact: of lines that leave nothing but noise, which were found without the error of a usual lattice, and are
            looked at without it.
    """
    if numbers is not None and found.counters.get("bench", {}).get("is_kept"):
        return found
    seen, camera = seen_by(found, image, simulator)
    if is_exact:
        seen = seen.finer()
    found_at = None if found.trust is None else found.trust.pixels
    rest = seen.rest(found.heights_m, found_at)
    if rest is None:
        return found
    predicted2 = None
    if found.uncertainty_m is not None:
        leaves_m = SEEN_TIMES * found.uncertainty_m if is_exact else found.uncertainty_m
        predicted2 = seen.predicted2(found.heights_m, leaves_m, found_at)
    clear = None if numbers is None else BenchNumbers.of(numbers.scene, numbers.told_widths)
    causes = rest_causes(rest, found.heights_m, clear, camera, simulator.device, predicted2, answer)
    found = dataclasses.replace(found, counters=found.counters | {"rest": causes.record})
    is_of_lines = found.fibres_m is not None or found.paths is not None
    return with_relief_left(found, relief_left(rest, simulator.scene)) if is_of_lines else found


def seen_by(
    found: Reconstruction, image: CausticImage, simulator: CausticSimulator
) -> tuple[Resimulation, ChannelCamera]:
    """What a result's image is compared with, and the camera that it found."""
    camera = ChannelCamera.perfect(simulator.scene.n_wavelengths, simulator.scene.image_pixels)
    if "camera" in found.counters:
        camera = ChannelCamera.of_record(found.counters["camera"], simulator.scene.image_pixels)
    if "exposure" in found.counters:
        seen = Resimulation(simulator, image, np.asarray(found.counters["exposure"], np.float64))
    else:
        seen = Resimulation(simulator, image).exposed(found.heights_m)
    return seen.through(camera), camera


def looks_bare(found: Reconstruction, image: CausticImage, simulator: CausticSimulator) -> bool:
    """Whether a plate without relief leaves nothing but noise of a result's image; False where that cannot be told."""
    rest = seen_by(found, image, simulator)[0].rest(np.zeros_like(found.heights_m))
    return rest is not None and not relief_left(rest, simulator.scene).any()


def with_relief_left(found: Reconstruction, left_m: FloatArray) -> Reconstruction:
    """A result of lines whose uncertainty has what they leave where light is even; as it is where that is noise.

    Heights that are free have made up for it.

    Args:
        found: with ``counters["rest"]``.
        left_m: the relief that would leave so much [m], shape [n, n].
    """
    if not left_m.any():
        return found
    size_m = size_of(left_m)
    left_um = 1e6 * float(np.sqrt(np.mean(np.square(left_m))))
    counters = found.counters | {"rest": found.counters["rest"] | {"relief_left_um": left_um}}
    if found.uncertainty_m is None:
        return dataclasses.replace(found, counters=counters)
    stated_um = 1e6 * float(np.sqrt(np.mean(np.square(found.uncertainty_m, dtype=np.float64))))
    warnings = found.warnings
    if left_um > stated_um:
        told = (
            f"what lines leave of the image where light is even looks as of {left_um:.2g} um of relief (root mean "
            f"square, up to {1e6 * float(np.abs(left_m).max()):.2g} um) that is no line, or of dust or uneven light "
            "there: see the difference of the images; it is in the uncertainty"
        )
        warnings = (*warnings, told)
    whole = np.hypot(found.uncertainty_m, size_m)
    return dataclasses.replace(found, counters=counters, uncertainty_m=whole, warnings=warnings)


def explained(found: Reconstruction, image: CausticImage, scene: Scene, device: str | torch.device) -> Reconstruction:
    """The same for a method that does not ask itself; one that has been interrupted or asked is returned as it is.

    Args:
        found: on the grid of the scene.
        image: as it was measured.
        scene: as it is told.
        device: where to simulate.
    """
    if found.trust is None or "rest" in found.counters or found.stop_reason == "interrupted":
        return found
    if found.heights_m.shape != (scene.height_samples, scene.height_samples):
        return found
    simulator = CausticSimulator(scene, "lattice", device=usable_device(device))
    numbers = BenchNumbers.of(scene)
    return with_doubt(with_causes(found, check_image(image, scene), simulator, numbers))
