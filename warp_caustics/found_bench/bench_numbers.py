"""Which numbers of a bench are looked for in one image, what is believed of them, and which no image tells."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from warp_caustics.errors import InputError
from warp_caustics.found_bench.picture_size import lowest_vergence, picture_size
from warp_caustics.found_bench.thin_relief import MAGNIFICATION, PICTURE
from warp_caustics.scene import Scene
from warp_caustics.setup.optical import optical_parameters, optical_values, with_optical_values
from warp_caustics.setup.parameter import Parameter, chosen

AMBIENT = "ambient"
"""Stray light of all wavelengths alike, relative to the light of a flat plate."""
MOST_AMBIENT = 0.5

VERGENCE = "vergence_per_m"
"""Of light that is told to be parallel; below 0 it converges, or the picture is too small."""

LOOKED_FOR = ("screen_x_m", "screen_y_m", VERGENCE, "lamp_distance_m", "dispersion_scale", AMBIENT)
"""Those of them that a scene has."""

WIDTHS = {VERGENCE: 1.0, "dispersion_scale": 0.2}
"""Prior widths in place of the usual ones: of a lamp that nobody measured, and a glass of which the index is known."""

WHY_NOT_TOLD = {
    "gap_m": "heights lower by as much as light goes further explain it alike",
    "base_thickness_m": "heights lower by as much as light goes further explain it alike",
    "index_offset": "heights lower by as much as light is bent more explain it alike",
    "tilt_x_rad": "a shift of the picture looks the same",
    "tilt_y_rad": "a shift of the picture looks the same",
    "lamp_x_m": "a shift of the picture looks the same",
    "lamp_y_m": "a shift of the picture looks the same",
}
"""Numbers that are not looked for: measured, see docs/found_bench.md."""


@dataclass(frozen=True)
class BenchNumbers:
    """Numbers of a bench that are looked for, and what is believed of them.

    Attributes:
        scene: as it is told.
        parameters: P of them, with their prior widths.
        before: values by name: the told ones.
        not_told: numbers that no image tells, with what is believed of them.
        told_widths: how well numbers are known, by name, as the user says; 0 is exact.
        is_picture: a vergence above 0, too, is not that of a lamp, but of a picture that is too large.
    """

    scene: Scene
    parameters: tuple[Parameter, ...]
    before: Mapping[str, float]
    not_told: tuple[Parameter, ...]
    told_widths: Mapping[str, float] = field(default_factory=dict)
    is_picture: bool = False

    @classmethod
    def of(cls, scene: Scene, priors: Mapping[str, float] | None = None, ambient: float = 0.0) -> "BenchNumbers":
        """Those that a scene has.

        Args:
            scene: as it is told.
            priors: standard deviations by name, of turn and size of the picture, too, which are not looked for; 0 is
                known exactly and not looked for.
            ambient: stray light as it is told.

        Raises:
            InputError: a name that no bench has, or a width below 0.
        """
        stray = Parameter(AMBIENT, "A", "1", 0.0, MOST_AMBIENT, 0.02, "camera", "stray light")
        every = [replace(p, prior=WIDTHS.get(p.name, p.prior)) for p in (*optical_parameters(scene), stray)]
        widths = dict(priors or {})
        chosen(widths, (*every, *PICTURE))
        wrong = {name: width for name, width in widths.items() if not width >= 0}
        if wrong:
            name, width = next(iter(wrong.items()))
            raise InputError(f"prior width of {name} {width:g} is below 0; give 0 for a number that is known exactly")
        every = [replace(p, prior=widths[p.name]) if widths.get(p.name) else p for p in every]
        if scene.is_collimated and widths.get(MAGNIFICATION) != 0:
            lowest = lowest_vergence(scene)
            every = [replace(p, low=lowest) if p.name == VERGENCE else p for p in every]
        unknown = [p for p in every if widths.get(p.name) != 0]
        names = [name for name in LOOKED_FOR if name != "dispersion_scale" or _disperses(scene)]
        values = optical_values(scene, scene) | {AMBIENT: ambient}
        return cls(
            scene,
            tuple(p for p in unknown if p.name in names),
            values,
            tuple(p for p in unknown if p.name in WHY_NOT_TOLD),
            widths,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Of what is looked for, shape [P]."""
        return tuple(p.name for p in self.parameters)

    def scene_of(self, values: Mapping[str, float]) -> Scene:
        """The scene of values of these numbers; those that are not named stay as told.

        Light that converges is parallel there, and :meth:`picture_size` the rest of it.

        Raises:
            InputError: values that make no scene.
        """
        optical = {name: value for name, value in values.items() if name != AMBIENT}
        if self.is_picture or optical.get(VERGENCE, 0.0) < 0:
            optical[VERGENCE] = 0.0
        if all(value == self.before[name] for name, value in optical.items()):
            return self.scene
        return with_optical_values(self.scene, optical)

    def picture_size(self, values: Mapping[str, float]) -> float:
        """Of the picture over that of :meth:`scene_of` (:mod:`warp_caustics.found_bench.picture_size`)."""
        vergence = values.get(VERGENCE, 0.0)
        return picture_size(self.scene, vergence) if self.is_picture or vergence < 0 else 1.0

    def of_picture(self) -> "BenchNumbers | None":
        """The same with :attr:`is_picture`; None where no vergence is looked for, or the picture's size is told."""
        if self.told_widths.get(MAGNIFICATION) == 0 or VERGENCE not in self.names or not self.scene.is_collimated:
            return None
        return replace(self, is_picture=True)

    def of_lamp(self) -> "BenchNumbers | None":
        """The same without :attr:`is_picture`, of a lamp no farther than infinity; None where it is not set."""
        if not self.is_picture:
            return None
        parameters = tuple(replace(p, low=0.0) if p.name == VERGENCE else p for p in self.parameters)
        return replace(self, parameters=parameters, is_picture=False)

    def only(self, names: Collection[str]) -> "BenchNumbers":
        """The same, of which some are looked for: those of the names that are among them."""
        return replace(self, parameters=tuple(p for p in self.parameters if p.name in names))

    def within(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values brought into the ranges of their numbers."""
        limits = {p.name: (p.low, p.high) for p in self.parameters}
        return {name: min(max(value, limits[name][0]), limits[name][1]) for name, value in values.items()}


def _disperses(scene: Scene) -> bool:
    """Whether two wavelengths shine through a glass that bends them differently."""
    indices = [n for n, light in zip(scene.glass_indices, scene.radiosity_W_m2, strict=True) if light > 0]
    return len(set(indices)) > 1
