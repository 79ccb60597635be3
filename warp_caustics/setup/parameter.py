"""What a number of a set-up is: name, symbol, unit, range, and how well a laboratory knows it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from warp_caustics.errors import InputError, known_names

Part = Literal["plate", "light", "screen", "camera"]


@dataclass(frozen=True)
class Parameter:
    """One number of a set-up.

    Attributes:
        name: as in vectors and tables; ``psf_px.0`` is the first of the group ``psf_px``.
        symbol: of docs/physics.md and docs/camera.md.
        unit: of its values; "1" for a ratio.
        low: least value.
        high: largest value.
        prior: standard deviation of what a laboratory does not know about it.
        part: where in the set-up it belongs.
        meaning: in a few words.
        is_squared: an image depends on its square, the variance that it adds to footprints or to the PSF. At 0 the
            derivative is 0 whatever the image would tell of sizes above.
    """

    name: str
    symbol: str
    unit: str
    low: float
    high: float
    prior: float
    part: Part
    meaning: str
    is_squared: bool = False

    def __post_init__(self) -> None:
        if self.low > self.high:
            raise InputError(
                f"range of {self.name} {self.low:g} to {self.high:g} runs backwards; give the smaller one first"
            )
        if not 0 < self.prior < float("inf"):
            raise InputError(
                f"prior width of {self.name} {self.prior:g} is not above 0; leave the parameter out instead"
            )

    @property
    def group(self) -> str:
        """Name without the number of a channel."""
        return self.name.partition(".")[0]

    def checked(self, value: float) -> float:
        """The value, if it is within the range.

        Raises:
            InputError: it is not.
        """
        if not self.low <= value <= self.high:
            raise InputError(
                f"{self.name} {value:g} {self.unit} is outside {self.low:g} to {self.high:g}; give one within"
            )
        return value


def chosen(names: Iterable[str], known: Sequence[Parameter]) -> tuple[str, ...]:
    """Names of parameters from names and groups, each once, in the order given.

    Args:
        names: of parameters; a group stands for all of its own.
        known: what there is.

    Raises:
        InputError: a name that none has.
    """
    found: dict[str, None] = {}
    for name in names:
        held = [p.name for p in known if name in (p.name, p.group)]
        if not held:
            groups = dict.fromkeys(p.group for p in known)
            everything = dict.fromkeys(p.name for p in known)
            raise InputError(
                f"parameter {name!r} is not known; {known_names(name, groups | everything if '.' in name else groups)}"
            )
        found |= dict.fromkeys(held)
    return tuple(found)
