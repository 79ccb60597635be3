"""Maps of the plate: values, units and scales."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cli.report.arrays import MAP_SAMPLES, finite_range
from cli.report.colours import DEVIATION, HEIGHT, UNCERTAINTY
from cli.report.frame import Frame, colour_bar, log_bar, log_ticks, plate_frame
from cli.report.pictures import map_picture

if TYPE_CHECKING:
    from cli.report.content import ReportContent
    from warp_caustics.inspection.findings import Region
    from warp_caustics.types import FloatArray

_SHOWN_QUANTILE = 0.998
_TOLERANCES_SHOWN = 3.0
_LOG_DECADES = 4.0


@dataclass(frozen=True, eq=False)
class Map:
    """A quantity over the plate.

    Attributes:
        title: a word or two.
        label: quantity and unit.
        unit: of ``values``, or of what they are the logarithm of.
        alt: what there is to see, in words.
        values: shape [n, n], NaN where there is none; decimal logarithms where ``is_log``.
        low: value of the first colour.
        high: of the last one.
        colours: name of the colour map.
        is_log: whether values are logarithms.
        tolerance: largest deviation allowed, in the unit of the values.
        boxes_mm: lower x, lower y, upper x, upper y and number of regions.
    """

    title: str
    label: str
    unit: str
    alt: str
    values: "FloatArray"
    low: float
    high: float
    colours: str
    is_log: bool = False
    tolerance: float | None = None
    boxes_mm: tuple[tuple[float, float, float, float, str], ...] = ()

    @property
    def log_ticks(self) -> list[float]:
        return log_ticks(self.low, self.high)

    def frame(self, size_mm: tuple[float, float]) -> Frame:
        """The map without JavaScript."""
        return plate_frame(
            map_picture(self.values, self.low, self.high, self.colours, MAP_SAMPLES),
            self.alt,
            size_mm,
            bar=(log_bar if self.is_log else colour_bar)(self.label, self.low, self.high, self.colours),
            boxes_mm=self.boxes_mm,
        )


def all_maps(content: "ReportContent") -> dict[str, Map]:
    """Maps by name: height; deviation, error and uncertainty where they are known."""
    heights = content.heights_m * 1e6
    low, high = finite_range(heights)
    maps = {
        "height": Map(
            "Height",
            "height [um]",
            "um",
            f"Height map of the plate, {low:.4g} to {high:.4g} um",
            heights,
            low,
            high,
            HEIGHT,
        )
    }
    found = content.inspection
    if found is not None:
        values = np.where(np.asarray(found.mask, dtype=bool), found.deviation_m, np.nan) * 1e6
        tolerance = found.tolerance_m * 1e6
        limit = max(_limit(values), _TOLERANCES_SHOWN * tolerance)
        maps["deviation"] = Map(
            "Deviation from the design",
            "measured - design [um]",
            "um",
            f"Map of measured minus designed height with {len(found.regions)} numbered regions out of tolerance",
            values,
            -limit,
            limit,
            DEVIATION,
            tolerance=tolerance,
            boxes_mm=tuple(_box_mm(region) for region in found.regions),
        )
    if content.reference_m is not None:
        with np.errstate(invalid="ignore"):
            values = (content.heights_m - content.reference_m) * 1e6
        limit = _limit(values)
        maps["error"] = Map(
            "Error against the reference",
            "recovered - reference [um]",
            "um",
            "Map of recovered minus reference height",
            values,
            -limit,
            limit,
            DEVIATION,
        )
    if content.uncertainty_m is not None:
        maps["uncertainty"] = _uncertainty_map(content.uncertainty_m * 1e6)
    return maps


def _box_mm(region: "Region") -> tuple[float, float, float, float, str]:
    (x0, y0), (x1, y1) = region.lower_m, region.upper_m
    return x0 * 1e3, y0 * 1e3, x1 * 1e3, y1 * 1e3, str(region.number)


def _uncertainty_map(sigma_um: "FloatArray") -> Map:
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(sigma_um > 0, np.log10(sigma_um), np.nan)
    low, high = finite_range(values)
    low = max(low, high - _LOG_DECADES)
    alt = f"Map of the standard uncertainty of the heights, up to {10**high:.3g} um"
    label = "standard uncertainty [um]"
    return Map("Standard uncertainty", label, "um", alt, values, low, high, UNCERTAINTY, is_log=True)


def _limit(values: "FloatArray") -> float:
    """Round end of a symmetric scale; few values lie beyond."""
    known = np.abs(values[np.isfinite(values)])
    found = float(np.quantile(known, _SHOWN_QUANTILE)) if known.size else 0.0
    if found <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(found))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= found * (1 - 1e-9)))
