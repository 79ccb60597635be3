"""Error against spread: what is kept of every field, and which standard uncertainty covers 68.3 % of all points.

Kept in an .npz file beside the JSON of figures, so that another fit needs no new run: for each field quantiles of
|error| / spread, and a few points' (error, spread) [um].
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy.optimize

from warp_caustics.types import FloatArray

COVERED = 0.683
"""Share of points within one standard uncertainty, if errors were normal."""
QUANTILES = (np.arange(200) + 0.5) / 200
"""Levels that are kept."""
POINTS = 500
"""Points that are kept of each field."""
LEAST_UM = 1e-4
"""Errors and spreads below count as this: both are compared as ratios."""


class Kept:
    """Quantiles and points of fields by key, in a file if there is one."""

    def __init__(self, path: Path | None):
        self.path = path
        self.held: dict[str, npt.NDArray[np.float32]] = {}
        if path is not None and path.exists():
            with np.load(path) as found:
                self.held = dict(found.items())

    def has(self, key: str) -> bool:
        """Whether the field of this key is kept."""
        return f"{key}/points" in self.held

    def add(self, key: str, error_m: FloatArray, spread_m: FloatArray, field: int) -> None:
        """Keep a field's error and spread [m], any shape; ``field`` seeds the choice of points."""
        error, spread = 1e6 * error_m.ravel(), np.maximum(1e6 * spread_m.ravel(), LEAST_UM)
        which = np.random.default_rng((17, field)).choice(error.size, min(POINTS, error.size), replace=False)
        self.held[f"{key}/quantiles"] = np.quantile(np.abs(error) / spread, QUANTILES).astype(np.float32)
        self.held[f"{key}/points"] = np.stack((error[which], spread[which]), axis=1).astype(np.float32)

    def save(self) -> None:
        """Write the file, if there is one."""
        if self.path is not None:
            np.savez(self.path, **self.held)  # type: ignore[arg-type]

    def quantiles(self, keys: list[str]) -> FloatArray:
        """Quantiles of |error| / spread, shape [fields, 200]."""
        return np.stack([self.held[f"{key}/quantiles"] for key in keys]).astype(np.float64)

    def points(self, keys: list[str]) -> FloatArray:
        """|error| and spread of all fields' points [um], shape [2, points]."""
        rows = np.concatenate([self.held[f"{key}/points"] for key in keys]).astype(np.float64)
        return np.maximum(np.abs(rows.T), LEAST_UM)


@dataclass(frozen=True)
class Model:
    """Standard uncertainty sqrt((scale spread)^2 + floor^2).

    Attributes:
        scale: factor on the spread.
        floor_um: what is uncertain however well a network agrees with itself [um].
    """

    scale: float
    floor_um: float = 0.0

    def uncertainty_um(self, spread_um: FloatArray) -> FloatArray:
        """Of points [um], shape of spread_um."""
        return np.asarray(np.hypot(self.scale * spread_um, self.floor_um))


def loss(model: Model, points: list[FloatArray]) -> float:
    """How badly a model tells the 68.3 % quantile of |error|: pinball loss of its logarithm, mean over conditions.

    Of the logarithm, so that fields that are 100 um wrong do not decide alone.

    Args:
        model: to be judged.
        points: |error| and spread [um] of each condition, each of shape [2, points].
    """
    losses = []
    for error, spread in points:
        excess = np.log(error / model.uncertainty_um(spread))
        losses.append(np.mean(np.maximum(COVERED * excess, (COVERED - 1) * excess)))
    return float(np.mean(losses))


def fitted_scale(quantiles: list[FloatArray]) -> Model:
    """The factor on the spread that covers 68.3 % of the points of all conditions, each of the same weight."""
    values = np.concatenate([each.ravel() for each in quantiles])
    weights = np.concatenate([np.full(each.size, 1 / each.size) for each in quantiles])
    order = np.argsort(values)
    reached = (np.cumsum(weights[order]) - weights[order] / 2) / len(quantiles)
    return Model(float(np.interp(COVERED, reached, values[order])))


def fitted_floor(points: list[FloatArray], start: Model) -> Model:
    """Scale and floor with the least loss; covers 68.3 % of all points as well, and more evenly over spreads."""
    found = scipy.optimize.minimize(
        lambda logarithms: loss(Model(*np.exp(logarithms).tolist()), points),
        np.log((start.scale, 0.5)),
        method="Nelder-Mead",
        options={"xatol": 1e-3, "fatol": 1e-6, "initial_simplex": np.log(start.scale) * np.array([1, 0]) + SIMPLEX},
    )
    return Model(*np.exp(found.x).tolist())


SIMPLEX = np.log([(1.0, 0.1), (0.7, 1.0), (1.3, 1.0)])
"""Where the search begins: scale relative to that without floor, and floor [um]."""


def print_fits(kept: Kept, keys: Mapping[str, list[str]], shipped: float) -> None:
    """Fit both models and print them with their coverage per condition.

    Args:
        kept: errors and spreads.
        keys: of each condition's fields.
        shipped: factor on the spread in use.
    """
    points = [kept.points(fields) for fields in keys.values()]
    scaled = fitted_scale([kept.quantiles(fields) for fields in keys.values()])
    models = {"shipped": Model(shipped), "scale": scaled, "scale, floor": fitted_floor(points, scaled)}
    print("\nstandard uncertainty from the spread, every condition of the same weight")
    for name, model in models.items():
        text = (
            f"{model.scale:.3f} s" if model.floor_um == 0 else f"sqrt(({model.scale:.3f} s)^2 + {model.floor_um:.3f}^2)"
        )
        print(f"{name:<14} u = {text + ' um':<36} loss {loss(model, points):.4f}")
    print(f"\n{'within 1 / 2 u':<16}" + "".join(f"{name:>16}" for name in models))
    shares = np.array(
        [[_shares(model, each) for model in models.values()] for each in points]
    )  # [conditions, models, 2]
    for name, row in [*zip(keys, shares, strict=True), ("all", shares.mean(axis=0))]:
        print(f"{name:<16}" + "".join(f"{one:>9.3f} /{two:5.3f}" for one, two in row), flush=True)


def _shares(model: Model, points: FloatArray) -> tuple[float, float]:
    """Shares of points within one and two standard uncertainties."""
    ratio = points[0] / model.uncertainty_um(points[1])
    return float(np.mean(ratio <= 1)), float(np.mean(ratio <= 2))
