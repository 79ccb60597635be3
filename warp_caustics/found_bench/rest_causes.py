"""What the rest of an image looks like: light, camera, dirt or bench, with sizes; or none of them.

Of light and camera the rest is projected on what each of them would add to the image, all at once, in units of prior
widths and weighed by noise and simulation, with Huber's weights; deviations are those of blocks of the image
(:func:`~warp_caustics.found_bench.bench_step.block_spread`). A cause is named where it explains a share of what noise
does not, and is far from nothing. Its share is what chi^2 would grow by without it.

The bench's own numbers are asked in one Gauss-Newton step beside heights that move along
(:mod:`~warp_caustics.found_bench.bench_step`): heights have made up for most of a wrong bench, so that little of the
image is left to explain, but what is left leans the right way. Numbers that heights make up for entirely (gap, base,
index) are never named: no image tells them.

Dirt is told by where the result shows even light: what is left there that is fine is grain (speckle, compression), or
spots, if a few pixels hold most of it.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from warp_caustics.calibration.least_squares import huber
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_model import BenchModel
from warp_caustics.found_bench.bench_numbers import AMBIENT, BenchNumbers
from warp_caustics.found_bench.bench_record import verdict_of
from warp_caustics.found_bench.bench_step import bench_step, block_spread, laplacian
from warp_caustics.reconstruct.pyramid import DARK_FLOOR
from warp_caustics.reconstruct.rest import Rest
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.resampling import blur_matrices
from warp_caustics.types import FloatArray

SIGNIFICANT = 4.0
"""Standard deviations from nothing at which a cause may be named."""
LEAST_SHARE = 0.1
"""Of what is left beyond noise that a cause of light, camera or dirt explains at least."""
LEAST_BEYOND = 0.02
"""Of the noise's chi^2, below which there is nothing left to explain."""
BRIGHTNESS = 0.05
"""Prior width of each channel's brightness, which is estimated along and never named."""
LARGEST_RATIO = 1000.0
"""That is told: heights that claim to be exact have no larger one."""
BORDER = 1 / 128
"""Of the image on all sides that does not count where the bench is asked: a moved picture has half pixels there."""
LEAST_GRAIN = 0.01
"""Of a flat plate's light: grain below this is that of the simulations, too."""
SPOT_SIGMAS = 6.0
"""Of the noise and the grain, at which a pixel of even light is a spot."""
SPOTTED = 0.5
"""Share of what is left of even light that spots hold, from which on it is them."""

UNEVEN, MIXING, SOFTER, APART = "uneven_light", "mixing", "blur", "colours"
GRAIN, SPOTS = "grain", "spots"
WIDTHS = {UNEVEN: 0.05, MIXING: 0.03, SOFTER: 0.2, APART: 0.1}
"""Prior widths: rim against middle, share of the neighbours, variance [px^2], displacement [px]."""
SYSTEMATIC = {UNEVEN: 0.003, MIXING: 0.02, SOFTER: 0.03, APART: 0.01}
"""What images of benches that are as told still show of each, in the same units."""
MEANINGS = {
    UNEVEN: "uneven light, rim against middle",
    MIXING: "channels mixed, each neighbour's share",
    SOFTER: "blur beyond the camera's [px]",
    APART: "colours apart beyond what was undone [px]",
    GRAIN: "grain that the noise does not hold (speckle, compression), of even light",
    SPOTS: "dust or bright spots, number of places",
    "vergence_per_m": "a lamp at a finite distance, or a picture that is too large (below 0: too small) [1/m]",
    "lamp_distance_m": "a lamp at another distance, or a picture of another size [m]",
    "screen_x_m": "a picture that is moved along x [m]",
    "screen_y_m": "a picture that is moved along y [m]",
    "dispersion_scale": "a glass of other dispersion, or colours apart",
    AMBIENT: "stray light",
}


@dataclass(frozen=True)
class Cause:
    """One of them.

    Attributes:
        name: of a number of the bench, or one of this file's.
        meaning: in words.
        value: as the rest tells it; of the bench's numbers apart from what is told.
        sigma: standard deviation.
        share: of what is left beyond noise that it explains; None of the bench's numbers, for which heights make up.
        is_bench: whether heights are wrong where it is not told: lamp, glass, or place of the picture.
    """

    name: str
    meaning: str
    value: float
    sigma: float
    share: float | None = None
    is_bench: bool = False

    @property
    def words(self) -> str:
        """For people."""
        part = "" if self.share is None else f", {100 * self.share:.0f} % of it"
        sigma = f" +- {self.sigma:.1g}" if self.sigma else ""
        return f"{self.meaning}: {self.value:.3g}{sigma}{part}"


@dataclass(frozen=True)
class RestCauses:
    """What is left of an image, and why.

    Attributes:
        rest: shares of the image's light: beyond noise, by region.
        causes: that are named, of the bench first, the largest share first.
        ratio: of what is left beyond noise to what reliefs would leave that are off by the standard uncertainty at
            random; None where there is none.
    """

    rest: dict[str, float]
    causes: tuple[Cause, ...]
    ratio: float | None = None

    @property
    def line(self) -> str:
        """For people."""
        beyond = self.rest["beyond_noise"]
        told = f"{100 * beyond:.2g} % of the image beyond its noise"
        if self.causes:
            return f"{told}; it looks as of {'; '.join(cause.words for cause in self.causes)}"
        where = max(("even", "bright", "between"), key=lambda name: self.rest[name])
        places = {"even": "where light is even", "bright": "at bright lines", "between": "beside bright lines"}
        return f"{told}, most of it {places[where]}; not named by any number of the bench or the camera"

    @property
    def record(self) -> dict[str, Any]:
        """For a result's counters."""
        causes = [asdict(cause) for cause in self.causes]
        return {**self.rest, "ratio": self.ratio, "line": self.line, "causes": causes}


def rest_causes(
    rest: Rest,
    heights: FloatArray,
    numbers: BenchNumbers | None,
    camera: ChannelCamera,
    device: torch.device,
    predicted2: float | None = None,
    answer: FloatArray | None = None,
) -> RestCauses:
    """Why a result leaves what it leaves.

    Args:
        rest: at the pixels where heights were found.
        heights: of the result [m], shape [n, n].
        numbers: of the bench as it is told; without stray light, which the image no longer has. None: of a bench that
            was found in the image, and is not asked again.
        camera: in the model.
        device: where to simulate.
        predicted2: sum of squares that reliefs leave which are off by the uncertainty; None for none.
        answer: of a network before it was refined, which has made up for less of the bench; of a bench far from what
            was told it may be too wrong to tell of it, and the result is asked as well.
    """
    bench: tuple[Cause, ...] = ()
    if answer is not None and np.array_equal(answer, heights):  # it was not refined, and would say the same again
        answer = None
    for asked in (answer, heights):
        if numbers is not None and asked is not None and not any(cause.is_bench for cause in bench):
            found = tuple(_bench_causes(rest, asked, numbers, camera, device))
            bench = found if found or not bench else bench
    others = sorted((*_camera_causes(rest), *_dirt(rest)), key=lambda cause: -(cause.share or 0.0))
    ratio = None if predicted2 is None else min(math.sqrt(rest.beyond2 / max(predicted2, 1e-30)), LARGEST_RATIO)
    return RestCauses(rest.record(), (*bench, *others), ratio)


def _bench_causes(
    rest: Rest, heights: FloatArray, numbers: BenchNumbers, camera: ChannelCamera, device: torch.device
) -> Iterator[Cause]:
    measurement = rest.measurement
    pixels = measurement.irradiance.shape[-1]
    blur = blur_matrices(pixels, camera.blur_at(pixels), device) if camera.blurs else None
    each_noise = measurement.noise
    assert each_noise is not None
    inside, border = torch.zeros_like(measurement.weight), max(1, round(BORDER * pixels))
    inside[:, border:-border, border:-border] = measurement.weight[:, border:-border, border:-border]
    measurement = replace(measurement, weight=inside)
    level = each_noise / measurement.irradiance.double().clamp_min(DARK_FLOOR).sqrt()
    noise = level.mean((1, 2)).clamp_min(1e-3).double()
    told = {name: numbers.before[name] for name in numbers.names}
    relief = torch.tensor(np.asarray(heights), dtype=torch.float32, device=device)
    try:
        step = bench_step(BenchModel(numbers, pixels, device, blur), relief, told, measurement, noise)
    except InputError:  # a bench at the end of what benches are
        return
    for parameter in numbers.parameters:
        name = parameter.name
        if verdict_of(parameter, told[name], step.values[name], step.sigma[name]) == "found":
            value = step.values[name] - told[name]
            yield Cause(name, MEANINGS[name], value, step.sigma[name], is_bench=name != AMBIENT)


def _camera_causes(rest: Rest) -> Iterator[Cause]:
    shown, counts = rest.shown, rest.measurement.weight > 0
    names, columns = _camera_columns(shown)
    channels = len(shown)
    own = torch.zeros(channels, *shown.shape, dtype=shown.dtype, device=shown.device)
    for channel in range(channels):
        own[channel, channel] = BRIGHTNESS * shown[channel]
    widths = torch.tensor([WIDTHS[name] for name in names], dtype=torch.float64)
    columns = torch.cat((columns * widths.to(columns)[:, None, None, None], own))
    sigma = rest.variance.sqrt()
    residual = torch.where(counts, rest.left / sigma, 0.0)
    columns = torch.where(counts, columns / sigma, 0.0)
    _, weight = huber(residual)
    weighted = columns * weight
    information = (weighted.flatten(1) @ columns.flatten(1).T).cpu() + torch.eye(len(columns), dtype=torch.float64)
    found = torch.linalg.solve(information, (weighted.flatten(1) @ residual.flatten()).cpu())
    spread = block_spread(information, weighted * residual)
    inverse = torch.linalg.inv(information)
    chi2, count = float((weight * residual.square()).sum()), float((weight * counts).sum())
    beyond = max(chi2 - count, LEAST_BEYOND * count)
    for name in dict.fromkeys(names):
        which = [k for k, each in enumerate(names) if each == name]
        part = found[which]
        gain = float(part @ torch.linalg.solve(inverse[which][:, which], part))
        size = float(part.norm()) * WIDTHS[name]
        deviation = math.hypot(float(spread[which].max()) * WIDTHS[name], SYSTEMATIC[name])
        share = min(gain / beyond, 1.0)
        if share >= LEAST_SHARE and size > SIGNIFICANT * deviation:
            if name == SOFTER:
                if float(part[0]) < 0:  # sharper than the model: nothing that a lens does
                    continue
                size, deviation = math.sqrt(size), deviation / (2 * math.sqrt(size))
            yield Cause(name, MEANINGS[name], size, deviation, share)


def _camera_columns(shown: torch.Tensor) -> tuple[list[str], torch.Tensor]:
    """Names of what may be wrong, and what each adds to the image, shape [K, n_w, m, m]."""
    channels, m = len(shown), shown.shape[-1]
    at = (torch.arange(m, dtype=shown.dtype, device=shown.device) + 0.5) * (2 / m) - 1
    x, y = at[None, None, :], at[None, :, None]
    names, columns = [UNEVEN] * 3 + [SOFTER], [shown * x, shown * y, shown * ((x**2 + y**2) / 2 - 1 / 3)]
    columns.append(laplacian(shown) / 2)
    if channels > 1:
        mixed = torch.zeros_like(shown)
        for one, other in ((c, o) for c in range(channels) for o in (c - 1, c + 1) if 0 <= o < channels):
            mixed[one] += shown[other] - shown[one]
        names.append(MIXING)
        columns.append(mixed)
        slopes = torch.gradient(shown, dim=(1, 2))
        for channel in (c for c in range(channels) if c != channels // 2):
            for slope in slopes:
                moved = torch.zeros_like(shown)
                moved[channel] = -slope[channel]
                names.append(APART)
                columns.append(moved)
    return names, torch.stack(columns)


def _dirt(rest: Rest) -> Iterator[Cause]:
    even = (rest.regions()[0] & (rest.measurement.weight > 0).all(0)).cpu().numpy()
    if even.mean() < 0.01:
        return
    square = (rest.left - rest.coarse).square().mean(0).cpu().numpy()[even]
    noise = float(rest.noise2.mean(0).cpu().numpy()[even].mean())
    # The median tells grain, whatever a few spots do; of a mean of squares of n_w channels it is nearly the mean.
    grain2, whole2 = max(float(np.median(square)) - noise, 0.0), max(float(square.mean()) - noise, 0.0)
    spots2 = np.maximum(square - SPOT_SIGMAS**2 * (noise + grain2), 0.0)
    pixels = rest.left.shape[0] * even.sum()
    share = min(whole2 * pixels / max(rest.beyond2, 1e-30), 1.0)
    if share < LEAST_SHARE:
        return
    if float(spots2.sum()) > SPOTTED * whole2 * len(square):
        marks = np.zeros(even.shape, bool)
        marks[even] = spots2 > 0
        yield Cause(SPOTS, MEANINGS[SPOTS], float(scipy.ndimage.label(marks)[1]), 0.0, share)
    elif math.sqrt(grain2) > LEAST_GRAIN and grain2 > noise:
        yield Cause(GRAIN, MEANINGS[GRAIN], math.sqrt(grain2), 0.0, share)
