"""Prints as a machine makes them: the fibre's glass, rounded caps, passes, waves, thick ends, a base that is not flat.

Drawn per relief; the number of passes and the phases of waves per line.

Off by default: a pattern without it draws and prints as before, to the bit.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from data_gen.intervals import (
    AmountInterval,
    ContactAngleInterval,
    PositiveInterval,
    ShareInterval,
    SomeInterval,
)
from data_gen.variety import Exponent, Merging, PrintTraits, Reach, bow_of
from warp_caustics.prints.chains import chains_of_rows, rows_of
from warp_caustics.prints.fibre import MOST_PASSES, fibre_area_m2
from warp_caustics.prints.imperfections import thick_ends, wavy
from warp_caustics.prints.paths import MAX, SUM
from warp_caustics.prints.rows import JOINED, ROW_COLUMNS
from warp_caustics.prints.sections import KINDS, SectionName, cap_proportion, named_section
from warp_caustics.strict import Strict
from warp_caustics.types import FloatArray

Overlap = Literal["sum", "max", "merge"]
HAS_POWER = ("cosine", "parabola", "gaussian")
"""Sections whose exponent may be drawn."""

SHORTEST_M = 5e-4
"""Shorter waves and ends are finer than height samples, and cost a piece each [m]."""

Sag = Annotated[float, Field(ge=0, le=1e-3, allow_inf_nan=False)]


class Making(Strict):
    """How prints are made. Each relief draws its own, uniformly; of several sections or overlaps each is as likely."""

    sections: Annotated[tuple[SectionName, ...], Field(min_length=1)] = ("cap",)
    """cap (circular, by contact angle), cosine, quarter, ellipse, parabola, gaussian."""
    exponent: tuple[Exponent, Exponent] | None = None
    """g of cosine, parabola and gaussian; None leaves it at 1."""
    reach: tuple[Reach, Reach] = (1.0, 1.0)
    """e: where the feet of a Gaussian end, in halves of its width."""
    contact_angle_rad: ContactAngleInterval = (0.44, 1.22)
    """theta: of a cap, and of the circular cap whose height over width any section has that is made of a fibre [rad].
    25 to 70 degrees; above 90 a line overhangs and is no height field."""
    fibre_diameter_m: PositiveInterval | None = None
    """d: each line has the glass of its passes, pi d^2 / 4 each [m]. None takes widths, and but for caps heights,
    from the pattern."""
    passes: SomeInterval = (1, 1)
    """Passes over the same line, both ends included: their glass adds up, and the line keeps its proportions."""
    overlaps: Annotated[tuple[Overlap, ...], Field(min_length=1)] = ("sum",)
    """Lines on top of each other: sum, max (the highest), or merge, (sum of h^p)^(1/p)."""
    merging: tuple[Merging, Merging] = (2.0, 12.0)
    """p of merge, its logarithm uniform."""
    waviness: ShareInterval = (0.0, 0.0)
    """Largest change of width and height along a line, relative."""
    sideways_m: AmountInterval = (0.0, 0.0)
    """Largest distance of a line from where it should be, in waves along it [m]."""
    wavelength_m: PositiveInterval = (2e-3, 1e-2)
    """Of both [m]."""
    end_thickness: ShareInterval = (0.0, 0.0)
    """More width and height at the ends of a line, relative."""
    end_length_m: PositiveInterval = (5e-4, 2e-3)
    """Over which that falls to 1/e [m]."""
    bow_m: Sag = 0.0
    """Largest sag of the base between the plate's centre and the middle of a side [m], in both directions."""
    base_wave_m: Sag = 0.0
    """Largest amplitude of a wave of the base [m]."""
    base_wavelength_m: PositiveInterval = (0.01, 0.05)
    """Of that wave, in any direction [m]."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for name in ("exponent", "reach", "merging"):
            interval = getattr(self, name)
            if interval is not None and interval[0] > interval[1]:
                raise ValueError(f"{name}: lower end {interval[0]:g} is above upper end {interval[1]:g}; swap them")
        if self.passes[1] > MOST_PASSES:
            raise ValueError(f"passes: {self.passes[1]} is above {MOST_PASSES}; lower it")
        for name in ("wavelength_m", "end_length_m"):
            if getattr(self, name)[0] < SHORTEST_M:
                raise ValueError(f"{name}: {getattr(self, name)[0]:g} m is below {SHORTEST_M:g}; raise it")
        return self

    @property
    def changes_along(self) -> bool:
        """Whether lines differ from place to place."""
        return any(interval[1] > 0 for interval in (self.waviness, self.sideways_m, self.end_thickness))

    @property
    def has_chains(self) -> bool:
        """Whether the printing kernel must know which pieces are one line."""
        return self.changes_along or any(overlap != "sum" for overlap in self.overlaps)


@dataclass(frozen=True)
class MadePrint:
    """How one print is made.

    Attributes:
        traits: what the kernel takes for all its lines.
        fibre_diameter_m: d [m]; 0 where widths and heights are the pattern's.
        waviness: relative.
        sideways_m: [m].
        wavelength_m: of both [m].
        end_thickness: relative.
        end_length_m: [m].
    """

    traits: PrintTraits
    fibre_diameter_m: float
    waviness: float
    sideways_m: float
    wavelength_m: float
    end_thickness: float
    end_length_m: float

    def record(self) -> dict[str, float]:
        """Numbers that tell how the sample was made, for its data set's manifests.

        ``print_merging`` is p of lines on top of each other, 0 where the highest counts; ``print_section`` the number
        of the section (``warp_caustics.prints.sections.KINDS``), with its exponent or contact angle [rad].
        """
        traits = self.traits
        own = {name: float(value) for name, value in asdict(self).items() if name != "traits"}
        return {
            "print_section": float(KINDS.index(traits.section)),
            "print_exponent": traits.exponent,
            "print_reach": traits.reach,
            "print_contact_angle_rad": traits.contact_angle_rad,
            "print_merging": 0.0 if traits.merging == MAX else traits.merging,
            **{f"print_{name}": value for name, value in own.items()},
            "print_base_wave_m": traits.wave[0],
        }


def draw_making(making: Making, plate_size_m: tuple[float, float], rng: np.random.Generator) -> MadePrint:
    """How one relief is made.

    Args:
        making: ranges.
        plate_size_m: extent along x and y [m].
        rng: source of randomness; as many numbers are taken whatever comes out.
    """
    name = making.sections[int(rng.integers(len(making.sections)))]
    exponent = float(rng.uniform(*(making.exponent or (1.0, 1.0))))
    reach, angle = float(rng.uniform(*making.reach)), float(rng.uniform(*making.contact_angle_rad))
    diameter = float(rng.uniform(*(making.fibre_diameter_m or (0.0, 0.0))))
    overlap = making.overlaps[int(rng.integers(len(making.overlaps)))]
    merging = {"sum": SUM, "max": MAX, "merge": float(np.exp(rng.uniform(*np.log(making.merging))))}[overlap]
    along = [
        float(rng.uniform(*interval))
        for interval in (
            making.waviness, making.sideways_m, making.wavelength_m, making.end_thickness, making.end_length_m
        )
    ]  # fmt: skip
    sag, across, direction = rng.uniform((-making.bow_m, -1.0, 0.0), (making.bow_m, 1.0, np.pi))
    amplitude, length = float(rng.uniform(0.0, making.base_wave_m)), float(rng.uniform(*making.base_wavelength_m))
    heading, phase = rng.uniform(0.0, (np.pi, 2 * np.pi))
    number = 2 * np.pi / length
    section = named_section(
        name,
        exponent=exponent if name in HAS_POWER and making.exponent is not None else None,
        reach=reach if name == "gaussian" else 1.0,
        contact_angle_rad=angle,
    )
    traits = PrintTraits(
        section.kind,
        section.exponent,
        section.reach,
        merging,
        bow_of(sag, across, direction, plate_size_m),
        angle,
        (amplitude, float(number * np.cos(heading)), float(number * np.sin(heading)), float(phase)),
    )
    return MadePrint(traits, diameter, *along)


def made_strokes(
    strokes: Sequence[FloatArray],
    making: Making,
    made: Sequence[MadePrint],
    generators: Sequence[np.random.Generator],
) -> list[FloatArray]:
    """Strokes of patterns as they come out of the machine; a relief is the same alone and in a batch, to the bit.

    Args:
        strokes: of each relief as its pattern says, shape [L, 7] (STROKE_COLUMNS) [m].
        making: gives the number of passes.
        made: of each relief.
        generators: of each relief, for passes and phases of its lines.

    Returns:
        Of each relief, shape [M, 7], M at least L.
    """
    sized, phases = [], []
    for own, print_, rng in zip(strokes, made, generators, strict=True):
        line = np.cumsum(own[:, 0] != JOINED) - 1
        count = int(line[-1]) + 1 if len(line) else 0
        passes = rng.integers(*making.passes, count, endpoint=True)
        phases.append(rng.uniform(0.0, 2 * np.pi, (count, 4)))
        sized.append(_of_glass(own, print_, passes[line] if count else np.ones(0)))
    if not making.changes_along:
        return sized
    counts = [len(each) for each in phases]
    values = {
        name: np.repeat([getattr(print_, name) for print_ in made], counts)
        for name in ("waviness", "sideways_m", "wavelength_m", "end_thickness", "end_length_m")
    }
    chains = chains_of_rows(np.concatenate([np.zeros((0, len(ROW_COLUMNS))), *sized]))
    if making.waviness[1] > 0 or making.sideways_m[1] > 0:
        chains = wavy(chains, values["waviness"], values["sideways_m"], values["wavelength_m"], np.concatenate(phases))
    if making.end_thickness[1] > 0:
        chains = thick_ends(chains, values["end_thickness"], values["end_length_m"])
    # Lines of the relief after come behind its last.
    first = np.append(chains.first, len(chains.points_m))[np.cumsum(counts)[:-1]]
    return np.split(rows_of(chains), first)


def _of_glass(strokes: FloatArray, made: MadePrint, passes: npt.NDArray[Any]) -> FloatArray:
    """Strokes, shape [L, 7], with the width and height that their fibre and passes, shape [L], or their cap gives."""
    strokes = strokes.copy()
    section, proportion = made.traits.cross_section, cap_proportion(made.traits.contact_angle_rad)
    # Passes keep the proportions: width and height go with the root of the glass.
    grown = np.sqrt(passes)
    if made.fibre_diameter_m > 0:
        width = np.sqrt(fibre_area_m2(made.fibre_diameter_m) / (section.area_factor() * proportion))
        strokes[:, 5], strokes[:, 6] = width * grown, proportion * width * grown
        return strokes
    if section.kind == "cap":
        strokes[:, 6] = proportion * strokes[:, 5]
    strokes[:, 5:7] *= grown[:, None]
    return strokes
