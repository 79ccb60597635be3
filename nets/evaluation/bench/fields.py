"""Cases as fields: their images are made once and kept, as those of a comparison."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from data_gen.suites.case import Case
from data_gen.suites.light import Light
from data_gen.suites.shot import Measured, measured
from nets.evaluation.arrays import read_arrays, write_arrays
from nets.evaluation.code_version import code_version
from nets.evaluation.fields import Field
from warp_caustics.fold_fraction import fold_fraction
from warp_caustics.reconstruct.base import CausticImage

ARRAYS = ("heights", "image", "noise", "mask", "folds", "warnings")


def case_field(case: Case, light: Light, folder: Path) -> Field:
    """The field of a case; what is in the folder is not simulated again.

    Args:
        case: the case.
        light: simulates.
        folder: where images are kept.
    """
    path = folder / f"{_key(case, light)}.npz"
    arrays = read_arrays(path, ARRAYS)
    if arrays is None:
        arrays = _arrays(case, measured(case, light))
        write_arrays(path, arrays)
    noise: Any = arrays["noise"]
    mask: Any = arrays["mask"]
    image = CausticImage(
        arrays["image"],
        noise if np.isfinite(noise).all() else None,
        None if mask.all() else mask,
    )
    warnings = tuple(str(line) for line in arrays["warnings"])
    return Field(case.name, arrays["heights"], image, float(arrays["folds"]), "simulated", warnings)


def _arrays(case: Case, found: Measured) -> dict[str, Any]:
    image, missing = found.image, np.full(case.told.n_wavelengths, np.nan)
    return {
        "heights": found.heights_m,
        "image": image.irradiance,
        "noise": missing if image.noise_std is None else image.noise_std,
        "mask": np.ones(image.irradiance.shape, bool) if image.mask is None else image.mask,
        "folds": np.array(fold_fraction(found.heights_m, case.told)),
        "warnings": np.array(found.warnings, dtype=str),
    }


def _key(case: Case, light: Light) -> str:
    content = {"case": case.record(), "n_photons": light.n_photons, "code": code_version()}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]
