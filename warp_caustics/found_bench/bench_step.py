"""One Gauss-Newton step on the numbers of a bench, with heights that move along.

Unknowns are the numbers theta, brightness and softness of each channel, and the amplitudes of a few changes of the
heights (:mod:`~warp_caustics.found_bench.height_changes`), all in units of prior widths. All but theta are estimated
along and thrown away: heights are found again on the new bench. Softness is half a Laplacian, what a little blur does:
images of other photons are less sharp than a simulation, or more, which would be taken for stray light. Residuals are
weighed by a noise that is fitted to them, since what is wrong with the heights is most of them, and by Huber's weights
beside it.

The deviation is that of a sandwich over blocks of the image (:mod:`warp_caustics.calibration.posterior`): errors of
heights hang together over a line, and what parts of the image disagree by tells how far they lead astray.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from warp_caustics.calibration.least_squares import huber
from warp_caustics.calibration.noise_model import fitted_variance, terms
from warp_caustics.errors import InputError
from warp_caustics.found_bench.bench_model import BenchModel
from warp_caustics.found_bench.bench_numbers import AMBIENT
from warp_caustics.found_bench.height_changes import height_changes
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.pyramid import in_units_of_radiosity
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import STEP_PX, optical_steps

BRIGHTNESS = 0.05
"""Prior width of each channel's brightness: of a lamp that drifts between two frames."""
SOFTNESS_PX2 = 0.2
"""Prior width of what blurs each channel more than is known [px^2]."""
LARGEST = 2.0
"""Of a coordinate in one step [prior widths]: heights are found again before the next."""
SHARES = (1.0, 0.5, 0.25)
"""Of a step that are tried."""
SYSTEMATIC_PX = {
    "screen_x_m": 0.03, "screen_y_m": 0.03, "vergence_per_m": 0.015, "lamp_distance_m": 0.015,
    "dispersion_scale": 0.007,
}  # fmt: skip
"""By what plates with heights that are right still come out wrong: how far light would move, in pixels that are as
coarse as a simulation and sample caustics that are sharper (docs/found_bench.md)."""
SYSTEMATIC_AMBIENT = 4e-3
"""The same of stray light: what a camera that does not count below 0 makes of noise in the dark."""
BLOCKS = 16
"""Along each side of the image, for the scatter of what its parts say."""


@dataclass(frozen=True)
class BenchStep:
    """What an image says of a bench beside heights that are nearly right.

    Attributes:
        values: of numbers, by name, after the step.
        sigma: their standard deviations.
        gain: by which the objective falls, in units of the noise that was fitted (half of chi^2); 0 for no step.
    """

    values: dict[str, float]
    sigma: dict[str, float]
    gain: float


def bench_step(
    model: BenchModel, heights: torch.Tensor, values: Mapping[str, float], measurement: Measurement, noise: torch.Tensor
) -> BenchStep:
    """A step from some values.

    Args:
        model: of the bench, at the measurement's pixels.
        heights: found on the bench of these values [m], shape [n, n], float32.
        values: of all numbers of the model, by name.
        measurement: image in units of the radiosity, as it was taken: with stray light.
        noise: standard deviation of its pixels where light is flat, in units of the radiosity, shape [n_w].
    """
    numbers = model.numbers
    count, channels = len(numbers.parameters), len(noise)
    image = measurement.irradiance.double()
    counts = measurement.weight > 0
    base = model.image(heights, values)
    changes = height_changes(heights, numbers.scene.plate_size_m, min(numbers.scene.pixel_size_m))
    own = torch.zeros(2 * channels, *base.shape, dtype=base.dtype, device=base.device)
    for channel, softer in enumerate(laplacian(base) / 2):
        own[channel, channel], own[channels + channel, channel] = base[channel], softer
    columns = torch.cat(
        (model.by_numbers(heights, values, base), own, model.by_heights(heights, values, base, changes))
    ).double()
    priors = torch.tensor([p.prior for p in numbers.parameters], dtype=torch.float64)
    widths = torch.cat(
        (
            priors,
            torch.full((channels,), BRIGHTNESS, dtype=torch.float64),
            torch.full((channels,), SOFTNESS_PX2, dtype=torch.float64),
            torch.ones(len(changes), dtype=torch.float64),
        )
    )
    # Brightness first, by all the light: what stray light does is half of it a change of all brightness.
    ratio = (image * counts).sum((1, 2)) / (base.double() * counts).sum((1, 2)).clamp_min(1e-30)
    ratio = torch.where(ratio > 0, ratio, 1.0)[:, None, None]
    columns = columns * ratio * widths.to(columns.device)[:, None, None, None]
    shown, side = base.double() * ratio, columns[count : count + 2 * channels]
    level = torch.ones(channels, dtype=torch.float64, device=image.device)
    variance = fitted_variance(terms(shown, noise.to(image), level), shown - image, counts)
    sigma = variance.sqrt()
    residual = torch.where(counts, (image - shown) / sigma, 0.0)
    columns = torch.where(counts, columns / sigma, 0.0)
    rho, weight = huber(residual)
    weighted = columns * weight
    information = (weighted.flatten(1) @ columns.flatten(1).T).cpu() + torch.eye(len(widths), dtype=torch.float64)
    before = torch.tensor([numbers.before[name] for name in numbers.names], dtype=torch.float64)
    at = torch.tensor([values[name] for name in numbers.names], dtype=torch.float64)
    pull = (weighted.flatten(1) @ residual.flatten()).cpu()
    pull[:count] -= (at - before) / priors
    step = torch.linalg.solve(information, pull)
    step = step * min(1.0, LARGEST / max(float(step[:count].abs().max()), 1e-300))
    spread = block_spread(information, weighted * residual)[:count] * priors
    # Of the told bench: near no dispersion a step of it would move nothing, however large.
    least = systematic(numbers.scene, measurement.irradiance.shape[-1])
    deviations = {name: math.hypot(s, least[name]) for name, s in zip(numbers.names, spread.tolist(), strict=True)}
    start = float(rho.sum())
    for share in SHARES:
        moved = at + share * step[:count] * priors
        trial = numbers.within(dict(zip(numbers.names, moved.tolist(), strict=True)))
        amplitudes = (share * step[count + 2 * channels :]).to(changes)
        beside = torch.tensordot((share * step[count : count + 2 * channels]).to(image), side, 1)
        try:
            seen = model.image(heights + torch.tensordot(amplitudes, changes, 1), trial).double() * ratio + beside
        except InputError:
            continue
        cost = float(huber(torch.where(counts, (image - seen) / sigma, 0.0))[0].sum())
        if cost < start:
            return BenchStep(trial, deviations, start - cost)
    return BenchStep(dict(values), deviations, 0.0)


def systematic(scene: Scene, pixels: int) -> dict[str, float]:
    """Deviations that are the model's and not the noise's, by name.

    Args:
        scene: the bench.
        pixels: simulated, along a side.
    """
    steps = optical_steps(in_units_of_radiosity(scene, pixels))
    return {name: moved / STEP_PX * steps[name] for name, moved in SYSTEMATIC_PX.items()} | {
        AMBIENT: SYSTEMATIC_AMBIENT
    }


def laplacian(images: torch.Tensor) -> torch.Tensor:
    """Sum of second differences [1/px^2], shape [n_w, m, m]; pictures are mirrored at their border."""
    wide = torch.nn.functional.pad(images, (1, 1, 1, 1), mode="replicate")
    around = wide[:, 2:, 1:-1] + wide[:, :-2, 1:-1] + wide[:, 1:-1, 2:] + wide[:, 1:-1, :-2]
    laplacian: torch.Tensor = around - 4 * images
    return laplacian


def block_spread(information: torch.Tensor, scores: torch.Tensor) -> torch.Tensor:
    """Deviations of all unknowns in prior widths, shape [N].

    Args:
        information: of image and priors, shape [N, N].
        scores: what each pixel says, shape [N, n_w, m, m].
    """
    m = scores.shape[-1]
    size = max(1, -(-m // BLOCKS))
    padded = torch.nn.functional.pad(scores.sum(1), (0, -m % size, 0, -m % size))
    side = padded.shape[-1] // size
    blocks = padded.reshape(len(scores), side, size, side, size).sum((2, 4)).flatten(1).T.cpu()
    apart = blocks - blocks.mean(0)
    inverse = torch.linalg.inv(information)
    meat = apart.T @ apart * (len(blocks) / (len(blocks) - 1)) + torch.eye(len(inverse), dtype=torch.float64)
    deviations: torch.Tensor = (inverse @ meat @ inverse).diagonal().sqrt()
    return deviations
