"""Do light paths cross? As far as the brightness of an image tells.

Of a relief that is known, :mod:`warp_caustics.fold_fraction` says exactly where.
"""

import numpy as np

from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.scene import Scene

FOLD_IRRADIANCE = 2.0
"""A caustic with pixels brighter than this multiple of its mean is taken to have folds."""

BRIGHT_QUANTILE = 0.9999
"""Pixels at this quantile tell: hot pixels are fewer. The two lines of a test field fold 0.4 % of its plate; taken for
a weak relief they ended 3.9 mm wrong. Reliefs without a bright line descent finds exactly."""


def has_folds(image: CausticImage, scene: Scene) -> bool:
    """Whether any light paths cross; whatever the exposure, for next to no light is lost."""
    radiosity = np.maximum(np.asarray(scene.radiosity_W_m2), 1e-30)[:, None, None]
    relative = image.irradiance / radiosity
    counted = relative if image.mask is None else relative[image.mask]
    return bool(counted.size and np.quantile(counted, BRIGHT_QUANTILE) > FOLD_IRRADIANCE * counted.mean())
