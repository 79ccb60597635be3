"""Settings of ``refine``."""

from typing import Annotated, Any, Literal

from pydantic import Field

from warp_caustics.reconstruct.pyramid import usual_pixels
from warp_caustics.scene import Scene
from warp_caustics.strict import Strict

RefineDataTerm = Literal["charbonnier", "l2", "sqrt"]
Metric = Literal["auto", "curvature", "height"]
Exposure = Literal["divide", "trust"]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class RefineOptions(Strict):
    """Settings of ``refine``; None means: depends on the metric, see :meth:`resolved`."""

    metric: Metric = "auto"
    """auto: height where a start is given or the caustic has folds, else curvature."""
    data_term: RefineDataTerm = "charbonnier"
    charbonnier_width: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 0.05
    """Residual, relative to the radiosity, from which on the data term grows linearly."""
    total_variation: NonNegative | None = None
    """Weight of the mean slope magnitude."""
    nonnegativity: NonNegative | None = None
    """Weight of the mean squared depth below the plate in units of 10 um."""
    bare_fraction: Annotated[float, Field(ge=0, le=1)] | None = None
    """At least this fraction of the plate is bare: its height, the median of the lowest such fraction, is
    zero. 0 leaves the mean height alone."""
    exposure: Exposure = "divide"
    """divide: all light together tells the exposure, which is divided out. Else 1 % of light too little is explained
    by a bend of the whole plate of more than 1 mm, which spreads it beyond the window. trust: it is explained so."""
    coarsest_pixels: Annotated[int, Field(ge=2)] | None = None
    """Image size of the first pyramid level, at least: n/2 in the curvature metric, n in the height metric
    from flat, 2n from a given relief, which coarser levels would only blur."""
    finest_pixels: Annotated[int, Field(ge=2)] | None = None
    """Image size of the last level: all pixels on a GPU, at most 2n on a CPU."""
    border_pixels: Annotated[int, Field(ge=0, le=16)] = 1
    """Ring of pixels ignored at every level. What happens at the very edge of a plate is not in the model, and
    2e-5 of the light missing there would be explained by a bend of the whole plate by 3 um."""
    max_iterations: Annotated[int, Field(ge=1)] | None = None
    """Iterations per level."""
    step_m: Annotated[float, Field(gt=0, le=1e-3, allow_inf_nan=False)] | None = None
    """First step of Adam [m] (height metric)."""
    max_time_s: Annotated[float, Field(gt=0)] | None = None
    """Stop after this time [s] with the best relief so far."""
    discrepancy: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1.0
    """Leave a level when the RMS residual falls to this multiple of the noise (Morozov); 0 never does."""

    def resolved(self, metric: Metric, is_flat: bool, scene: Scene, device_type: str) -> "RefineOptions":
        """With every None replaced.

        From flat, priors must be strong: without them folded caustics are fitted by deep trenches. Near the
        truth, weaker ones bias less.
        """
        n = scene.height_samples
        defaults: dict[str, Any] = {"total_variation": 0.03, "nonnegativity": 0.01, "bare_fraction": 0.0}
        defaults |= {"coarsest_pixels": 2 * n, "max_iterations": 300, "step_m": 5e-6}
        if metric == "curvature":
            defaults |= {"total_variation": 0.0, "nonnegativity": 0.0, "bare_fraction": 0.2}
            defaults |= {"coarsest_pixels": max(2, n // 2), "max_iterations": 60}
        elif is_flat:
            defaults |= {"total_variation": 0.1, "nonnegativity": 0.1, "coarsest_pixels": n, "step_m": 1e-5}
        defaults["finest_pixels"] = usual_pixels(scene) if device_type == "cpu" else scene.image_pixels
        known = {key: value for key, value in self.model_dump().items() if value is not None}
        return RefineOptions(**(defaults | known | {"metric": metric}))
