"""Pictures of a run: of each row the first plate, the image that methods got, and what they found."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cli.comparison.figures import DPI, png
from cli.figures import new_figure, rgb_composite, white_level
from data_gen.suites.case import Case
from data_gen.suites.light import Light
from nets.evaluation.bench.fields import case_field
from nets.evaluation.cells import CellStore

PANEL_IN = 1.9
MOST_METHODS = 6
"""On a picture; the tables hold all."""


class RunPictures:
    """Draws from what a run kept.

    Args:
        cases: of the run.
        records: its cells.
        folder: of the run.
        device: for images that are no longer there.
        n_photons: as of the run.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        records: Sequence[Mapping[str, Any]],
        folder: Path,
        device: str,
        n_photons: int | None,
    ):
        self.records, self.folder = records, folder
        self.light, self.store = Light(device, n_photons), CellStore(folder / "cells")
        self.first: dict[str, Case] = {}
        for case in cases:
            self.first.setdefault(case.row, case)

    def __iter__(self) -> Any:
        """Row and PNG of each."""
        for row, case in self.first.items():
            yield row, case.title, self.picture(case)

    def picture(self, case: Case) -> bytes:
        """Truth, image, and found minus true of each method."""
        field = case_field(case, self.light, self.folder / "images")
        mine = [record for record in self.records if record["field"] == case.name][:MOST_METHODS]
        figure = new_figure(PANEL_IN * (2 + len(mine)) + 0.9, PANEL_IN + 0.5, dpi=DPI)
        panels = figure.subplots(1, 2 + len(mine), squeeze=False)[0]
        true_um = field.heights_m * 1e6
        limit = max(float(np.abs(true_um).max()), 1.0)
        image = rgb_composite(field.image.irradiance, case.told.wavelengths_m, white_level(field.image.irradiance))
        for axes, values, title, options in (
            (panels[0], true_um, f"{case.name}, up to {limit:.0f} um", {"cmap": "viridis", "vmin": 0, "vmax": limit}),
            (panels[1], image, "image given", {}),
        ):
            axes.imshow(values, origin="upper", **options)
            axes.set_title(title, fontsize=8)
        errors = {record["method"]: self._error_um(record, field.heights_m) for record in mine}
        known = [np.quantile(np.abs(error), 0.98) for error in errors.values() if error is not None]
        scale = max([1.0, *map(float, known)])
        drawn = None
        for axes, (method, error) in zip(panels[2:], errors.items(), strict=True):
            if error is None:
                axes.set_title(f"{method}\nfailed", fontsize=8)
                continue
            drawn = axes.imshow(error, origin="upper", cmap="RdBu_r", vmin=-scale, vmax=scale)
            axes.set_title(f"{method}, found - true\nRMSE {np.sqrt(np.mean(error**2)):.3g} um", fontsize=8)
        for axes in panels:
            axes.set_xticks([])
            axes.set_yticks([])
        if drawn is not None:
            bar = figure.colorbar(drawn, ax=panels[-1], extend="both", shrink=0.9)
            bar.set_label("um", fontsize=8)
            bar.ax.tick_params(labelsize=8)
        return png(figure)

    def _error_um(self, record: Mapping[str, Any], true_m: Any) -> Any:
        """Found minus true [um], shape [n, n]; None where the method failed."""
        heights = self.store.heights(record["key"]) if record["status"] == "done" else None
        return None if heights is None else (heights - true_m) * 1e6
