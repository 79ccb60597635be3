"""The bench that captures of known plates were taken on: the most probable values, and how sure they are.

Coarse to fine: large pixels first, image and model looked at through a blur, so that a picture several pixels off is
found; the whole displacement first of all, by correlation. In the last pixels the noise is fitted to what is left, and
the descent goes on with that. What is found, and what it is worth: ``found.py``.
"""

from collections.abc import Callable, Sequence

import torch

from warp_caustics.calibration.captures import OVERSAMPLING, Captures, Own
from warp_caustics.calibration.coordinates import Coordinates
from warp_caustics.calibration.found import Calibration, fits_of, found_numbers, warnings_of
from warp_caustics.calibration.least_squares import Solution, minimised
from warp_caustics.calibration.posterior import posterior
from warp_caustics.calibration.registration import displacement_px
from warp_caustics.calibration.view import LEAST_PIXELS, View, factors
from warp_caustics.calibration.window_camera import shown_window
from warp_caustics.camera.config import CameraConfig
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.setup.parameter import Parameter
from warp_caustics.setup.set_up import SetUp

BLURS_PX = (1.5, 0.7)
"""That coarse images are looked at through, coarsest first; the finest is looked at as it is."""
PHOTONS, FINEST_PHOTONS = 2, 4
"""Light paths along a pixel's side, coarse and finest; footprints of the last blur by an eighth of a pixel."""
MORE_PHOTONS = 1.5
"""Light paths along a side of the simulation that tells how far the fitted one is off, in those of that."""
LEAST_PHOTONS = 512
"""Along the window's side on the finest level: footprints widen lines of the relief and the lamp. With 192 the width of
lines 2 mm wide comes out 2 % off."""
ITERATIONS, FINEST_ITERATIONS = 10, 8
NOT_SHARED = ("gain",)
"""Groups that each capture has for itself, as its brightness."""
LIGHT_GROUPS = ("light_x", "light_y", "light_xx", "light_xy", "light_yy")
"""Free where a photo was not divided by a flat frame, which would hide them."""


def usual_free(scene: Scene, camera: CameraConfig, views: Sequence[View]) -> list[str]:
    """Names of parameters that are looked for where nobody says which.

    Those of :data:`~warp_caustics.setup.set_up.USUAL_CAMERA` but for gains, which are each capture's; uneven light
    where a capture without flat frame shows it.
    """
    usual = [name for name in SetUp.of(scene, camera).names if name.partition(".")[0] not in NOT_SHARED]
    if any(not view.is_divided for view in views):
        usual += [f"{group}.{channel}" for group in LIGHT_GROUPS for channel in range(scene.n_wavelengths)]
    return usual


def calibrate(
    scene: Scene,
    camera: CameraConfig | None,
    views: Sequence[View],
    *,
    free: Sequence[str] | None = None,
    priors: dict[str, float] | None = None,
    finest: int = 256,
    border_px: int = 8,
    iterations: int = FINEST_ITERATIONS,
    photons: int | None = None,
    device: str | torch.device = "cpu",
    progress: Callable[[str, int, float], None] | None = None,
) -> Calibration:
    """Find the bench.

    Args:
        scene: nominal, of the captures' size.
        camera: nominal; None is one that shows every pixel as it is.
        views: captures of known plates.
        free: names or groups of parameters to look for; None is :func:`usual_free`.
        priors: standard deviations of what is not known before, by name or group.
        finest: pixels per side of the last level, at most.
        border_px: pixels on all sides that do not count.
        iterations: of the descent on the finest level, each of its two times.
        photons: light paths along the window's side on the finest level; None is four a pixel and at least
            :data:`LEAST_PHOTONS`.
        device: where to simulate.
        progress: called with level, iteration and objective.

    Raises:
        InputError: no captures, captures of another size, or names that are unknown.
    """
    _check(scene, views, border_px)
    nominal = shown_window(camera or CameraConfig())
    names = list(free) if free is not None else usual_free(scene, nominal, views)
    setup = SetUp.of(scene, nominal, names, priors=priors)
    shared = [p for p in setup.parameters if p.group in NOT_SHARED]
    if shared:
        raise InputError(f"{shared[0].name} is each capture's own and found anyway; leave it out of the free ones")
    parameters, before, own = _all_numbers(setup, views)
    coordinates = Coordinates.of(parameters, before)
    x = torch.zeros(len(parameters), dtype=torch.float64)
    levels, done = factors(scene.image_pixels, finest), 0
    blurs = (*BLURS_PX[: len(levels) - 1], 0.0)
    start: list[torch.Tensor] = []
    solution: Solution | None = None
    for number, (factor, blur) in enumerate(zip(levels, blurs, strict=True)):
        is_last = number == len(levels) - 1
        captures = Captures(
            setup, views, own, coordinates, factor, blur_px=blur, border_px=border_px,
            photons=_photons(scene.image_pixels // factor, is_last, photons), device=device,
        )  # fmt: skip
        name = f"{captures.pixels} x {captures.pixels}"

        def watch(iteration: int, cost: float, name: str = name) -> None:
            if progress is not None:
                progress(name, iteration, cost)

        captures.start_noise(x)
        if number == 0:
            x = _displaced(captures, coordinates, x)
            captures.start_noise(x)
        limits = coordinates.low, coordinates.high
        if not is_last:
            solution = minimised(captures, x, *limits, iterations=ITERATIONS, watch=watch)
            x, done = solution.x, done + solution.iterations
            continue
        start = captures.models_at(torch.zeros_like(x))
        solution = minimised(captures, x, *limits, iterations=iterations, watch=watch)
        done += solution.iterations
        captures.fit_noise(solution.x)
        solution = minimised(captures, solution.x, *limits, iterations=iterations, watch=watch)
        done += solution.iterations
        captures.fit_noise(solution.x)
    assert solution is not None
    normal = captures.normal(solution.x)
    information = normal.information + torch.eye(len(solution.x), dtype=torch.float64)
    finer = Captures(
        setup, views, own, coordinates, levels[-1], border_px=border_px, oversampling=OVERSAMPLING + 1,
        photons=int(MORE_PHOTONS * _photons(captures.pixels, True, photons)), device=device,
    )  # fmt: skip
    pull = captures.pull(solution.x, finer.models_at(solution.x))
    spread = posterior(information, captures.scores(solution.x), pull)
    found = found_numbers(setup, views, coordinates, solution, spread)
    fits = fits_of(captures, start, solution.x)
    count = len(setup.parameters)
    sigma = torch.tensor([f.sigma for f in found[:count]], dtype=torch.float64)
    deviation = spread.covariance.diagonal()[:count].sqrt()
    correlation = spread.covariance[:count, :count] / deviation[:, None] / deviation
    theta = coordinates.values(solution.x)[:count]
    return Calibration(
        setup, found, theta, correlation * sigma[:, None] * sigma, fits, solution.is_converged, done,
        warnings_of(found, fits, solution), information, spread,
    )  # fmt: skip


def _photons(pixels: int, is_last: bool, wished: int | None) -> int:
    if not is_last:
        return PHOTONS * pixels
    return wished or max(FINEST_PHOTONS * pixels, LEAST_PHOTONS)


def _check(scene: Scene, views: Sequence[View], border_px: int) -> None:
    if not views:
        raise InputError("no captures; give at least one of a plate that is known")
    names = [view.name for view in views]
    if len(set(names)) < len(names):
        raise InputError(f"captures share a name ({', '.join(sorted(names))[:80]}); rename one")
    for view in views:
        expected = (scene.n_wavelengths, scene.image_pixels, scene.image_pixels)
        if view.image.shape != expected:
            raise InputError(f"{view.name} has shape {list(view.image.shape)}, the scene {list(expected)}; resample it")
    if scene.image_pixels < LEAST_PIXELS or not 0 <= border_px < scene.image_pixels // 4:
        raise InputError(
            f"{scene.image_pixels} pixels with a border of {border_px} leave too little; use {LEAST_PIXELS} "
            "pixels or more and a border of 8 or so"
        )


def _all_numbers(setup: SetUp, views: Sequence[View]) -> tuple[list[Parameter], torch.Tensor, list[Own]]:
    """All parameters, what is believed of them, and where each view's own ones stand."""
    parameters = list(setup.parameters)
    before = setup.nominal.tolist()
    own = []
    for view in views:
        first = len(parameters)
        channels = len(view.image)
        for channel in range(channels):
            what = f"of channel {channel}, against what was expected"
            parameters.append(
                Parameter(f"brightness.{channel}", "b", "1", 1e-3, 1e3, view.brightness_prior, "camera", what)
            )
        before += [1.0] * channels
        plate = view.plate.parameters
        parameters += plate
        before += [0.0] * len(plate)
        own.append(Own(slice(first, first + channels), slice(first + channels, first + channels + len(plate))))
    return parameters, torch.tensor(before, dtype=torch.float64), own


def _displaced(captures: Captures, coordinates: Coordinates, x: torch.Tensor) -> torch.Tensor:
    """The start with the camera's shift that correlation finds, if it explains more."""
    names = [p.name for p in captures.setup.parameters]
    pair = [names.index(name) for name in ("shift_x_px", "shift_y_px") if name in names]
    if len(pair) < 2:
        return x
    shifts = []
    for k, model in enumerate(captures.models_at(x)):
        if captures.views[k].plate.kind != "flat":
            shifts.append(displacement_px(captures.images[k], model, captures.counts[k]))
    if not shifts:
        return x
    values = coordinates.values(x)
    values[pair] += captures.factor * torch.tensor(shifts, dtype=torch.float64).median(0).values
    moved = torch.minimum(torch.maximum(coordinates.to(values), coordinates.low), coordinates.high)
    return moved if captures.cost(moved) < captures.cost(x) else x
