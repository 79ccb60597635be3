"""What to measure or photograph next: by how much each would shrink what captures leave open most.

The combination of numbers that is least told is the eigenvector of the told covariance, in prior widths, with the
largest
eigenvalue. A measurement of one number, or a capture of another plate (its Fisher information, with its own numbers
estimated
along), leaves part of its deviation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from warp_caustics.calibration.captures import Captures, Own
from warp_caustics.calibration.coordinates import Coordinates
from warp_caustics.calibration.found import Calibration
from warp_caustics.calibration.plates import DESIGN, TOLERANCES, KnownPlate, flat_plate, lens, wedge
from warp_caustics.calibration.view import LEAST_PIXELS, View
from warp_caustics.prints.line import Line, line_relief
from warp_caustics.scene import Scene
from warp_caustics.setup.information import without
from warp_caustics.setup.parameter import Parameter

PIXELS = 64
"""Of captures that are only thought of."""
TOOLS: dict[str, tuple[float, str]] = {
    "base_thickness_m": (3e-6, "measure the plate's thickness with a micrometer"),
    "gap_m": (1e-5, "measure the gap between plate and screen with feeler gauges"),
    "index_offset": (1e-4, "take the melt's index from its certificate"),
    "dispersion_scale": (5e-3, "take the melt's dispersion from its certificate"),
    "tilt_x_rad": (1e-3, "set the light upright by autocollimation, along x"),
    "tilt_y_rad": (1e-3, "set the light upright by autocollimation, along y"),
    "vergence_per_m": (0.02, "check the collimation, or measure how far the lamp is"),
    "lamp_half_angle_rad": (3e-4, "measure the lamp: its radius over the collimator's focal length"),
    "lamp_distance_m": (2e-3, "measure the lamp's distance"),
    "lamp_x_m": (1e-3, "plumb the lamp along x"),
    "lamp_y_m": (1e-3, "plumb the lamp along y"),
    "lamp_radius_m": (5e-5, "measure the lamp's diameter"),
    "turn_rad": (3e-4, "square the camera to the plate's edge"),
    "magnification": (2e-4, "photograph a scale in the screen's place"),
}
"""Standard deviation of a direct measurement, about, and how."""
TOLD_BY_PLATES = ("psf_px", "ambient")


@dataclass(frozen=True)
class Advice:
    """One thing to do.

    Attributes:
        what: to do.
        left: of the deviation of the least told combination [1].
        most: name of the number that gains most.
        sigma: its deviation after that, in its unit.
    """

    what: str
    left: float
    most: str
    sigma: float


@dataclass(frozen=True)
class LeastTold:
    """The combination that captures leave most open.

    Attributes:
        remaining: its deviation in prior widths [1].
        parts: names and weights of the numbers in it, largest first.
    """

    remaining: float
    parts: tuple[tuple[str, float], ...]


def least_told(calibration: Calibration) -> LeastTold:
    """The widest combination of the bench's numbers."""
    names = calibration.setup.names
    value, vector = _widest(_told(calibration))
    order = vector.abs().argsort(descending=True).tolist()
    parts = tuple((names[k], float(vector[k])) for k in order if abs(float(vector[k])) >= 0.3)
    return LeastTold(value**0.5, parts)


def advice(calibration: Calibration, *, device: str | torch.device = "cpu") -> list[Advice]:
    """Things to do, the best first.

    Args:
        calibration: what was found.
        device: where to simulate.
    """
    told = _told(calibration)
    known = torch.linalg.inv(told)
    names = calibration.setup.names
    found = []
    for k, name in enumerate(names):
        if name in TOOLS:
            width, how = TOOLS[name]
            slope = calibration.bench[k].sigma / max(calibration.bench[k].remaining, 1e-300)
            extra = torch.zeros_like(known)
            extra[k, k] = (slope / width) ** 2
            found.append(_rated(calibration, how, told, known + extra))
    for plate, is_divided, what in _thought_plates(calibration.setup.nominal_scene):
        extra = _information_of(calibration, plate, is_divided, device)
        found.append(_rated(calibration, what, told, known + extra))
    return sorted(found, key=lambda item: item.left)


def _told(calibration: Calibration) -> torch.Tensor:
    count = len(calibration.setup.parameters)
    return calibration.posterior.covariance[:count, :count]


def _widest(covariance: torch.Tensor) -> tuple[float, torch.Tensor]:
    values, vectors = torch.linalg.eigh(covariance)
    vector = vectors[:, -1]
    return float(values[-1]), vector if float(vector[vector.abs().argmax()]) > 0 else -vector


def _rated(calibration: Calibration, what: str, told: torch.Tensor, information: torch.Tensor) -> Advice:
    after = torch.linalg.inv(information)
    _, vector = _widest(told)
    left = float((vector @ after @ vector) / (vector @ told @ vector)) ** 0.5
    shrunk = (after.diagonal() / told.diagonal()).sqrt()
    k = int(shrunk.argmin())
    item = calibration.bench[k]
    return Advice(what, left, item.parameter.name, item.sigma * float(shrunk[k]))


def _thought_plates(scene: Scene) -> list[tuple[KnownPlate, bool, str]]:
    """Plates that one might photograph: whether with a flat frame, and in words."""
    size = min(scene.plate_size_m)
    radius = 1.8 * size
    far = scene.base_thickness_m - 2 * scene.screen_position_m[2]
    generator = np.random.default_rng(7)
    lines = [
        Line(
            (float(x0), float(y0)), (float(x1), float(y1)), 0.05 * size, min(0.006 * size, 0.05 * size**2 / (16 * far))
        )
        for x0, y0, x1, y1 in 0.42 * size * (2 * generator.random((12, 4)) - 1)
    ]

    def printed(factor: float, n: int, plate: tuple[float, float]) -> np.ndarray:
        return line_relief([Line(a.start_m, a.end_m, a.width_m * factor, a.height_m) for a in lines], n, plate)

    test = KnownPlate(DESIGN, "print", lambda n, plate: printed(1.0, n, plate), TOLERANCES[DESIGN], printed)
    return [
        (flat_plate(), False, "photograph a plate without relief, with a dark and no flat frame"),
        (
            lens(radius, 0.9 * size, name="lens"),
            True,
            f"photograph a plano-convex lens of about R = {radius * 1e3:.0f} mm",
        ),
        (wedge(0.0175), True, "photograph a wedge of about 1 degree"),
        (test, True, f"photograph a print of a dozen lines {0.05e3 * size:.1f} mm wide"),
    ]


def _information_of(
    calibration: Calibration, plate: KnownPlate, is_divided: bool, device: str | torch.device
) -> torch.Tensor:
    """What a capture of that plate would say about the bench, in coordinates of its numbers, shape [P, P]."""
    setup = calibration.setup
    scene = setup.nominal_scene
    factor = 1
    while scene.image_pixels // factor > PIXELS and scene.image_pixels % (2 * factor) == 0:
        factor *= 2
    if scene.image_pixels // factor < LEAST_PIXELS:
        factor = 1
    channels, m = scene.n_wavelengths, scene.image_pixels
    noise = np.mean([fit.view.noise * np.maximum(fit.misfit, 1.0) for fit in calibration.fits], axis=0)
    view = View("thought of", plate, np.ones((channels, m, m)), noise, None, is_divided)
    parameters: Sequence[Parameter] = [
        *setup.parameters,
        *(
            Parameter(f"brightness.{c}", "b", "1", 1e-3, 1e3, view.brightness_prior, "camera", "")
            for c in range(channels)
        ),
        *plate.parameters,
    ]  # fmt: skip
    count = len(setup.parameters)
    own = Own(slice(count, count + channels), slice(count + channels, len(parameters)))
    before = torch.cat((setup.nominal, torch.ones(channels), torch.zeros(len(plate.parameters)))).to(torch.float64)
    coordinates = Coordinates.of(parameters, before)
    x = coordinates.to(torch.cat((calibration.theta, before[count:])))
    captures = Captures(setup, [view], [own], coordinates, factor, photons=2 * m // factor, device=device)
    captures.images = tuple(captures.models_at(x))
    captures.start_noise(x)
    information = captures.normal(x).information
    extra = torch.eye(len(parameters), dtype=torch.float64)
    extra[:count, :count] = 0
    nuisance = torch.arange(len(parameters)) >= count
    return without(information + extra, nuisance)
