"""Benches at random: ranges from which each sample draws its set-up, its camera and the kind of its print.

Pairs are intervals (lowest, highest) with uniform values, unless said otherwise. Set-up ranges are added to what the
scene says, so that one file of ranges serves any scene. The defaults are the ideal bench: every effect is off.
"""

import math
from typing import Annotated, Self

from pydantic import AfterValidator, Field, ValidationError, model_validator

from data_gen.config import PatternConfig, ReliefConfig
from data_gen.intervals import CountInterval, Interval, check_amount, check_order
from warp_caustics.scene import MAX_LENGTH_M, Scene, validation_lines
from warp_caustics.strict import Finite, Strict

LEAST_STEPS = 4.0
"""Of the converter that the light of a flat plate must fill, as for a single photo."""
MOST_SHIFT = 0.25
"""Of the window's width that a picture may be displaced by."""
CONE_MARGIN = 1.05
"""By how much a point source's cone is wider than the plate, seen from the lamp."""


def _share(value: tuple[float, float]) -> tuple[float, float]:
    if value[1] > 1:
        raise ValueError(f"upper end {value[1]:g} is above 1; shares lie between 0 and 1")
    return value


def _above_zero(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] <= 0:
        raise ValueError(f"lower end {value[0]:g} is not above 0; raise it")
    return value


def _distance(value: tuple[float, float]) -> tuple[float, float]:
    low, high = value
    if low <= 0:
        raise ValueError(f"lower end {low:g} m puts the lamp behind the plate's top (limit 0); raise it, as in 0.3")
    if high > MAX_LENGTH_M:
        raise ValueError(f"upper end {high:g} m is beyond {MAX_LENGTH_M:g} m; lower it, or use collimated light")
    return value


def _bits(value: tuple[int, int]) -> tuple[int, int]:
    if not 1 <= value[0] <= value[1] <= 16:
        raise ValueError(f"({value[0]}, {value[1]}) bits; give 1 to 16, the lower end first")
    return value


Span = Annotated[tuple[Finite, Finite], AfterValidator(check_order)]
Amount = Annotated[Span, AfterValidator(check_amount)]
ShareSpan = Annotated[Amount, AfterValidator(_share)]
PositiveSpan = Annotated[Span, AfterValidator(_above_zero)]
DistanceSpan = Annotated[Span, AfterValidator(_distance)]
BitSpan = Annotated[tuple[int, int], AfterValidator(_bits)]
Share = Annotated[Finite, Field(ge=0, le=1)]


class SetUpRanges(Strict):
    """What nobody on the bench measured: added to the scene."""

    gap_offset_m: Interval = (0.0, 0.0)
    """Added to the gap between plate and screen [m]."""
    base_offset_m: Interval = (0.0, 0.0)
    """Added to the thickness of the base [m]."""
    index_offset: Span = (0.0, 0.0)
    """Added to the index of the glass at 587.6 nm."""
    dispersion_scale: Span = (1.0, 1.0)
    """Dispersion over that of the named glass."""
    lamp_half_angle_rad: Amount | None = None
    """Half the angle under which the lamp is seen from the plate [rad], collimated or not; None: as the scene says."""
    tilt_rad: Amount = (0.0, 0.0)
    """Angle by which the light comes from aside [rad], in any direction, added to the scene's; the image is brought
    back onto the plate's outline."""
    point_share: Share | None = None
    """Of the samples have a point source, the others collimated light; None: as the scene says."""
    lamp_distance_m: DistanceSpan | None = None
    """From a point source to the plate's top [m], its inverse uniform; None: as the scene says."""
    fresnel_share: Share | None = None
    """Of the samples lose light to Fresnel's reflections; None: as the scene says."""

    def kinds_of_light(self, scene: Scene) -> tuple[bool, ...]:
        """Whether the light is a point source: one answer, or both."""
        if self.point_share is None:
            return (not scene.is_collimated,)
        return tuple(kind for kind, share in ((False, 1 - self.point_share), (True, self.point_share)) if share > 0)


class SensorRanges(Strict):
    """What is drawn anew in each photo, or differs between pixels."""

    exposure: PositiveSpan = (0.04, 0.04)
    """Part of full scale that a flat plate's light fills."""
    noise: Amount = (0.0, 0.0)
    """Standard deviation over mean of flat light in a photo; its logarithm uniform unless the lower end is 0."""
    read_share: ShareSpan = (0.0, 0.0)
    """Of the variance of that noise does not depend on the light."""
    calibration_frames: CountInterval = (16, 16)
    """Exposures, each as noisy as the photo, whose mean is the dark frame; the same for the flat frame."""
    black_level: ShareSpan = (0.0, 0.0)
    """What a pixel without light shows, as part of full scale."""
    bits: BitSpan = (16, 16)
    """Of the converter, whole numbers."""
    speckle_contrast: ShareSpan = (0.0, 0.0)
    """Standard deviation over mean of speckle, another in the flat frame."""
    speckle_width_px: PositiveSpan = (1.0, 1.0)
    """w [px]: speckle d pixels apart correlates by exp(-d^2 / (4 w^2))."""
    dust_grains: CountInterval = (0, 0)
    """Grains that darken photo and flat frame alike."""
    fresh_dust_grains: CountInterval = (0, 0)
    """Grains that fell after the flat frame was taken."""
    dust_radius_px: PositiveSpan = (1.0, 4.0)
    """Of each grain [px]."""
    dust_depth: ShareSpan = (0.1, 0.6)
    """Light that each grain takes."""
    hot_pixels: CountInterval = (0, 0)
    """Pixels that shine in the dark, on average."""
    hot_level: ShareSpan = (0.02, 0.5)
    """Of each, as part of full scale."""


class CameraRanges(Strict):
    """What a camera makes of the light on the screen; :mod:`warp_caustics.camera` says how."""

    psf_px: Amount = (0.0, 0.0)
    """Standard deviation of the lens's PSF [px]."""
    psf_apart: ShareSpan = (0.0, 0.0)
    """By how much, relative, that of a wavelength is larger or smaller."""
    box_px: Amount = (0.0, 0.0)
    """Width of a square that light is averaged over beyond the pixel's own [px]."""
    shift_px: Amount = (0.0, 0.0)
    """How far the whole picture is displaced [px], in any direction."""
    turn_rad: Span = (0.0, 0.0)
    """How far it is turned [rad]; other than 0 costs several times as much."""
    magnification: PositiveSpan = (1.0, 1.0)
    """Camera pixels per pixel of the window."""
    colours_apart_px: Amount = (0.0, 0.0)
    """How far the picture of each wavelength but the middle one is displaced besides [px], in any direction."""
    colour_scale: Amount = (0.0, 0.0)
    """By how much, at most, each of these is magnified or shrunk, relative."""
    unevenness: ShareSpan = (0.0, 0.0)
    """Largest coefficient of uneven light, of x, y, x^2, x y and y^2."""
    ambient: Amount = (0.0, 0.0)
    """Light that goes other ways, relative to that of a flat plate."""
    mixing: ShareSpan = (0.0, 0.0)
    """Of each channel's light is that of the other wavelengths."""
    gain: PositiveSpan = (1.0, 1.0)
    """Of each channel."""
    mosaic_share: Share = 0.0
    """Of the samples are taken through a mosaic of colour filters; needs three wavelengths."""
    calibrated_share: Share = 1.0
    """Of the photos are divided by their flat frame, both less the dark frame; of others only the black level is
    taken away and the exposure divided by."""
    sensor: SensorRanges = SensorRanges()


class PrintKind(Strict):
    """One kind of prints."""

    share: Annotated[Finite, Field(gt=0, le=1e6)] = 1.0
    """How often it is drawn, relative to the others."""
    reliefs: PatternConfig = ReliefConfig()
    """What is printed, and how."""


class BenchRanges(Strict):
    """Ranges of everything that may differ between benches."""

    set_up: SetUpRanges = SetUpRanges()
    camera: CameraRanges = CameraRanges()
    prints: tuple[PrintKind, ...] | None = None
    """Kinds of prints, one drawn for each sample; None: the configuration's reliefs."""

    @model_validator(mode="after")
    def _some_prints(self) -> Self:
        if self.prints is not None and not self.prints:
            raise ValueError("prints is empty; give at least one kind, or null for the configuration's reliefs")
        return self

    def check(self, scene: Scene) -> None:
        """Refuse ranges that reach what no bench on this scene can be.

        Raises:
            ValueError: value, limit and fix, one line.
        """
        self._check_set_up(scene)
        self._check_camera(scene)

    def _check_set_up(self, scene: Scene) -> None:
        ranges = self.set_up
        gap = -scene.screen_position_m[2]
        if gap + ranges.gap_offset_m[0] < 0:
            raise ValueError(
                f"bench.set_up.gap_offset_m: {ranges.gap_offset_m[0]:g} m puts the screen inside the plate, the gap is "
                f"{gap:g} m; give at least {-gap:g}"
            )
        base = scene.base_thickness_m
        if base + ranges.base_offset_m[0] <= 0:
            raise ValueError(
                f"bench.set_up.base_offset_m: {ranges.base_offset_m[0]:g} m leaves nothing of a base of {base:g} m; "
                f"give more than {-base:g}"
            )
        if ranges.point_share and scene.is_collimated and ranges.lamp_distance_m is None:
            raise ValueError(
                f"bench.set_up.point_share {ranges.point_share:g} of the samples have a point source, and the scene's "
                "light is collimated; give bench.set_up.lamp_distance_m, for example [0.3, 3]"
            )
        for is_point in self.set_up.kinds_of_light(scene):
            for end, words in enumerate(("lower ends", "upper ends")):
                try:
                    bench_scene(scene, **self._extreme(scene, end, is_point))
                except ValidationError as error:
                    raise ValueError(
                        f"bench.set_up at the {words} with the largest lamp and tilt: {validation_lines(error)[0]}"
                    ) from error

    def _extreme(self, scene: Scene, end: int, is_point: bool) -> dict[str, float]:
        """Lower (0) or upper (1) ends, with the nearest and largest lamp and the largest tilt."""
        ranges = self.set_up
        nearest = scene.light_distance_m if ranges.lamp_distance_m is None else ranges.lamp_distance_m[0]
        lamp = nominal_lamp_rad(scene) if ranges.lamp_half_angle_rad is None else ranges.lamp_half_angle_rad[1]
        return {
            "gap_m": ranges.gap_offset_m[end] - scene.screen_position_m[2],
            "base_thickness_m": ranges.base_offset_m[end] + scene.base_thickness_m,
            "index_offset": ranges.index_offset[end] + scene.index_offset,
            "dispersion_scale": ranges.dispersion_scale[end] * scene.dispersion_scale,
            "lamp_half_angle_rad": lamp,
            "tilt_x_rad": ranges.tilt_rad[1],
            "tilt_y_rad": 0.0,
            "lamp_distance_m": nearest,
            "is_point_source": float(is_point),
            "fresnel": 1.0,
        }

    def _check_camera(self, scene: Scene) -> None:
        ranges, sensor, pixels = self.camera, self.camera.sensor, scene.image_pixels
        if ranges.mosaic_share and scene.n_wavelengths != 3:
            raise ValueError(
                f"bench.camera.mosaic_share {ranges.mosaic_share:g} needs three wavelengths, the scene has "
                f"{scene.n_wavelengths}; set it to 0"
            )
        away = ranges.shift_px[1] + ranges.colours_apart_px[1]
        if away > MOST_SHIFT * pixels:
            raise ValueError(
                "bench.camera.shift_px and colours_apart_px: the camera sees nothing of parts of the window, "
                f"displaced by up to {away:g} of {pixels} px; give at most {MOST_SHIFT * pixels:g} together"
            )
        psf = ranges.psf_px[1] * (1 + ranges.psf_apart[1])
        if psf > pixels / 16:
            raise ValueError(
                f"bench.camera.psf_px: {psf:g} px is too wide for {pixels} px; give at most {pixels / 16:g}"
            )
        if ranges.box_px[1] > pixels / 4:
            raise ValueError(f"bench.camera.box_px: {ranges.box_px[1]:g} px is too wide; give at most {pixels / 4:g}")
        for name, (low, high), least, most in (
            ("magnification", ranges.magnification, 0.8, 1.25),
            ("turn_rad", ranges.turn_rad, -0.2, 0.2),
            ("colour_scale", ranges.colour_scale, 0.0, 0.05),
            ("sensor.speckle_width_px", sensor.speckle_width_px, 0.0, 8.0),
            ("sensor.dust_radius_px", sensor.dust_radius_px, 0.0, pixels / 2),
            ("ambient", ranges.ambient, 0.0, 100.0),
        ):
            if low < least or high > most:
                raise ValueError(f"bench.camera.{name}: ({low:g}, {high:g}); give values from {least:g} to {most:g}")
        faint = ranges.gain[0] * (1 - ranges.mixing[1]) * (1 - 4 * ranges.unevenness[1])
        steps = sensor.exposure[0] * (2 ** sensor.bits[0] - 1) * max(faint, 0.0)
        if steps < LEAST_STEPS:
            raise ValueError(
                "the camera sees nothing: at the lower ends of exposure, bits and gain a flat plate's light fills "
                f"{steps:.2g} steps in the darkest corner (limit {LEAST_STEPS:g}); raise "
                f"bench.camera.sensor.exposure[0] above {sensor.exposure[0]:g}, or sensor.bits[0] above "
                f"{sensor.bits[0]}, or lower unevenness"
            )
        bright = sensor.exposure[1] * ranges.gain[1] * (1 + ranges.ambient[1]) * (1 + 4 * ranges.unevenness[1])
        if bright + sensor.black_level[1] > 1:
            raise ValueError(
                f"a flat plate saturates the camera: at the upper ends its light fills {bright:.3g} of full scale "
                f"(limit {1 - sensor.black_level[1]:g}); lower bench.camera.sensor.exposure[1] from "
                f"{sensor.exposure[1]:g}, a twentieth of full scale suits a caustic"
            )
        if sensor.calibration_frames[0] < 1:
            raise ValueError("bench.camera.sensor.calibration_frames: 0 frames are none; give at least 1")
        if sensor.noise[1] > 0.5:
            raise ValueError(
                f"bench.camera.sensor.noise: {sensor.noise[1]:g} of flat light hides a caustic; give at most 0.5"
            )


def nominal_lamp_rad(scene: Scene) -> float:
    """Half the angle under which a scene's lamp is seen from the plate [rad]."""
    if scene.is_collimated:
        return scene.lamp_half_angle_rad
    return math.atan(scene.lamp_radius_m / scene.light_distance_m)


def bench_scene(
    scene: Scene,
    *,
    gap_m: float,
    base_thickness_m: float,
    index_offset: float,
    dispersion_scale: float,
    is_point_source: float,
    lamp_distance_m: float,
    lamp_half_angle_rad: float,
    tilt_x_rad: float,
    tilt_y_rad: float,
    fresnel: float,
) -> Scene:
    """The scene of one bench.

    The window stays below the plate's image, as a photo is brought onto the plate's outline: where tilted light moves
    it, by the middle wavelength's shift, or a point source aside, by the way of the ray through the plate's centre.

    Args:
        scene: what all benches share.
        gap_m: plate to screen [m].
        base_thickness_m: d [m].
        index_offset: of the glass.
        dispersion_scale: of the glass.
        is_point_source: 1, or 0 for collimated light.
        lamp_distance_m: of a point source from the plate's top [m].
        lamp_half_angle_rad: of the lamp, seen from the plate [rad].
        tilt_x_rad: towards which the light travels along x besides [rad].
        tilt_y_rad: along y [rad].
        fresnel: 1 or 0.
    """
    tree = dict(scene)
    x, y = scene.screen_position_m[:2]
    tree |= {
        "base_thickness_m": base_thickness_m,
        "index_offset": index_offset,
        "dispersion_scale": dispersion_scale,
        "fresnel": fresnel > 0,
        "screen_position_m": (x, y, -gap_m),
    }
    nominal = scene.light_tilt_rad
    if is_point_source > 0:
        # Light travels away from where the lamp stands.
        centre = (0.0, 0.0) if scene.is_collimated else scene.light_position_m[:2]
        lamp_x, lamp_y = (
            at - lamp_distance_m * math.tan(tilt) for at, tilt in zip(centre, (tilt_x_rad, tilt_y_rad), strict=True)
        )
        if scene.is_collimated:
            width, length = scene.plate_size_m
            lit = CONE_MARGIN * math.hypot(width / 2 + abs(lamp_x), length / 2 + abs(lamp_y))
        else:
            # A source that is moved lights what the scene's does.
            moved = math.hypot(lamp_x - centre[0], lamp_y - centre[1])
            lit = scene.light_distance_m * math.tan(scene.emission_half_angle_rad) + moved
        cone = math.atan(lit / lamp_distance_m) if lamp_distance_m > 0 else scene.emission_half_angle_rad
        tree |= {
            "emission_half_angle_rad": cone,
            "light_position_m": (lamp_x, lamp_y, base_thickness_m + lamp_distance_m),
            "light_tilt_rad": (0.0, 0.0),
            "lamp_half_angle_rad": 0.0,
            "lamp_radius_m": lamp_distance_m * math.tan(lamp_half_angle_rad),
        }
    else:
        tree |= {
            "emission_half_angle_rad": 0.0,
            "light_tilt_rad": (nominal[0] + tilt_x_rad, nominal[1] + tilt_y_rad),
            "lamp_half_angle_rad": lamp_half_angle_rad,
            "lamp_radius_m": 0.0,
        }
    bench = Scene.model_validate(tree)
    if tilt_x_rad == 0 and tilt_y_rad == 0:
        return bench
    middle = scene.n_wavelengths // 2
    there, here = (
        bench.model_copy(update={"light_tilt_rad": tilt}).flat_shift_m[middle]
        for tilt in ((nominal[0] + tilt_x_rad, nominal[1] + tilt_y_rad), nominal)
    )
    return bench.model_copy(update={"screen_position_m": (x + there[0] - here[0], y + there[1] - here[1], -gap_m)})
