"""Lines that vary along their way, as machines print them: thicker and thinner, and aside of what was meant.

Straight lines of one width and height leave more than noise of such a print wherever it is thick, so that the search
for lines ends there. With knots along each line, of thickness and of the way aside, hundreds of numbers are found with
those of the lines by L-BFGS on the exact model, held by what machines do (Gaussian priors about none of either).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy  # loads its parts when they are first used
import torch

from nets.reconstruct.fibres.image.descent import LOSS_SCALE
from nets.reconstruct.fibres.image.image_fit import FINE_PHOTONS_PER_PIXEL, ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.image.one_wavelength import OneWavelength
from nets.reconstruct.fibres.shapes.beside_waves import FACTOR, ROUNDS, Beside, BesideWaves, counted, mended
from warp_caustics.prints.model import LINE_COLUMNS, LineModel
from warp_caustics.prints.wavy_model import WavyModel, knot_counts
from warp_caustics.reconstruct.pyramid import usual_pixels
from warp_caustics.types import FloatArray

THICKNESS, ASIDE_M = 0.03, 4e-5
"""Standard deviations that are believed of waves: 4 % and 50 um at most, as the supplement's printer may have, are less
than two of these."""
LINE_SCALES_M = (3e-5, 3e-5, 3e-5, 3e-5, 3e-5, 1e-5)
"""Changes of a line's numbers (LINE_COLUMNS) that change an image about as much as one deviation of a wave."""
FARTHEST = 8.0
"""Deviations that a wave may be, at most: a line keeps three quarters of its width."""
TOGETHER_PX = 5.0
"""Pixels that err together: so many times less do they tell than if they were independent. With a hundred an own plate
of seven lines, 6 % of noise, ended 3.0 um off, with five 1.3; straight ones 10.3."""
FEW_ITERATIONS, ALL_ITERATIONS = 80, 25
"""Of L-BFGS at few pixels, and at all."""
ALSO_TRIED = 2.0
"""Share of what the network's relief leaves of the image that straight lines may leave for waves to be tried: four own
plates with waves of 4 % and 50 um left 0.9 to 1.7 (curves and rings, which are no lines, as much and more)."""
WAVES_FACTOR = 0.7
"""What is left of the image must fall by this factor for waves to be taken: they have hundreds of numbers."""
CONVERGED = 1e-5


class Run(Protocol):
    """Lines of one image, so far."""

    lines: torch.Tensor
    view: LinesView
    model: LineModel

    def left(self) -> tuple[FloatArray, float, float]:
        """Relief of the lines, and what it and the network's leave of the image."""

    def note(self, loss: float) -> None:
        """Told after each evaluation; may raise."""


@dataclass(frozen=True, eq=False)
class WavyLines:
    """Lines with what varies along them.

    Attributes:
        lines: shape [L, 6] [m].
        knots: more thickness [1] and the way aside [m], evenly spaced from start to end, shape [L, K, 2]; lines with
            fewer knots end before.
        counts: of knots, shape [L].
        heights: relief [m], shape [n, n], float32, on the model's device.
    """

    lines: torch.Tensor
    knots: torch.Tensor
    counts: torch.Tensor
    heights: torch.Tensor

    @property
    def thickness(self) -> float:
        """Root mean square of what lines are thicker or thinner [1]."""
        return float(self._used[:, 0].square().mean().sqrt())

    @property
    def aside_m(self) -> float:
        """Root mean square of the way aside [m]."""
        return float(self._used[:, 1].square().mean().sqrt())

    @property
    def record(self) -> dict[str, float]:
        """For a result's counters."""
        return {"thickness": self.thickness, "aside_m": self.aside_m}

    @property
    def _used(self) -> torch.Tensor:
        return torch.cat([own[: int(count)] for own, count in zip(self.knots, self.counts, strict=True)])


def waves_of(run: Run) -> WavyLines | None:
    """Waves along the lines of a run, where they explain clearly more of its image; None where they do not.

    Args:
        run: of which lines were found, and nothing better is to come.

    Raises:
        KeyboardInterrupt: the run's time is over.
    """
    view, (_, left, of_network), noise = run.view, run.left(), run.view.noise
    if view.is_explained(run.lines) or left > ALSO_TRIED * of_network:
        return None
    image = view.image
    size, one = usual_pixels(view.scene), OneWavelength.clearest(image, view.scene, view.camera)
    few = one.fit(run.model, size, report=run.note)
    found = with_waves(few, straight(run.model, run.lines), FEW_ITERATIONS, noise)
    if not view.resimulation(view.glass(found.heights)).residual < WAVES_FACTOR * left:
        return None

    def beside(added_m: torch.Tensor) -> tuple[ImageFit, ImageFit]:
        model = BesideWaves(run.model, added_m)
        quick = one.metric(model, size // 2)
        return one.fit(model, size, report=run.note, metric=quick), quick

    found = with_mended_lines(few, found, noise, beside)
    every = view.scene, image, run.model, view.scene.image_pixels
    fine = ImageFit(*every, photons_per_pixel=FINE_PHOTONS_PER_PIXEL, report=run.note, camera=view.camera)
    fine.correct_at(found.heights)
    return with_waves(fine, found, ALL_ITERATIONS, noise)


def with_mended_lines(few: ImageFit, found: WavyLines, noise: float, beside: Beside) -> WavyLines:
    """Lines that are mended beside their waves, and waves along them, while these explain the image better.

    Args:
        few: judges.
        found: lines and their waves.
        noise: standard deviation of a pixel, in units of the radiosity.
        beside: misfits of lines beside what waves add.
    """
    left = few.loss(found.heights)
    for _ in range(ROUNDS[few.model.device.type]):
        fits = beside(found.heights - few.model.heights(found.lines))
        begun = [straight(few.model, lines) for lines in mended(*fits, found.lines)]
        tried = [with_waves(few, each, FEW_ITERATIONS, noise) for each in begun]
        losses = [few.loss(each.heights) for each in tried]
        scores = [counted(loss, len(each.lines)) for loss, each in zip(losses, tried, strict=True)]
        best = scores.index(min(scores))
        if scores[best] >= FACTOR * counted(left, len(found.lines)):
            break
        found, left = tried[best], losses[best]
    return found


def straight(model: LineModel, lines: torch.Tensor) -> WavyLines:
    """Lines that do not vary yet."""
    counts = knot_counts(lines)
    knots = torch.zeros(len(lines), int(counts.max()), 2, dtype=torch.float64)
    return WavyLines(lines, knots, counts, model.heights(lines))


def with_waves(fit: ImageFit, start: WavyLines, iterations: int, noise: float) -> WavyLines:
    """Lines and waves that explain the image better, with what is believed of waves; never worse.

    Args:
        fit: judges.
        start: where to begin.
        iterations: of L-BFGS, at most.
        noise: standard deviation of a pixel, in units of the radiosity.
    """
    wavy, count = WavyModel(fit.model, start.counts), len(start.lines)
    scales = torch.tensor(LINE_SCALES_M, dtype=torch.float64)
    widths = torch.tensor([THICKNESS, ASIDE_M], dtype=torch.float64)
    of_lines = count * len(LINE_COLUMNS)
    # The misfit is r^2 / (2 width) for each pixel's residual, their mean; noise says r^2 / (2 noise^2), their sum.
    pixels = float(fit.measurement.weight.sum())
    believed = LOSS_SCALE * TOGETHER_PX * noise**2 / (fit.width * pixels)

    def numbers(u: FloatArray) -> tuple[torch.Tensor, torch.Tensor]:
        moved = torch.from_numpy(u[:of_lines].reshape(count, -1))
        knots = torch.from_numpy(u[of_lines:].reshape(start.knots.shape)) * widths
        return fit.model.clamped(start.lines + scales * moved), knots

    def objective(u: FloatArray) -> tuple[float, FloatArray]:
        lines, knots = numbers(u)
        alone = wavy.alone(lines, knots)
        loss, by_height, _ = fit.with_gradient(wavy.together(alone))
        by_line, by_knot = wavy.gradient(lines, knots, alone, by_height)
        waves = u[of_lines:]
        gradient = np.concatenate([(by_line * scales).numpy().ravel(), (by_knot * widths).numpy().ravel()])
        gradient *= LOSS_SCALE
        gradient[of_lines:] += believed * waves
        if fit.report is not None:
            fit.report(loss)
        return LOSS_SCALE * loss + believed / 2 * float(waves @ waves), gradient

    begun = np.concatenate([np.zeros(of_lines), (start.knots / widths).numpy().ravel()])
    settings = {"maxiter": iterations, "maxfun": int(1.3 * iterations) + 2, "maxcor": 30, "ftol": CONVERGED}
    bounds = [(None, None)] * of_lines + [(-FARTHEST, FARTHEST)] * (len(begun) - of_lines)
    found = scipy.optimize.minimize(objective, begun, jac=True, method="L-BFGS-B", bounds=bounds, options=settings)
    lines, knots = numbers(found.x)
    return WavyLines(lines, knots, start.counts, wavy.heights(lines, knots))
