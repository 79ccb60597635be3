"""Settings of the method ``sfc``."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from warp_caustics.reconstruct.sfc.landweber import SfcDataTerm
from warp_caustics.strict import Positive, Strict

Variant = Literal["baseline", "landweber_pixel", "landweber_wavelet"]
StepControl = Literal["backtracking", "fixed"]

HIGHEST_M = 7.5e-3
"""SfC's upper bound of the relief [m]: 0.3 of its unit of 2.5 cm. A length, so it converts as it is."""


def _array_or_text(value: Any) -> Any:
    if isinstance(value, str | Path):
        return str(value)
    if isinstance(value, np.ndarray):
        return value
    raise ValueError("give a path or an array [n, n]")


def _volume(value: Any) -> Any:
    if isinstance(value, str) and value not in ("none", "oracle"):
        raise ValueError("give 'none', 'oracle' or the printed volume [m^3]")
    return value


NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
ArrayOrText = Annotated[Any, BeforeValidator(_array_or_text)]


class SfcOptions(Strict):
    """Settings of ``sfc``; see docs/sfc.md for how the relative ones were tuned."""

    variant: Variant = "landweber_pixel"
    data_term: SfcDataTerm = "l2"
    max_iterations: Annotated[int, Field(ge=1)] = 200
    discrepancy: NonNegative = 1.1
    """tau_dis: stop when the RMS residual falls to this multiple of the noise (Morozov); 0 never does."""
    relative_noise: Annotated[float, Field(gt=0, lt=1)] | None = None
    """||noise|| / ||image||; None takes the capture's own estimate, if it has one."""
    max_time_s: Positive | None = None
    """Stop after this time [s] with the best relief so far."""

    oracle_heights_m: ArrayOrText | None = None
    """True relief [m], shape [n, n], or its path: privileged knowledge, as in the published evaluation."""
    mask: ArrayOrText | None = None
    """Where glass may be: none, estimated, oracle, an array [n, n] or the path of an image. Not given: oracle if
    oracle_heights_m is, else none."""
    volume_m3: Annotated[Positive | str | None, BeforeValidator(_volume)] = None
    """Printed volume [m^3], none or oracle. Not given: oracle if oracle_heights_m is, else none."""

    step: Annotated[float, Field(gt=0, le=1e3)] = 1.5
    """First step in units of 1 / L, L the curvature of the data term at the start; below 2 a weak relief converges."""
    step_control: StepControl = "fixed"
    """fixed: as published. backtracking: halved while the data term would rise, else grown by a fifth."""
    shrinkage: NonNegative = 1e-4
    """alpha, the weight of the l1 prior on heights, in units of the largest gradient at the start."""
    wavelet_shrinkage: NonNegative = 1e-4
    """alpha_w, the weight of the l1 prior on wavelet coefficients, in units of their largest gradient at the start."""
    lowest_m: Annotated[float, Field(le=0, ge=-1e-2, allow_inf_nan=False)] = 0.0
    """Lower bound of the relief [m]."""
    highest_m: Annotated[float, Field(gt=0, le=0.1, allow_inf_nan=False)] = HIGHEST_M
    """Upper bound of the relief [m]."""
    volume_tolerance: Annotated[float, Field(gt=0, lt=1)] = 0.25
    volume_gain: Annotated[float, Field(ge=0, lt=1)] = 0.1
    """gamma of the volume heuristic."""
    total_variation: NonNegative = 0.0
    """Weight of the mean slope magnitude."""
    wavelet: str = "db3"
    wavelet_levels: Annotated[int, Field(ge=1, le=12)] = 3

    finest_pixels: Annotated[int, Field(ge=2)] | None = None
    """Image size used: all pixels on a GPU, at most 2n on a CPU."""
    border_pixels: Annotated[int, Field(ge=0, le=16)] = 1
    """Ring of pixels ignored, as in ``refine``."""
    preset: Literal["lattice", "paper"] = "lattice"
    """Photons: the lattice is exact and the same in every iteration; paper draws new ones for each, as published."""
    n_photons: Annotated[int, Field(ge=1, le=10**9)] | None = None
    """n_l: light paths per wavelength; the preset's if None."""
    seed: Annotated[int, Field(ge=0, lt=2**62)] = 0
    """Of the random photons; the lattice draws none."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.variant == "baseline":
            used = ("mask", "volume_m3", "oracle_heights_m")
            given = [name for name in used if getattr(self, name) is not None] + ["total_variation"] * bool(
                self.total_variation
            )
            if given:
                raise ValueError(f"the baseline has no priors and takes no {', '.join(given)}; use landweber_pixel")
        if self.preset == "paper" and self.step_control == "backtracking":
            raise ValueError("new photons in every iteration leave nothing to compare; use step_control=fixed")
        return self

    @property
    def mask_or_default(self) -> Any:
        """Mask as asked for, or what follows from the oracle."""
        return self.mask if self.mask is not None else ("none" if self.oracle_heights_m is None else "oracle")

    @property
    def volume_or_default(self) -> float | str:
        """Printed volume as asked for [m^3], or what follows from the oracle."""
        if self.volume_m3 is not None:
            return self.volume_m3
        return "none" if self.oracle_heights_m is None else "oracle"

    def record(self) -> dict[str, Any]:
        """Every setting, arrays by their shape only."""
        values = self.model_dump()
        for name in ("mask", "oracle_heights_m"):
            if isinstance(values[name], np.ndarray):
                values[name] = f"array {list(values[name].shape)}"
        return values
