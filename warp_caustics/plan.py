"""What a set-up will show, before anything is printed: does the caustic fold, how sharp is it, how bright.

A fibre is a cylindrical lens. Where its crown's light meets first, light paths begin to cross; a reconstruction from
one image is then ambiguous. Closed forms hold for gentle slopes and light that comes from straight above; the check
traces light through the whole section exactly.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

SMALLEST_FIBRE_M, LARGEST_FIBRE_M = 1e-7, 0.1
"""Wider or higher is no fibre but a unit mistake [m]."""

RAYS = 200_001
"""Across half a fibre: the brightest pixel is known to a percent."""

SHARP_PX = 0.5
"""Blur, a standard deviation, that an image hardly shows [px]; docs/capture.md has what blur costs."""

BLURRED_PX = 1.0

FINE_SAMPLES = 4.0
"""Height samples across a fibre from which its section is told [1]."""

MANY_PIXELS = 8.0
"""Pixels across a fibre's caustic from which a reconstruction has something to see."""

NEAREST_SCREEN_M = 1e-4
"""A screen nearer than this cannot be set up; it has to touch [m]."""

TOP_OF_RANGE = 0.8
"""Share of a camera's range that the brightest pixel should take."""

Rating = Literal["good", "fair", "bad"]


@dataclass(frozen=True)
class Fibre:
    """A printed line of the raised cosine H/2 (1 + cos(2 pi r / w)).

    Attributes:
        width_m: full width w [m].
        height_m: H [m].
    """

    width_m: float
    height_m: float

    def __post_init__(self) -> None:
        for name, value in (("width", self.width_m), ("height", self.height_m)):
            if not SMALLEST_FIBRE_M <= value <= LARGEST_FIBRE_M:
                raise InputError(
                    f"fibre {name} {value:g} m is not between {SMALLEST_FIBRE_M:g} and {LARGEST_FIBRE_M:g} m; "
                    "write 2mm or so"
                )


@dataclass(frozen=True)
class Advice:
    """One finding in plain words.

    Attributes:
        topic: what it is about.
        rating: good, fair or bad.
        text: what is, and what to do.
    """

    topic: str
    rating: Rating
    text: str


@dataclass(frozen=True)
class Plan:
    """What a fibre will show in a set-up; distances below the plate's bottom face, middle wavelength.

    Attributes:
        focus_m: distance of the screen at which light paths first cross, closed form for gentle slopes [m]; negative
            where they cross within the plate.
        traced_focus_m: the same with exact refraction [m].
        folds: whether they cross at the scene's screen, by exact refraction.
        highest_unfolded_m: height of a fibre of this width that just does not fold at this screen, closed form [m];
            infinite where nothing focuses.
        farthest_shift_m: how far a fibre's light moves sideways at most [m].
        lamp_blur_m: standard deviation of the lamp's image on the screen [m].
        lamp_blur_px: the same in pixels of the scene.
        caustic_px: extent of a fibre's light on the screen, across it, in pixels of the scene.
        samples_per_width: height samples of the scene across the fibre.
        brightest: brightest pixel, in units of the light through a flat plate.
        darkest: darkest pixel that the fibre's light leaves, in the same units.
        flat_level: share of the camera's range that a flat plate should take for the brightest pixel to keep 20 % free.
        advice: in plain words, what matters most first.
    """

    focus_m: float
    traced_focus_m: float
    folds: bool
    highest_unfolded_m: float
    farthest_shift_m: float
    lamp_blur_m: float
    lamp_blur_px: float
    caustic_px: float
    samples_per_width: float
    brightest: float
    darkest: float
    flat_level: float
    advice: tuple[Advice, ...] = ()


def plan(scene: Scene, fibre: Fibre, lamp_half_angle_rad: float = 0.0) -> Plan:
    """What a single straight fibre in the middle of the plate will show.

    Args:
        scene: the set-up; a point source counts where it is.
        fibre: what is printed.
        lamp_half_angle_rad: half the angle that the lamp is seen under from the plate [rad].

    Raises:
        InputError: a fibre that is none, or a lamp that fills half the sky.
    """
    if not 0 <= lamp_half_angle_rad < math.pi / 4:
        raise InputError(
            f"lamp half-angle {lamp_half_angle_rad:g} rad is not between 0 and {math.pi / 4:.2f}; "
            "give diameter and distance of the lamp, or focal length of the collimator"
        )
    landing, start = _traced(scene, fibre)
    pixel_m = max(scene.pixel_size_m)
    blur_m = _lamp_blur_m(scene, fibre, lamp_half_angle_rad)
    bright, dark = _extremes(start, landing, pixel_m, blur_m)
    lit = start < fibre.width_m / 2
    inside = landing[lit]
    shift_m = float(np.abs(inside - start[lit] * magnification(scene)).max())
    reach_m = max(float(np.abs(inside).max()), fibre.width_m / 2 * magnification(scene))
    found = Plan(
        focus_m=focus_distance_m(scene, fibre),
        traced_focus_m=traced_focus_m(scene, fibre),
        folds=bool((np.diff(landing) < 0).any()),
        highest_unfolded_m=highest_unfolded_m(scene, fibre.width_m),
        farthest_shift_m=shift_m,
        lamp_blur_m=blur_m,
        lamp_blur_px=blur_m / pixel_m,
        caustic_px=2 * reach_m / pixel_m,
        samples_per_width=fibre.width_m / max(scene.sample_pitch_m),
        brightest=bright,
        darkest=dark,
        flat_level=TOP_OF_RANGE / max(1.0, bright),
    )
    return replace(found, advice=tuple(advice_on(found, scene)))


def focus_distance_m(scene: Scene, fibre: Fibre) -> float:
    """Distance below the plate at which a fibre's crown focuses [m], for gentle slopes.

    The crown of H/2 (1 + cos(2 pi r / w)) has the curvature 2 pi^2 H / w^2 and bends light towards its axis by (n - 1)
    times the slope (in glass and behind it, each over its own index), so that paths r (1 - (n - 1) kappa D) meet
    at the optical distance D = (d + H) / n + z / n_out = 1 / ((n - 1) kappa - 1 / L), L being that of a point source.
    """
    glass, outside = _indices(scene)
    spread = 0.0 if scene.is_collimated else 1 / _distance_to_light_m(scene)
    power = (glass - 1) * 2 * math.pi**2 * fibre.height_m / fibre.width_m**2 - spread
    if power <= 0:
        return math.inf
    return outside * (1 / power - (scene.base_thickness_m + fibre.height_m) / glass)


def highest_unfolded_m(scene: Scene, width_m: float) -> float:
    """Height of a fibre of a width whose crown focuses just on the screen [m], for gentle slopes.

    With D0 = d / n + z / n_out and power p = (n - 1) 2 pi^2 / w^2 per height: p H (D0 + H / n) = 1 + D0 / L.
    """
    glass, outside = _indices(scene)
    optical_m = scene.base_thickness_m / glass - scene.screen_position_m[2] / outside
    power = (glass - 1) * 2 * math.pi**2 / width_m**2
    first, second = power * optical_m, power / glass
    spread = 1 + optical_m / _distance_to_light_m(scene)
    # The root of a quadratic, written so that nothing cancels.
    return 2 * spread / (first + math.sqrt(first**2 + 4 * second * spread))


def magnification(scene: Scene) -> float:
    """Of a shadow on the screen: 1 in collimated light."""
    if scene.is_collimated:
        return 1.0
    glass, outside = _indices(scene)
    optical_m = scene.base_thickness_m / glass - scene.screen_position_m[2] / outside
    return 1.0 + optical_m / _distance_to_light_m(scene)


def traced_focus_m(scene: Scene, fibre: Fibre) -> float:
    """Distance below the plate at which neighbouring light paths of a section first cross [m], by exact refraction.

    Paths are straight below the plate: each pair meets where its distance, linear in the depth, is 0. Negative where
    they have met within the plate.
    """
    near, start = _traced(scene, fibre, 0.0)
    far, _ = _traced(scene, fibre, 1.0)
    lit = start < fibre.width_m / 2
    here, growth = np.diff(near[lit]), np.diff(far[lit]) - np.diff(near[lit])
    if (here <= 0).any():
        return min(0.0, focus_distance_m(scene, fibre))
    closing = growth < 0
    return float((here[closing] / -growth[closing]).min()) if closing.any() else math.inf


def _indices(scene: Scene) -> tuple[float, float]:
    middle = int(np.argsort(scene.wavelengths_m)[scene.n_wavelengths // 2])
    return scene.glass_indices[middle], scene.exit_indices[middle]


def _distance_to_light_m(scene: Scene) -> float:
    return math.inf if scene.is_collimated else scene.light_position_m[2] - scene.base_thickness_m


def _lamp_blur_m(scene: Scene, fibre: Fibre, half_angle_rad: float) -> float:
    """Standard deviation of the lamp's image [m]: a disc of radius a has a / 2 along each axis."""
    glass, outside = _indices(scene)
    height_m = scene.base_thickness_m + fibre.height_m / 2
    radius_m = half_angle_rad * (height_m / glass - scene.screen_position_m[2] / outside)
    return radius_m / 2


def _traced(scene: Scene, fibre: Fibre, gap_m: float | None = None) -> tuple[FloatArray, FloatArray]:
    """Where light across one half of a fibre and its bare neighbourhood lands, and where it starts [m], shape [N]."""
    gap_m = -scene.screen_position_m[2] if gap_m is None else gap_m
    glass, outside = _indices(scene)
    half = fibre.width_m / 2
    start = np.linspace(0.0, 2 * half, RAYS)
    phase = np.where(start < half, 2 * np.pi * start / fibre.width_m, np.pi)
    height = scene.base_thickness_m + fibre.height_m / 2 * (1 + np.cos(phase))
    tilt = np.arctan(fibre.height_m * np.pi / fibre.width_m * np.sin(phase))  # of the normal, away from the axis
    light_m = math.inf if scene.is_collimated else scene.light_position_m[2]
    falling = np.zeros_like(start) if math.isinf(light_m) else np.arctan2(start, light_m - height)
    within = np.arcsin(np.sin(falling + tilt) / glass) - tilt
    sine = np.clip(np.sin(within) * glass / outside, -0.999999, 0.999999)  # beyond, light is totally reflected
    return start + height * np.tan(within) + gap_m * np.tan(np.arcsin(sine)), start


def _extremes(start: FloatArray, landing: FloatArray, pixel_m: float, blur_m: float) -> tuple[float, float]:
    """Brightest and darkest pixel across a fibre, in units of the light through a flat plate."""
    from scipy import ndimage

    fine = pixel_m / 16
    both, weight = np.concatenate([landing, -landing]), (start[1] - start[0]) / fine
    reach = float(start[-1]) * 0.95
    cells = max(64, min(400_000, round(2 * reach / fine)))
    light, edges = np.histogram(both, bins=cells, range=(-reach, reach))
    step = edges[1] - edges[0]
    seen = light * weight * fine / step
    if blur_m > 0:
        seen = ndimage.gaussian_filter1d(seen, blur_m / step, mode="nearest")
    seen = ndimage.uniform_filter1d(seen, max(1, round(pixel_m / step)), mode="nearest")
    inner = seen[len(seen) // 40 : -(len(seen) // 40) or None]
    return float(inner.max()), float(inner.min())


def advice_on(found: Plan, scene: Scene) -> list[Advice]:
    """What a plan means, what matters most first."""
    return [_of_folds(found, -scene.screen_position_m[2]), _of_blur(found), _of_size(found), _of_exposure(found)]


def _of_folds(found: Plan, gap_m: float) -> Advice:
    if not found.folds:
        text = f"Light paths do not cross: the first focus is {told_m(found.traced_focus_m)} below the plate."
        if math.isinf(found.traced_focus_m):
            text = "Light paths never cross."
        return Advice("folds", "good", text)
    where = (
        f"{told_m(found.traced_focus_m)} below the plate" if found.traced_focus_m > 0 else "within the plate already"
    )
    if found.traced_focus_m > NEAREST_SCREEN_M:
        nearer = f"move the screen to {told_m(0.8 * found.traced_focus_m)}, or print "
    else:
        nearer = f"no distance of the screen helps (it is at {told_m(gap_m)}): print "
    lower = f"lower than {told_m(0.8 * found.highest_unfolded_m)} at this width"
    return Advice(
        "folds",
        "fair",
        f"Light paths cross: the first focus is {where}. One image then has several reliefs; 'direct' and 'fibres' "
        f"know printed lines and choose. To be sure {nearer}{lower}.",
    )


def _of_blur(found: Plan) -> Advice:
    size = f"The lamp blurs the caustic by {told_m(found.lamp_blur_m)}, {found.lamp_blur_px:.2g} pixels."
    if found.lamp_blur_px <= SHARP_PX:
        return Advice("lamp", "good", size)
    factor = found.lamp_blur_px / SHARP_PX
    todo = f"A lamp {factor:.2g} times smaller or farther, or a nearer screen, makes that {SHARP_PX:g}."
    return Advice("lamp", "fair" if found.lamp_blur_px <= BLURRED_PX else "bad", f"{size} {todo}")


def _of_size(found: Plan) -> Advice:
    size = (
        f"A fibre's light covers {found.caustic_px:.3g} pixels across, the fibre itself {found.samples_per_width:.2g} "
        "height samples."
    )
    if found.caustic_px < MANY_PIXELS:
        return Advice("size", "bad", f"{size} Below {MANY_PIXELS:g} pixels little is seen: raise scene.image_pixels.")
    if found.samples_per_width < FINE_SAMPLES:
        todo = f"Below {FINE_SAMPLES:g} samples its section is lost: raise scene.height_samples."
        return Advice("size", "fair", f"{size} {todo}")
    return Advice("size", "good", size)


def _of_exposure(found: Plan) -> Advice:
    text = (
        f"The brightest pixel has {found.brightest:.3g} times the light of a flat plate, the darkest "
        f"{found.darkest:.2g}. Expose so that a flat plate is at {100 * found.flat_level:.2g} % of the range, the "
        f"brightest pixel at {100 * TOP_OF_RANGE:g} %"
    )
    if found.brightest <= 10:
        return Advice("exposure", "good", f"{text}.")
    return Advice("exposure", "fair", f"{text}; take two or three exposures, a factor of 4 apart (--exposure-times).")


def told_m(length_m: float) -> str:
    """A length for people."""
    if math.isinf(length_m):
        return "nowhere"
    for unit, metres in (("m", 1.0), ("mm", 1e-3)):
        if abs(length_m) >= metres:
            return f"{length_m / metres:.3g} {unit}"
    return f"{length_m * 1e6:.3g} um"
