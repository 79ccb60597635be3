"""A picture with axes and a colour bar, drawn as SVG by the template; needs no JavaScript and prints well."""

from collections.abc import Sequence
from dataclasses import dataclass

from cli.report.colours import colour_scale
from cli.report.number import number

_WIDTH = 400.0
_LEFT, _TOP, _BOTTOM, _RIGHT, _BAR = 50.0, 8.0, 44.0, 14.0, 84.0
_MAX_STRETCH = 2.5


@dataclass(frozen=True)
class Bar:
    """Colour bar.

    Attributes:
        label: quantity and unit.
        stops: place from the bottom between 0 and 1, and colour.
        ticks: place likewise, and text.
    """

    label: str
    stops: Sequence[tuple[float, str]]
    ticks: Sequence[tuple[float, str]]


@dataclass(frozen=True)
class Box:
    """A numbered rectangle, in the frame's own units from its upper left corner."""

    x: float
    y: float
    width: float
    height: float
    text: str


@dataclass(frozen=True)
class Frame:
    """Where everything of a framed picture sits, in units of its own.

    Attributes:
        uri: the picture.
        alt: what it shows, in words.
        size: (width, height) of all of it.
        area: (x, y, width, height) of the picture.
        x_ticks: place and text; none of them leaves the axes away.
        y_ticks: likewise.
        bar: colour bar, if any.
        boxes: drawn over the picture.
        dots: (x, y) of marks drawn over it.
        smooth: interpolate between pixels.
    """

    uri: str
    alt: str
    size: tuple[float, float]
    area: tuple[float, float, float, float]
    x_ticks: Sequence[tuple[float, str]] = ()
    y_ticks: Sequence[tuple[float, str]] = ()
    bar: Bar | None = None
    boxes: Sequence[Box] = ()
    dots: Sequence[tuple[float, float]] = ()
    smooth: bool = False


def plate_frame(
    uri: str,
    alt: str,
    size_mm: tuple[float, float],
    *,
    centre_mm: tuple[float, float] = (0.0, 0.0),
    bar: Bar | None = None,
    boxes_mm: Sequence[tuple[float, float, float, float, str]] = (),
    smooth: bool = False,
) -> Frame:
    """A picture of the plate or the window with axes in millimetres.

    Args:
        uri: the picture, row 0 on top: y grows downwards.
        alt: what it shows, in words.
        size_mm: extent along x and y.
        centre_mm: of the extent.
        bar: colour bar.
        boxes_mm: lower x, lower y, upper x, upper y and text of rectangles.
        smooth: interpolate between pixels.
    """
    width, height = _WIDTH, _WIDTH * min(max(size_mm[1] / size_mm[0], 1 / _MAX_STRETCH), _MAX_STRETCH)
    low = [centre - size / 2 for centre, size in zip(centre_mm, size_mm, strict=True)]

    def x_of(mm: float) -> float:
        return _LEFT + width * (mm - low[0]) / size_mm[0]

    def y_of(mm: float) -> float:
        return _TOP + height * (mm - low[1]) / size_mm[1]

    return Frame(
        uri=uri,
        alt=alt,
        size=(_LEFT + width + (_BAR if bar else _RIGHT), _TOP + height + _BOTTOM),
        area=(_LEFT, _TOP, width, height),
        x_ticks=[(x_of(mm), number(mm)) for mm in _ticks(low[0], low[0] + size_mm[0])],
        y_ticks=[(y_of(mm), number(mm)) for mm in _ticks(low[1], low[1] + size_mm[1])],
        bar=bar,
        boxes=[Box(x_of(a), y_of(b), x_of(c) - x_of(a), y_of(d) - y_of(b), text) for a, b, c, d, text in boxes_mm],
        smooth=smooth,
    )


def colour_bar(label: str, low: float, high: float, colours: str) -> Bar:
    """Bar of a linear scale.

    Args:
        label: quantity and unit.
        low: value of the first colour.
        high: of the last one.
        colours: name of the colour map.
    """
    ticks = [((value - low) / (high - low), number(value)) for value in _ticks(low, high, 6)]
    return Bar(label, colour_scale(colours), ticks)


def log_bar(label: str, low: float, high: float, colours: str) -> Bar:
    """Bar of a logarithmic scale.

    Args:
        label: quantity and unit.
        low: decimal logarithm of the value of the first colour.
        high: of the last one.
        colours: name of the colour map.
    """
    return Bar(
        label,
        colour_scale(colours),
        [((place - low) / (high - low), number(10**place)) for place in log_ticks(low, high)],
    )


def log_ticks(low: float, high: float) -> list[float]:
    """Decimal logarithms of round values between two logarithms: powers of ten, with 2 and 5 if there are few."""
    import math

    steps = (0.0,) if high - low > 3 else (0.0, math.log10(2), math.log10(5))
    powers = range(math.floor(low), math.ceil(high) + 1)
    return [power + step for power in powers for step in steps if low <= power + step <= high]


def _ticks(low: float, high: float, count: int = 7) -> list[float]:
    from matplotlib.ticker import MaxNLocator

    slack = 1e-9 * (high - low)
    values = MaxNLocator(count, steps=[1, 2, 5, 10]).tick_values(low, high)
    return [0.0 if abs(value) < slack else float(value) for value in values if low - slack <= value <= high + slack]
