"""How wrong is a relief that was found with the help of a design?

Where the network's answers in all symmetries agree, heights are right; where
they spread, the design and the image decide, so that the error grows more
slowly than the spread: as its root, where the design is a list of lines. The
factors are measured, on plates with known heights (docs/inspect.md).
"""

from dataclasses import dataclass

import numpy as np

from nets.reconstruct.uncertainty import DIRECT_CALIBRATION
from warp_caustics.prints.line_shape import Shape
from warp_caustics.reconstruct.rest import Rest, local_relief
from warp_caustics.types import BoolArray, FloatArray

SPREADS = 1.1
"""What is called spread here: so many standard deviations of the answers over the symmetries."""


@dataclass(frozen=True)
class DesignCalibration:
    """Measured relation of spread and error, sigma = scale (spread / 1 um)^power, not below ``floor_m``.

    Attributes:
        scale_m: standard uncertainty where the spread is 1 um [m].
        power: how it grows.
        floor_m: least uncertainty [m].
    """

    scale_m: float
    power: float
    floor_m: float


LINES = DesignCalibration(scale_m=2.0e-6, power=0.5, floor_m=0.5e-6)
"""Of a design that is a list of lines."""
RELIEF = DesignCalibration(scale_m=2.2e-6, power=0.72, floor_m=1.5e-6)
"""Of any other design."""


EXPLAINED_LINES = DesignCalibration(scale_m=0.7e-6, power=0.5, floor_m=0.3e-6)
"""Of lines of a design that leave nothing but noise of the image; measured on six plates, where 2 sigma covers 98 to
100 % of the heights."""
PLAIN_LINES = DesignCalibration(scale_m=0.005e-6, power=0.5, floor_m=0.005e-6)
"""Of lines without a design that leave nothing but noise, of one section that may have been found with them, beside
what noise makes of them (:func:`~nets.reconstruct.fibres.bench.line_posterior.noise_covariance`), which is nearly all.
On 94 own plates, 0.2 um off in the median, 73 % of the points with relief lie within one, 95 % within two."""
STEEP_LINES = DesignCalibration(scale_m=0.025e-6, power=0.5, floor_m=0.01e-6)
"""The same of a section that meets the plate upright, as an ellipse does: what light does there, no lattice and no cell
shows. 71 and 97 % on 16."""
MERGED_LINES = DesignCalibration(scale_m=0.04e-6, power=0.5, floor_m=0.02e-6)
"""The same of lines that do not add up where they cross: 71 and 93 % on 14."""
BLURRED_LINES = DesignCalibration(scale_m=0.06e-6, power=0.5, floor_m=0.03e-6)
"""Of lines seen through a lens that blurs, which was found with them: 75 and 89 % on 14. Its place, gain and stray
light, taken into the covariance of noise, change that by nothing: caustics are sharp, and these are smooth."""
CURVED_LINES = DesignCalibration(scale_m=0.12e-6, power=0.5, floor_m=0.04e-6)
"""Of lines with corners and curves, for which noise is in no part: 75 and 89 % on 15."""
WAVY_LINES = DesignCalibration(scale_m=0.6e-6, power=0.5, floor_m=0.1e-6)
"""And with waves along them: 77 and 91 % on seven."""
CROSSING = 2.3
"""Times what noise and spread make of lines where light paths cross: what lattice and cells leave there, and what is
wrong of ends below others, is in no noise. On 94 own plates 69 and 96 % of the points where they do then lie within one
and two, and 73 and 95 % of the others; 35 and 61, and 57 and 85, without it and the base's part."""
BARE_M = 0.03e-6
"""Of the base, where lines leave nothing but noise on a bench that was told exactly and nobody says how flat it is [m].
Free heights have 0.1 um in common that way (:mod:`nets.reconstruct.direct_options`); lines leave the base as it is."""
ROUND, UPRIGHT_ROUND, UPRIGHT_COSINE = 0.5, 0.9, 0.45
"""Share of the parabola in a section from which on it is one with that, and powers of parabolas and cosines below which
these meet the plate upright: (1 - t^2)^g does below 1, cos(pi t / 2)^2g below a half."""
ADDED_UP = 0.9
"""Overlap from which on lines add up."""


def calibration_of(
    shape: Shape, *, has_waves: bool, has_curves: bool = False, is_blurred: bool = False
) -> DesignCalibration:
    """Of lines without a design that leave nothing but noise, by what they have in common.

    Args:
        shape: of all lines.
        has_waves: lines have waves along them.
        has_curves: lines have corners and curves.
        is_blurred: they are seen through a lens that blurs.
    """
    if has_waves:
        return WAVY_LINES
    if has_curves:
        return CURVED_LINES
    if is_blurred:
        return BLURRED_LINES
    if shape.overlap <= ADDED_UP:
        return MERGED_LINES
    return STEEP_LINES if is_upright(shape) else PLAIN_LINES


def is_upright(shape: Shape) -> bool:
    """Whether a section meets the plate upright, or nearly; a circular cap does not."""
    most = UPRIGHT_ROUND if shape.parabola >= ROUND else UPRIGHT_COSINE
    return not shape.is_cap and shape.exponent < most


def design_uncertainty(spread_m: FloatArray, calibration: DesignCalibration) -> FloatArray:
    """Standard uncertainty of the heights [m], shape [n, n].

    Args:
        spread_m: of the answer that knows no design, ``SPREADS`` standard deviations [m], shape [n, n].
        calibration: of the kind of design.
    """
    grown: FloatArray = calibration.scale_m * (np.maximum(spread_m, 0) / 1e-6) ** calibration.power
    return np.maximum(grown, calibration.floor_m)


def of_lines(
    network_m: FloatArray,
    heights_m: FloatArray,
    rest: Rest | None,
    is_noise_left: bool,
    flatness_m: float,
    posterior_m: FloatArray | None = None,
    places: FloatArray | None = None,
    calibration: DesignCalibration = PLAIN_LINES,
    crossing: BoolArray | None = None,
) -> FloatArray:
    """Standard uncertainty of a relief of lines [m], shape [n, n].

    That of the network and of what is left of the image, or of lines that leave nothing but noise.

    Args:
        network_m: of the network's answer [m], shape [n, n].
        heights_m: the relief [m], shape [n, n].
        rest: what it leaves of the image; None where that is not asked, or its noise not known.
        is_noise_left: whether lines leave nothing but noise.
        flatness_m: standard deviation of the base from a plane [m].
        posterior_m: what lines and a bench that were found together leave open [m], shape [n, n]
            (:mod:`nets.reconstruct.fibres.bench.line_posterior`); None on the told bench.
        places: share of the image's contrast that they leave around each sample beyond noise, shape [n, n]
            (:meth:`nets.reconstruct.fibres.image.discrepancy.Discrepancy.places`); counts where nothing has been
            refined.
            Lines that are wrong in a place do not move elsewhere to make up for it, as free heights do.
        calibration: of lines that leave nothing but noise.
        crossing: where light paths cross, shape [n, n] (:func:`~warp_caustics.fold_fraction.crossing_samples`); None
            where a bench was found with lines, which states enough.
    """
    found = network_m
    if rest is not None:
        found = np.hypot(found, DIRECT_CALIBRATION.shared * rest.share * local_relief(heights_m))
    if is_noise_left:
        found = design_uncertainty(SPREADS / DIRECT_CALIBRATION.scale * found, calibration)
    if posterior_m is not None:
        found = np.hypot(found, posterior_m)
    if crossing is not None:
        found = np.where(crossing, CROSSING, 1.0) * found
    if places is not None:
        found = np.hypot(found, DIRECT_CALIBRATION.shared * places * local_relief(heights_m))
    return np.hypot(found, flatness_m) if flatness_m else found


def disagreement(heights_m: FloatArray, free_m: FloatArray) -> FloatArray:
    """Stands in for the uncertainty where no network has answered: how far the result is from what was found freely.

    Not calibrated: what both get wrong together shows nowhere.

    Args:
        heights_m: the result [m], shape [n, n].
        free_m: the answer that knows no design [m], shape [n, n].
    """
    return np.maximum(np.abs(heights_m - free_m), LINES.floor_m)
