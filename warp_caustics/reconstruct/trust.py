"""How far a result is to be believed: what it leaves of the image, against what noise and simulation leave of it.

A relative residual alone says little: photon noise may leave 20 % of a dim image that is explained, and a missing line
2 % of a bright one. By Morozov's discrepancy principle an image is explained once no more is left than the noise; the
simulation's own error, told by one with half as many photons, comes on top. Both are asked of the whole image and of
each part of it, where a missing line does not drown in the noise of all the rest.

A method that found its heights on a coarser image is judged there, by means over those pixels: all of the image, in
larger ones, and no fewer than heights (:func:`~warp_caustics.reconstruct.pyramid.judged_pixels`). Finer ones have had
no say; and what its coarse simulation does otherwise than the fine one, averaged, it cannot but leave, even of the
truth. What is left of all pixels, and what noise and simulation leave of those, is told beside it.

That an image is explained does not make the heights right: where light paths cross, several reliefs explain it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch

from warp_caustics.reconstruct.objective import Measurement

MOST_OF_NOISE = 1.5
"""Ratio of what is left to noise and simulation error, up to which an image is explained."""
MOST_IN_PLACES = 2.5
"""The same for one part of the image."""
LEAST_NOISE = 2e-3
"""Of the light of a flat plate, below which parts are not judged: no camera shows less, and where an image is
simulated without noise even 1 um of heights would show."""
PARTS = 32
"""Parts of the image per side, at most."""
FEWEST_PIXELS = 8
"""Of a part, per side, at least: of fewer pixels the noise itself strays too far."""
MOST_OF_FLAT = 0.5
"""Share of what a flat plate leaves, from which on the relief is hardly better than none."""
MANY_FOLDS = 0.03
"""Share of the plate where light paths cross, from which on other reliefs are worth a word."""


@dataclass(frozen=True)
class Trust:
    """What a result leaves of the image, all shares of ||measured||.

    Attributes:
        line: for people.
        is_explained: None where the noise of the image is not known.
        left: residual.
        noise: what noise leaves; None if unknown.
        simulation: error of the simulation, as half the photons tell it.
        flat: what a plate without relief leaves.
        places: share of the image's parts that are not explained; None if the noise is unknown.
        is_beyond_relief: whether heights may be wrong by more than the relief.
        noise_source: ``"given"`` with the image, ``"estimated"`` from it, or ``"unknown"``.
        pixels: per side, where the image was judged at fewer than it has; None at all of them.
        left_at_all: residual of all pixels; that of :attr:`left` where all were judged.
        floor_at_all: what noise and simulation leave of all pixels; None where the noise is unknown.
    """

    line: str
    is_explained: bool | None
    left: float
    noise: float | None
    simulation: float
    flat: float
    places: float | None
    noise_source: str
    is_beyond_relief: bool = False
    pixels: int | None = None
    left_at_all: float = math.nan
    floor_at_all: float | None = None

    @property
    def floor(self) -> float | None:
        """What noise and simulation leave of the judged pixels; None where the noise is unknown."""
        return None if self.noise is None else math.hypot(self.noise, self.simulation)

    def beside(self, whole: "Trust") -> "Trust":
        """The same with what is left of all pixels, from the judgement of those."""
        return replace(self, left_at_all=whole.left, floor_at_all=whole.floor)


class Seen(NamedTuple):
    """A result's caustic as the camera sees it, in units of the radiosity, shape [n_w, m, m] each."""

    image: torch.Tensor
    """By the simulation that is reported."""
    by_half: torch.Tensor
    """By half as many photons; or, where fewer pixels are judged, by the simulation that heights were found with."""


def image_trust(
    measurement: Measurement,
    seen: Seen,
    noise_source: str,
    folded: Callable[[], float] = lambda: 0.0,
    of_pixels: int | None = None,
) -> Trust:
    """How far a result is to be believed.

    Args:
        measurement: all pixels, or means over more than one; its noise is that of these.
        seen: of the result, of the measurement's shape.
        noise_source: where that noise comes from.
        folded: share of the plate where light paths cross; asked only of results that explain the image.
        of_pixels: that the image has per side, where the measurement has fewer.
    """
    pixels = None if of_pixels is None else measurement.irradiance.shape[-1]
    at = "" if pixels is None else f" at {pixels} of {of_pixels} pixels"
    weight = measurement.weight.double()
    light = float((measurement.irradiance * weight).norm())
    left = ((seen.image - measurement.irradiance).double() * weight) ** 2
    model = ((seen.image - seen.by_half).double() * weight) ** 2
    residual, simulation = (math.sqrt(float(values.sum())) / light for values in (left, model))
    flat = float(((1 - measurement.irradiance).double() * weight).norm()) / light
    if measurement.noise is None:
        line = f"not judged: {_percent(residual)} of the image left{at}, and the noise of the image is not known"
        return Trust(line, None, residual, None, simulation, flat, None, "unknown", False, pixels, residual)
    expected = (measurement.noise.double() * weight) ** 2
    noise = math.sqrt(float(expected.sum())) / light
    # Shot noise in bright parts, that of the camera in dark ones: the larger counts where a part is judged alone.
    grown = measurement.irradiance.clamp_min(1.0) / measurement.irradiance.clamp_min(0.05)
    judged = torch.maximum(expected, (LEAST_NOISE * weight) ** 2)
    places = _unexplained_parts(left, model + judged * grown.double())
    floor = math.hypot(noise, simulation)
    is_whole = residual <= MOST_OF_NOISE * floor
    is_explained = is_whole and places == 0
    told = f"{_percent(residual)} of the image left{at}, noise and simulation leave {_percent(floor)}"
    is_beyond = residual > MOST_OF_FLAT * flat and not is_whole
    if is_explained:
        line = f"explained within noise: {told}"
        crossing = folded()
        if crossing > MANY_FOLDS:
            line += f"; light paths cross on {_percent(crossing)} of the plate, where other reliefs may explain it too"
    elif is_beyond:
        line = f"not explained: {told}, a flat plate {_percent(flat)}; heights may be wrong by more than the relief"
    elif is_whole:
        line = f"explained but for {_percent(places)} of its area: {told}; heights may be wrong there"
    else:
        line = (
            f"explained in part: {told}, a flat plate {_percent(flat)}; heights err in places, or all of "
            "them, where set-up or camera (blur) are not as described"
        )
    return Trust(
        line, is_explained, residual, noise, simulation, flat, places, noise_source, is_beyond, pixels, residual, floor
    )


def seen_by_camera(seen: Trust, blur_px: float, apart_px: float) -> Trust | None:
    """Trust in a result whose method knows no camera, while one would explain the image; None where none does.

    Args:
        seen: with the camera.
        blur_px: of its lens, standard deviation [px].
        apart_px: largest displacement of a channel [px].
    """
    if not seen.is_explained:
        return None
    what = [f"blur of {blur_px:.2g} px"] * (blur_px > 0) + [f"channels {apart_px:.2g} px apart"] * (apart_px > 0)
    after = seen.line.removeprefix("explained within noise")
    return replace(
        seen, line=f"explained within noise by a camera ({', '.join(what)}) that the method leaves out{after}"
    )


def _unexplained_parts(left: torch.Tensor, expected: torch.Tensor) -> float:
    """Share of the image's parts that hold more than noise; squares of each pixel, shape [n_w, m, m]."""
    pixels = left.shape[-1]
    side = max(FEWEST_PIXELS, -(-pixels // PARTS))
    if pixels < side:
        return 0.0
    both = torch.stack([left.sum(0), expected.sum(0)])[:, None]
    # The last part of a side is smaller where sides do not divide; means of what is there stay comparable.
    found, allowed = torch.nn.functional.avg_pool2d(both, side, ceil_mode=True, count_include_pad=False)[:, 0]
    return float((found > MOST_IN_PLACES**2 * allowed).double().mean())


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"
