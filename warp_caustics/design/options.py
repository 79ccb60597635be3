"""Settings of a design."""

from typing import Annotated

from pydantic import Field

from warp_caustics.strict import Positive, Strict

MAX_LIMIT_M = 0.05
"""Higher relief is no plate any more."""


class DesignOptions(Strict):
    """What a relief may be, and how long it is looked for."""

    max_height_m: Annotated[float, Field(gt=0, le=MAX_LIMIT_M, allow_inf_nan=False)] = 2e-3
    """Highest minus lowest point of the relief, at most [m]."""
    screen_distance_m: Annotated[float, Field(gt=0, le=10.0, allow_inf_nan=False)] | None = None
    """From the bottom face to the screen [m]; None: the least at which the limit holds no light back, see
    ``distance.py``."""
    smoothness: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1e-3
    """Weight of the bending energy against half the mean squared error of the irradiance, on the last image size."""
    max_iterations: Annotated[int, Field(ge=1)] = 50
    """Descent steps per image size, at most."""
    coarsest_pixels: Annotated[int, Field(ge=2)] = 64
    """Image size of the first descent, at least."""
    finest_pixels: Annotated[int, Field(ge=2)] | None = None
    """Image size of the last; None: all pixels, at most twice as many as height samples."""
    dispersion: bool = True
    """Descend on the last image size in the mean of all wavelengths; False: at their mean index, as before it."""
    start_cells: Annotated[int, Field(ge=4, le=2048)] = 64
    """Grid of the optimal transport that makes the start, at most; its time grows with the third power."""
    start_steps: Annotated[int, Field(ge=1)] = 20
    """Steps of that transport per grid, at most."""
    max_time_s: Positive | None = None
    """Stop after this time [s] with the best relief so far; the check comes on top."""
