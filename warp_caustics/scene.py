"""The optical set-up that is not differentiated: Tab. 1 of the N-SfC supplement.

Frame: z points up, the plate's flat bottom face is z = 0, its nominal top is
z = d, the printed relief h(x, y) sits on top, light comes from above along -z.
Arrays are indexed [row, column]; row grows with +y, column with +x; sample
(i, j) sits at the centre of its cell. All quantities are in SI units, and the
name of each field carries its unit.
"""

import math
from collections.abc import Callable
from typing import Annotated, Any, Literal

import pydantic
from pydantic import AfterValidator, Field, field_validator, model_validator

from warp_caustics.errors import known_names, shortened
from warp_caustics.materials import GLASS_NAMES, MAX_WAVELENGTH_M, MIN_WAVELENGTH_M, melt_index, refractive_index
from warp_caustics.strict import Finite, Strict

MIN_PHYSICAL_INDEX, MAX_PHYSICAL_INDEX = 1.0, 4.0
MAX_LENGTH_M = 10.0
MAX_PLATE_M = 1.0
MAX_LAMP_HALF_ANGLE_RAD = 0.2
"""Largest lamp seen from the plate, half the angle [rad]: blur by its second moment, to first order."""

MAX_TILT_RAD = 0.25
"""Largest tilt of collimated light along an axis [rad]: slopes of up to 4, the steepest of printed lines, are lit."""

MIN_RADIOSITY_W_M2, MAX_RADIOSITY_W_M2 = 1e-12, 1e12
"""Beyond, squares of an irradiance leave 32-bit floats."""


def _check_index(value: str | float) -> str | float:
    if isinstance(value, str):
        return value
    if not MIN_PHYSICAL_INDEX <= value <= MAX_PHYSICAL_INDEX:
        raise ValueError(
            f"refractive index {value:g} is outside {MIN_PHYSICAL_INDEX:g} to {MAX_PHYSICAL_INDEX:g}; "
            "common glasses lie between 1.45 and 1.9"
        )
    return value


def _check_wavelength(value: float) -> float:
    if not MIN_WAVELENGTH_M <= value <= MAX_WAVELENGTH_M:
        hint = f"; did you mean {value * 1e-9:g} ({value:g} nm)?" if 200 <= value <= 2500 else ""
        raise ValueError(
            f"{value:g} m is no wavelength between {MIN_WAVELENGTH_M:g} and {MAX_WAVELENGTH_M:g} m"
            f"{hint or '; give metres'}"
        )
    return value


def _check_plate_length(value: float) -> float:
    if not 0 < value <= MAX_PLATE_M:
        hint = f"; did you mean {value * 1e-3:g} ({value:g} mm)?" if MAX_PLATE_M < value <= 1e3 * MAX_PLATE_M else ""
        raise ValueError(f"{value:g} m is not between 0 (exclusive) and {MAX_PLATE_M:g} m{hint or '; give metres'}")
    return value


def _check_radiosity(value: float) -> float:
    if value != 0 and not MIN_RADIOSITY_W_M2 <= value <= MAX_RADIOSITY_W_M2:
        raise ValueError(
            f"{value:g} W/m^2 is neither 0 nor between {MIN_RADIOSITY_W_M2:g} and {MAX_RADIOSITY_W_M2:g} W/m^2; "
            "sunlight has 1000, and 1 suits an image that is not calibrated"
        )
    return value


LATER_FIELDS = (
    "light_tilt_rad", "lamp_half_angle_rad", "lamp_radius_m", "fresnel", "second_hits", "index_offset",
    "dispersion_scale",
)  # fmt: skip
"""Fields that data sets and weights of the first format do not know."""

Wavelength = Annotated[Finite, AfterValidator(_check_wavelength)]
PlateLength = Annotated[Finite, AfterValidator(_check_plate_length)]
Radiosity = Annotated[Finite, AfterValidator(_check_radiosity)]
Medium = Annotated[str | Finite, AfterValidator(_check_index)]


class Scene(Strict):
    """Non-differentiable scene parameters (Tab. 1), validated and immutable.

    Unknown fields are refused. Lengths are metres, angles radians. ``n_l`` and
    ``s`` of Tab. 1 belong to the simulator, not to the scene.
    """

    height_samples: Annotated[int, Field(ge=2, le=4096, description="n: samples per side of the height map")] = 128
    image_pixels: Annotated[int, Field(ge=2, le=8192, description="m: pixels per side of the caustic image")] = 512
    base_thickness_m: PlateLength = 3e-3
    """d: thickness of the plate without relief [m]."""
    plate_size_m: tuple[PlateLength, PlateLength] = (0.05, 0.05)
    """(h_x, h_y): extent of the plate along x and y [m]; the image window has the same size."""
    wavelengths_m: Annotated[tuple[Wavelength, ...], Field(min_length=1, max_length=64)] = (610e-9, 530e-9, 430e-9)
    """Wavelengths [m], shape [n_w]; their order is the order of the image channels."""
    radiosity_W_m2: tuple[Radiosity, ...] = (1.0, 1.0, 1.0)
    """L_i: irradiance that a flat plate lets through, per wavelength [W/m^2], shape [n_w]."""
    emission_half_angle_rad: Annotated[Finite, Field(ge=0, lt=math.pi / 2)] = 0.0
    """alpha: 0 is collimated light; above 0 a point source at ``light_position_m`` lights a cone of this half-angle."""
    light_position_m: tuple[Finite, Finite, Finite] = (0.0, 0.0, 1.0)
    """L_p: position of the point source [m]; unused for collimated light."""
    screen_position_m: tuple[Finite, Finite, Finite] = (0.0, 0.0, -1e-6)
    """S_p: centre of the image window [m]; its z is the plane of the screen, at or below the plate."""
    glass: Medium = "fused_silica"
    """Glass of plate and relief: a name or a constant refractive index."""
    exit_medium: Medium = "air"
    """Medium between plate and screen: ``"air"``, ``"glass"`` (screen in optical contact), a glass name or an index."""
    light_tilt_rad: tuple[Finite, Finite] = (0.0, 0.0)
    """(a_x, a_y): collimated light travels along (tan a_x, tan a_y, -1) [rad]; plate, relief and window stay."""
    lamp_half_angle_rad: Annotated[Finite, Field(ge=0)] = 0.0
    """Half the angle under which collimated light's round lamp is seen from the plate [rad]; 0 is a point."""
    lamp_radius_m: Annotated[Finite, Field(ge=0)] = 0.0
    """Radius of a point source's lamp, a level disc at ``light_position_m`` [m]; 0 is a point."""
    fresnel: bool = False
    """Whether steep glass reflects more: Fresnel's losses at both faces, relative to a flat plate."""
    second_hits: Literal["ignored", "passed", "lost"] = "ignored"
    """Light inside the glass that meets the relief again: not looked for, found and let through, or lost."""
    index_offset: Annotated[Finite, Field(ge=-0.2, le=0.2)] = 0.0
    """Of the plate's index at 587.6 nm against what ``glass`` says: melts differ by up to 0.001."""
    dispersion_scale: Annotated[Finite, Field(ge=-2, le=4)] = 1.0
    """Dispersion of the plate over that of the named ``glass``; 0 is glass without dispersion."""

    @field_validator("glass")
    @classmethod
    def _known_glass(cls, value: str | float) -> str | float:
        if isinstance(value, str) and value not in GLASS_NAMES:
            raise ValueError(f"glass {value!r} is neither known nor a number; {known_names(value, GLASS_NAMES)}")
        return value

    @field_validator("exit_medium")
    @classmethod
    def _known_exit(cls, value: str | float) -> str | float:
        known = ("air", "vacuum", "glass", *GLASS_NAMES)
        if isinstance(value, str) and value not in known:
            raise ValueError(f"exit medium {value!r} is neither known nor a number; {known_names(value, known)}")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> "Scene":
        if len(self.radiosity_W_m2) != len(self.wavelengths_m):
            raise ValueError(
                f"{len(self.radiosity_W_m2)} radiosities for {len(self.wavelengths_m)} wavelengths; "
                "give one per wavelength"
            )
        if sum(self.radiosity_W_m2) == 0:
            raise ValueError("all radiosities are 0, the image would be black; give at least one above 0")
        if len(set(self.wavelengths_m)) != len(self.wavelengths_m):
            raise ValueError(f"wavelengths repeat: {self.wavelengths_m}; give each once")
        z = self.screen_position_m[2]
        if not -MAX_LENGTH_M <= z <= 0:
            where = "inside or above the plate" if z > 0 else "too far away"
            raise ValueError(
                f"screen at z = {z:g} m is {where}; the plate's bottom is z = 0, "
                f"use {-MAX_LENGTH_M:g} to 0, for example -1e-6"
            )
        if self.emission_half_angle_rad > 0 and self.light_position_m[2] <= self.base_thickness_m:
            raise ValueError(
                f"light at z = {self.light_position_m[2]:g} m is inside or below the plate "
                f"(top at {self.base_thickness_m:g} m); raise it"
            )
        if self.emission_half_angle_rad > 0:
            lit = (self.light_position_m[2] - self.base_thickness_m) * math.tan(self.emission_half_angle_rad)
            beside = [
                max(0.0, abs(at) - size / 2)
                for at, size in zip(self.light_position_m[:2], self.plate_size_m, strict=True)
            ]
            if math.hypot(*beside) >= lit:
                raise ValueError(
                    f"light misses the plate by {math.hypot(*beside) - lit:.3g} m: its cone lights a disc of radius "
                    f"{lit:.3g} m around ({self.light_position_m[0]:g}, {self.light_position_m[1]:g}) m; move "
                    "scene.light_position_m above the plate, or raise scene.emission_half_angle_rad"
                )
        if min(self.glass_indices) <= 1.0:
            at = self.wavelengths_m[self.glass_indices.index(min(self.glass_indices))]
            raise ValueError(
                "a glass of index 1 refracts no light; give an index above 1"
                if self.glass_indices.count(1.0)
                else f"glass of index {min(self.glass_indices):g} at {at:g} m is thinner than air; raise "
                f"scene.index_offset from {self.index_offset:g}"
            )
        self._check_lamp()
        return self

    def _check_lamp(self) -> None:
        """A lamp and a tilt that the model holds for."""
        if not self.is_collimated:
            if self.is_tilted or self.lamp_half_angle_rad:
                key, value = ("light_tilt_rad", list(self.light_tilt_rad)) if self.is_tilted else (
                    "lamp_half_angle_rad", self.lamp_half_angle_rad
                )  # fmt: skip
                instead = "light_position_m" if self.is_tilted else "lamp_radius_m"
                raise ValueError(f"{key} {value} is for collimated light; for a point source set scene.{instead}")
            largest = MAX_LAMP_HALF_ANGLE_RAD * self.light_distance_m
            if self.lamp_radius_m > largest:
                raise ValueError(
                    f"lamp of radius {self.lamp_radius_m:g} m is too large for its distance of "
                    f"{self.light_distance_m:g} m from the plate; use at most {largest:.3g}, or move "
                    "scene.light_position_m away"
                )
            return
        if self.lamp_radius_m:
            raise ValueError(
                f"lamp_radius_m {self.lamp_radius_m:g} is for a point source; for collimated light set "
                "scene.lamp_half_angle_rad, the lamp's radius over the collimator's focal length"
            )
        if max(map(abs, self.light_tilt_rad)) > MAX_TILT_RAD:
            raise ValueError(
                f"light_tilt_rad {list(self.light_tilt_rad)} is beyond {MAX_TILT_RAD:g}, where slopes of the relief "
                f"throw shadows that are not modelled; use -{MAX_TILT_RAD:g} to {MAX_TILT_RAD:g} (1 degree is 0.01745)"
            )
        if self.lamp_half_angle_rad > MAX_LAMP_HALF_ANGLE_RAD:
            behind = self.lamp_half_angle_rad + math.acos(-self.light_direction[2]) >= math.pi / 2
            why = "reaches behind the plate" if behind else "is too large for the model, which is of first order"
            raise ValueError(
                f"lamp of half angle {self.lamp_half_angle_rad:g} rad {why}; use at most "
                f"{MAX_LAMP_HALF_ANGLE_RAD:g} (1 degree is 0.01745)"
            )

    def record(self) -> dict[str, Any]:
        """JSON values of what defines the scene, for files and hashes.

        Without :data:`LATER_FIELDS` that have their default: what was written before they were there stays the same.
        """
        usual = {key for key in LATER_FIELDS if getattr(self, key) == Scene.model_fields[key].default}
        return self.model_dump(mode="json", exclude=usual)

    @property
    def n_wavelengths(self) -> int:
        """n_w, the number of image channels."""
        return len(self.wavelengths_m)

    @property
    def is_collimated(self) -> bool:
        return self.emission_half_angle_rad == 0.0

    @property
    def is_tilted(self) -> bool:
        return any(self.light_tilt_rad)

    @property
    def light_direction(self) -> tuple[float, float, float]:
        """Unit vector along which collimated light travels."""
        x, y = (math.tan(angle) for angle in self.light_tilt_rad)
        length = math.sqrt(x * x + y * y + 1)
        return x / length, y / length, -1 / length

    @property
    def light_distance_m(self) -> float:
        """Distance of the point source from the nominal top of the plate [m]."""
        return self.light_position_m[2] - self.base_thickness_m

    @property
    def flat_shift_m(self) -> tuple[tuple[float, float], ...]:
        """By how much tilted light moves the image of a flat plate along x and y, per wavelength [m], shape [n_w, 2].

        The window stays where ``screen_position_m`` says; moved by this it is below the plate's image again.
        """
        x, y, _ = self.light_direction
        found = []
        for glass, outside in zip(self.glass_indices, self.exit_indices, strict=True):
            sine2 = x * x + y * y
            way = self.base_thickness_m / math.sqrt(glass**2 - sine2)
            way -= self.screen_position_m[2] / math.sqrt(outside**2 - sine2)
            found.append((x * way, y * way))
        return tuple(found)

    @property
    def plate_area_m2(self) -> float:
        """A: area of the plate [m^2]."""
        return self.plate_size_m[0] * self.plate_size_m[1]

    @property
    def pixel_size_m(self) -> tuple[float, float]:
        """Extent of an image pixel along x and y [m]."""
        return self.plate_size_m[0] / self.image_pixels, self.plate_size_m[1] / self.image_pixels

    @property
    def sample_pitch_m(self) -> tuple[float, float]:
        """Distance of neighbouring height samples along x and y [m]."""
        return self.plate_size_m[0] / self.height_samples, self.plate_size_m[1] / self.height_samples

    @property
    def glass_indices(self) -> tuple[float, ...]:
        """Refractive index of the plate per wavelength, shape [n_w]."""
        return tuple(melt_index(self.glass, w, self.index_offset, self.dispersion_scale) for w in self.wavelengths_m)

    @property
    def exit_indices(self) -> tuple[float, ...]:
        """Refractive index between plate and screen per wavelength, shape [n_w]."""
        if self.exit_medium == "glass":
            return self.glass_indices
        return tuple(refractive_index(self.exit_medium, w) for w in self.wavelengths_m)


Placement = Literal["lattice", "stratified", "sobol", "random"]
Profile = Literal["gaussian", "spline"]


def _shortened(value: object) -> str:
    """A value for a message; of a number with thousands of digits Python makes no text."""
    try:
        return shortened(repr(value))
    except (ValueError, RecursionError):
        return "a number too long to show"


def validation_lines(
    error: pydantic.ValidationError, prefix: str = "", spelled: Callable[[str], str] = str
) -> list[str]:
    """One readable line per problem of a failed validation: path, reason and offending value.

    Args:
        error: what failed.
        prefix: before every path.
        spelled: what a path is called where it was written.
    """
    lines = []
    for item in error.errors():
        if item["type"] == "default_factory_not_called":
            continue  # what follows from another error, which is told
        path = ".".join(
            [prefix] * bool(prefix) + [shortened(str(part)) for part in item["loc"] if part not in ("float", "str")]
        )
        message = shortened(item["msg"].removeprefix("Value error, "), 400)
        if item["type"] == "extra_forbidden":
            message = "unknown key; remove it or check its spelling"
        elif item["type"] != "value_error":
            message = f"{message}, got {_shortened(item['input'])}"
            if item["type"] == "float_parsing" and any(str(part).endswith("_m") for part in item["loc"]):
                message += "; give metres, or a unit as in 3mm, 50um, 530nm"
            if item["type"] in ("tuple_type", "list_type"):
                message += "; give a list, as [1, 2, 3], of one value too: [1]"
        line = f"{spelled(path)}: {message}" if path else message
        if line not in lines:
            lines.append(line)
    return lines
