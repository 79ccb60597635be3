"""How far lines may be from where they were found, by what the image tells of them and of all that was found beside.

Laplace's approximation: the misfit's Gauss-Newton matrix about lines and bench together, in units of what is left of
the image, is the inverse of their joint covariance. What a bench makes lines unsure of is in the block of the lines,
since its numbers are free to move along; and so is their section, where that was found with them: one that is a little
blunter looks much as of another gap. Heights follow to first order,

    u^2 = diag(J C J^T),   J = d heights / d (lines, section).

Limits: lines that are missing, or too many, are in no covariance; nor is a section of another family.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch

from nets.reconstruct.fibres.image.descent import Beside
from nets.reconstruct.fibres.image.descent_numbers import by_shape, moving
from nets.reconstruct.fibres.image.image_fit import ImageFit
from nets.reconstruct.fibres.image.lines_view import LinesView
from nets.reconstruct.fibres.image.one_wavelength import OneWavelength
from nets.reconstruct.posterior_samples import samples_of
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import Reconstruction
from warp_caustics.reconstruct.pyramid import usual_pixels
from warp_caustics.reconstruct.result import as_glass
from warp_caustics.types import FloatArray

CORRELATED_PX = 100.0
"""Pixels that err together, where lines are not yet right: what is believed of a bench weighs as so many."""
RIDGE = 1e-6
"""Of the scaled matrix, that keeps lines on top of each other apart."""
SHAPE_WIDTHS = (0.25, 1.0, 1.0, 0.5, 1e-3, 0.2)
"""Standard deviations of a shape's numbers before an image is seen, about half of what they may be: some images do not
tell them at all, as lines that do not cross do not tell what happens where lines cross."""


@dataclass(frozen=True, eq=False)
class JointCovariance:
    """Of lines and what was found with them.

    Attributes:
        matrix: of lines [m^2], their shape and what is beside them [widths], shape [6 L + S + K, 6 L + S + K].
        places: of the S numbers of the shape (:mod:`nets.reconstruct.fibres.image.descent_numbers`).
        is_by_noise: each pixel errs by itself (:mod:`nets.reconstruct.fibres.bench.noise_posterior`), not a hundred
            together.
    """

    matrix: FloatArray
    places: tuple[int, ...] = ()
    is_by_noise: bool = False


def misfit_weight(fit: ImageFit, loss: float, correlated_px: float = CORRELATED_PX) -> float:
    """Of half the square of one standard deviation, in units of the misfit, at which the image leaves so much.

    Args:
        fit: whose pixels count.
        loss: what the image leaves.
        correlated_px: pixels that err together.
    """
    counted = float((fit.measurement.weight > 0).sum())
    return 2 * loss * correlated_px / max(counted, 1.0)


def joint_covariance(
    fit: ImageFit, lines: torch.Tensor, beside: Beside | None, weight: float, *, with_section: bool = False
) -> JointCovariance:
    """Of lines, S numbers of their shape and K of what is beside them.

    Args:
        fit: on the bench that lines were found on.
        lines: shape [L, 6] [m].
        beside: numbers of the bench and its light, K of them, about where they were found; None for none.
        weight: of :func:`misfit_weight`.
        with_section: the shape's numbers were found with them (those that a descent moves); else S is 0.
    """
    heights, derivatives = fit.model.with_jacobian(lines)
    places = moving(fit.model.shape) if with_section else ()
    if places:
        derivatives = torch.cat([derivatives, by_shape(fit.model, lines, places)])
    information = fit.metric.normal_matrix(heights, derivatives, beside).numpy()
    count = 0 if beside is None else len(beside.modes)
    free = len(information) - count
    of_shape = np.arange(lines.numel(), free)
    information[of_shape, of_shape] += weight / np.array([SHAPE_WIDTHS[place] for place in places]) ** 2
    scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
    scale[free:] = 1.0
    information /= np.outer(scale, scale)
    information[free:, free:] += weight * np.eye(count)
    information[:free, :free] += RIDGE * np.eye(free)
    return JointCovariance(weight * np.linalg.inv(information) / np.outer(scale, scale), places)


def noise_covariance(view: LinesView, lines: torch.Tensor, *, with_section: bool = False) -> JointCovariance | None:
    """Of lines that leave nothing but noise, by that noise alone, each pixel's its own; None where it cannot be told.

    At few pixels of one wavelength, of which there are as many as of all together.

    Args:
        view: the image on the bench that lines explain it on.
        lines: shape [L, 6] [m].
        with_section: the shape's numbers were found with them.
    """
    left, image = view.left(lines), view.image_with_noise
    if left is None or image.noise_std is None:
        return None
    few, one = usual_pixels(view.scene), OneWavelength.clearest(image, view.scene, view.camera)
    fit = one.metric(view.model, few)
    assert one.image.noise_std is not None
    white = float(np.asarray(one.image.noise_std).mean()) / one.scene.radiosity_W_m2[0]
    # Means over so many pixels, and their noise; for less than the width the loss is r^2 / (2 width).
    noise = left * white * few / view.scene.image_pixels
    alike = view.scene.n_wavelengths * float((fit.measurement.weight > 0).sum())
    return joint_covariance(fit, lines, None, noise**2 / fit.width / alike, with_section=with_section)


def height_deviation(model: LineModel, lines: torch.Tensor, covariance: JointCovariance) -> FloatArray:
    """Standard deviation of heights [m], shape [n, n], by the block of the lines and their shape.

    Args:
        model: renders lines.
        lines: shape [L, 6] [m].
        covariance: of :func:`joint_covariance`.
    """
    derivatives = model.with_jacobian(lines)[1]
    if covariance.places:
        derivatives = torch.cat([derivatives, by_shape(model, lines, covariance.places)])
    flat = derivatives.flatten(1).double().cpu().numpy()
    own = covariance.matrix[: len(flat), : len(flat)]
    variance = np.einsum("pi,pi->i", own @ flat, flat)
    deviation: FloatArray = np.sqrt(np.maximum(variance, 0.0)).reshape(tuple(derivatives.shape[1:]))
    return deviation


def with_line_samples(
    found: Reconstruction, count: int, view: LinesView, lines: torch.Tensor, covariance: JointCovariance | None
) -> Reconstruction:
    """A result of lines with reliefs whose lines are drawn.

    Args:
        found: which may differ from the lines' relief by what a refinement added.
        count: of samples.
        view: the image on the bench that the lines explain it on.
        lines: shape [L, 6] [m].
        covariance: of lines and bench; None where the bench is as told.
    """
    if covariance is None:
        fit = ImageFit(view.scene, view.image, view.model, usual_pixels(view.scene), camera=view.camera)
        covariance = joint_covariance(fit, lines, None, misfit_weight(fit, fit.loss(view.model.heights(lines))))
    added = found.heights_m - view.relief(lines)
    drawn = drawn_lines(view.model, lines, covariance, count)
    reliefs = [as_glass(view.relief(each) + added, view.scene) for each in drawn]
    residuals = np.array([view.resimulation(each).residual for each in reliefs])
    samples = samples_of(np.stack(reliefs), residuals, found.heights_m, view.resimulation, found.uncertainty_m)
    counters = found.counters | {"samples": samples.record}
    return dataclasses.replace(found, samples_m=samples.heights_m, counters=counters)


def drawn_lines(
    model: LineModel, lines: torch.Tensor, covariance: JointCovariance, count: int, seed: int = 0
) -> torch.Tensor:
    """Lines as they may be as well, shape [N, L, 6] [m], within the model's limits."""
    size = lines.numel()
    values, vectors = np.linalg.eigh(covariance.matrix[:size, :size])
    white = np.random.default_rng(seed).standard_normal((count, size))
    steps = (white * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    return torch.stack([model.clamped(lines + torch.from_numpy(step).reshape(lines.shape)) for step in steps])
