"""What a calibration found: numbers of the bench with how sure they are, captures with what is left of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch

from warp_caustics.calibration.captures import Captures
from warp_caustics.calibration.coordinates import Coordinates
from warp_caustics.calibration.least_squares import Solution
from warp_caustics.calibration.posterior import Posterior
from warp_caustics.calibration.view import View
from warp_caustics.calibration.window_camera import camera_record
from warp_caustics.camera.config import CameraConfig
from warp_caustics.scene import Scene
from warp_caustics.setup.parameter import Parameter
from warp_caustics.setup.set_up import SetUp

TOLD = 0.8
"""What captures leave at most of a prior width where they say something."""
FAR = 3.0
"""Prior widths from what was believed that are worth a warning."""
MISFIT = 3.0
"""Residuals that many times the camera's noise are worth one, too."""

Verdict = Literal["found", "not told", "at its bound"]


@dataclass(frozen=True)
class Found:
    """One number after the captures, in its unit.

    Attributes:
        parameter: which; its prior width is what was not known before.
        before: what was believed.
        value: most probable.
        sigma: standard deviation, with what residuals add to noise.
        noise_sigma: that of noise alone.
        remaining: sigma over what was not known, in the coordinates of the descent [1].
        moved: value less what was believed, in prior widths of these coordinates [1].
        verdict: what it is worth.
        view: of which capture it is the own number; None of the bench.
    """

    parameter: Parameter
    before: float
    value: float
    sigma: float
    noise_sigma: float
    remaining: float
    moved: float
    verdict: Verdict
    view: str | None = None


@dataclass(frozen=True, eq=False)
class Fit:
    """How well one capture is explained.

    Attributes:
        view: the capture.
        before: image less what was expected at the start [W/m^2], shape [C, m, m].
        after: image less what is expected now [W/m^2], shape [C, m, m].
        misfit: what is left over the camera's noise, by medians, channel by channel, shape [C].
        explained: share of the square of ``before`` that is gone.
    """

    view: View
    before: np.ndarray[Any, Any]
    after: np.ndarray[Any, Any]
    misfit: np.ndarray[Any, Any]
    explained: float


@dataclass(frozen=True, eq=False)
class Calibration:
    """What was found.

    Attributes:
        setup: nominal, with its free parameters; P of them.
        found: of the bench, in the order of the set-up's names; then each capture's own.
        theta: values of the bench, shape [P].
        covariance: of theta, in the parameters' units, shape [P, P].
        fits: of the captures.
        is_converged: the descent ended because nothing more was to be gained.
        iterations: derivatives taken.
        warnings: what a person should know.
        information: of data and priors in coordinates of all numbers, shape [N, N].
        posterior: in the same.
    """

    setup: SetUp
    found: tuple[Found, ...]
    theta: torch.Tensor
    covariance: torch.Tensor
    fits: tuple[Fit, ...]
    is_converged: bool
    iterations: int
    warnings: tuple[str, ...]
    information: torch.Tensor
    posterior: Posterior

    @property
    def bench(self) -> tuple[Found, ...]:
        """Numbers of the bench."""
        return tuple(found for found in self.found if found.view is None)

    @property
    def correlations(self) -> torch.Tensor:
        """Of errors of theta, shape [P, P]."""
        deviation = self.covariance.diagonal().sqrt()
        return self.covariance / deviation[:, None] / deviation

    @property
    def scene(self) -> Scene:
        """The bench's scene."""
        return self.setup.scene(self.theta)

    @property
    def camera(self) -> CameraConfig:
        """The bench's camera, as it shows the window."""
        assert self.setup.camera_config is not None
        return camera_record(self.setup.camera_config, self.setup.camera(self.theta))


def found_numbers(
    setup: SetUp, views: Sequence[View], coordinates: Coordinates, solution: Solution, spread: Posterior
) -> tuple[Found, ...]:
    """Every number with what it is worth: the bench's in the order of the set-up, then each capture's own."""
    owners: list[str | None] = [None] * len(setup.parameters)
    for view in views:
        owners += [view.name] * (len(view.image) + len(view.plate.parameters))
    values = coordinates.values(solution.x)
    remaining = spread.covariance.diagonal().sqrt()
    sigma = coordinates.deviations(solution.x, remaining)
    noise = coordinates.deviations(solution.x, spread.noise_covariance.diagonal().sqrt())
    at_bound = (solution.x <= coordinates.low) | (solution.x >= coordinates.high)
    return tuple(
        Found(
            parameter=parameter,
            before=float(coordinates.before[k]),
            value=float(values[k]),
            sigma=float(sigma[k]),
            noise_sigma=float(noise[k]),
            remaining=float(remaining[k]),
            moved=float(solution.x[k]),
            verdict="not told" if float(remaining[k]) > TOLD else "at its bound" if bool(at_bound[k]) else "found",
            view=owners[k],
        )
        for k, parameter in enumerate(coordinates.parameters)
    )


def fits_of(captures: Captures, start: Sequence[torch.Tensor], x: torch.Tensor) -> tuple[Fit, ...]:
    """How well each capture is explained: what was shown at the start, shape [C, m, m] each, and at x, shape [N]."""
    fits = []
    for k, model in enumerate(captures.models_at(x)):
        counts, image = captures.counts[k], captures.images[k]
        before, after = (torch.where(counts, image - shown, 0.0) for shown in (start[k], model))
        level = captures._level[:, None, None]
        light = (model / level).clamp_min(0.0)
        own = captures.noise[k][:, None, None] * (0.3 + 0.7 * light).sqrt()
        misfit = [
            float((after[c][counts[c]] / own[c][counts[c]]).abs().median()) / 0.6745 if bool(counts[c].any()) else 0.0
            for c in range(len(image))
        ]
        whole = float(before.square().sum())
        explained = 1 - float(after.square().sum()) / whole if whole > 0 else 0.0
        fits.append(Fit(captures.views[k], before.cpu().numpy(), after.cpu().numpy(), np.array(misfit), explained))
    return tuple(fits)


def warnings_of(found: Sequence[Found], fits: Sequence[Fit], solution: Solution) -> tuple[str, ...]:
    """What a person should know: a descent that had not ended, residuals beyond noise, numbers far from belief."""
    lines = []
    if not solution.is_converged:
        lines.append("the descent had not ended; let it take more --iterations")
    for fit in fits:
        worst = float(fit.misfit.max())
        if worst > MISFIT:
            lines.append(
                f"{fit.view.name}: what is left is {worst:.1f} times the camera's noise (limit {MISFIT:g}); "
                "look at the residual for dust, another plate than told, or something the bench has and the model lacks"
            )
    for item in found:
        if abs(item.moved) > FAR and item.verdict == "found":
            where = item.parameter.name if item.view is None else f"{item.parameter.name} of {item.view}"
            lines.append(
                f"{where} is {abs(item.moved):.1f} times its prior width from what was believed (limit {FAR:g}); check "
                "the bench, or give --prior"
            )
    return tuple(lines)
