"""Settings of ``fibres``."""

from typing import Annotated, Literal

from pydantic import Field

from nets.reconstruct.direct_options import DirectOptions
from warp_caustics.prints.line import Section

DEFAULT_LOOKS = {"cpu": 0, "cuda": 2}
DEFAULT_STARTS = {"cpu": 0, "cuda": 3}
DEFAULT_EVOLVES = {"cpu": False, "cuda": True}


class FibresOptions(DirectOptions):
    """Settings of ``fibres``; those of ``direct`` are for the network and for plates that are no lines.

    A bench is looked for with lines (``set_up``) where these do not tell the image on a GPU, on a CPU if asked: of many
    lines it takes minutes there; what moves a picture, and stray light, are asked on both. Where the image looks as of
    another bench a CPU has ``direct`` find it, a GPU where the picture looks of another size; lines are looked for
    there then, and last for both together. How far light goes is asked of lines on both wherever they nearly explain
    the image. Where lines do not tell the image ``direct`` looks for a bench on both.
    """

    profile: Section | Literal["found"] = "found"
    """Of a line across; ``found`` takes the cosine unless another section, or lines that merge where they cross,
    explains the image better, and finds its two numbers with the lines
    (:class:`~warp_caustics.prints.line_shape.Shape`)."""
    jumps: Annotated[int, Field(ge=0, le=20)] = 3
    """Rounds in which lines are added, removed and jump, at most."""
    looks: Annotated[int, Field(ge=0, le=10)] | None = None
    """How often lines that leave part of the image unexplained are searched for anew, from where heights go and from
    what a network says that is shown them; each takes as long as the first search. None: twice on a GPU, never on a
    CPU."""
    starts: Annotated[int, Field(ge=0, le=16)] | None = None
    """From how many single answers of the network lines that leave part of the image unexplained are searched for after
    that; each takes as long as a look. None: three on a GPU, none on a CPU."""
    evolves: bool | None = None
    """Whether places that many lines leave wrong have some evolve there, thousands of simulations each. None: on a GPU,
    where that takes seconds; a CPU takes half a minute each time."""
    last_steps: bool = True
    """Whether lines that leave nothing but noise, and their bench, go where that noise tells clearly more of them.
    A GPU takes seconds; one core three minutes for two lines, up to seven for fifteen, where these nearly tell another
    bench or hint at one (:data:`nets.reconstruct.fibres.bench.noise_effort.EFFORTS`)."""
    waves: bool = True
    """Whether lines may vary along their way, thicker and thinner and aside of straight, where straight ones leave more
    than noise."""
    curves: bool = True
    """Whether lines with corners and curves are looked for where straight ones do not tell the image; not where
    ``samples`` are asked for, which are those of the network then."""
    most_lines: Annotated[int, Field(ge=1, le=500)] = 60
    left_alone: Annotated[int, Field(ge=2, le=501)] | None = None
    """Lines from which on they are not searched for on the image, which then is left to ``direct``, corners and
    curves and all; None: never."""

    @property
    def looks_for_curves(self) -> bool:
        """Whether lines with corners and curves may be looked for."""
        return self.curves and self.refine and not self.samples

    def looks_on(self, device_type: str) -> int:
        """``looks``, or how many there are on a device."""
        return DEFAULT_LOOKS[device_type] if self.looks is None else self.looks

    def starts_on(self, device_type: str) -> int:
        """``starts``, or how many there are on a device."""
        return DEFAULT_STARTS[device_type] if self.starts is None else self.starts

    def evolves_on(self, device_type: str) -> bool:
        """``evolves``, or whether that is so on a device."""
        return DEFAULT_EVOLVES[device_type] if self.evolves is None else self.evolves
