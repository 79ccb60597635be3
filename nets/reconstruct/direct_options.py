"""Settings of ``direct``, and which of them are about the bench."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from nets.reconstruct.posterior_samples import MOST_SAMPLES
from nets.reconstruct.refinement import RefinementOptions
from nets.reconstruct.uncertainty import BARE_M
from nets.reconstruct.with_bench import FLATNESS

BENCH_OPTIONS = ("set_up", "priors", "ambient", "bench_uncertainty", "causes", "losses", "samples")
"""Those that are about the bench, which other methods take as it is told, and about what else explains the image."""


class DirectOptions(RefinementOptions):
    """Settings of ``direct``."""

    symmetries: bool = True
    """Mean over all turns and flips that the scene has: more exact, and the source of the uncertainty."""
    second_opinion: bool = True
    """Ask the network that is told of its bench as well, where another was made for the scene, and take what explains
    the image; only of networks that ship."""
    flatness_m: Annotated[float, Field(ge=0, le=1e-2, allow_inf_nan=False)] | None = None
    """Standard deviation of the base from the plane that it is taken for [m]: no image tells a bow, so that only the
    plate's maker can. Part of the standard uncertainty; None: as well known as the bench
    (``nets/reconstruct/with_bench.py``), and where that is told exactly as well as answers agree on bare
    plate. As ``priors["flatness_m"]``, too."""
    max_iterations: Annotated[int, Field(ge=1)] | None = None
    """Of the refinement, in place of ``refine_iterations``: what --max-iterations sets."""
    set_up: Literal["known", "estimate"] | None = None
    """Whether the bench is as it is told, or its numbers are looked for beside the heights; None: they are looked for.
    That takes a tenth longer where nothing differs, and four times as long where something does."""
    priors: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(default_factory=dict)
    """Standard deviations of what is told of it, by name; 0 is exact. Part of the uncertainty, and where numbers are
    looked for what is believed of them before. Of others: a bench that was measured with care."""
    bench_uncertainty: bool = True
    """Whether the standard uncertainty knows how well the bench is known."""
    causes: bool = True
    """Whether what is left of the image is asked what it looks like: light, camera, dirt or a bench other than told."""
    losses: bool | None = None
    """Whether losses of light that the scene leaves out, by reflection and by meeting the relief again, are taken into
    the model where the image shows them; None: on a GPU, where steps take as long with them."""
    samples: Annotated[int, Field(ge=0, le=MOST_SAMPLES)] = 0
    """Reliefs to give besides that explain the image about as well, and differ where it leaves the heights open. Takes
    eight refinements."""
    ambient: Annotated[float, Field(ge=0, le=0.5, allow_inf_nan=False)] = 0.0
    """Stray light that is told, relative to a flat plate's: taken off the image."""

    @property
    def flatness_beside(self) -> float:
        """Of the base [m], where the uncertainty has no part of the bench, which else has it.

        Of a base of which nothing is said, on a bench that is told exactly, what answers to it have in common.
        """
        if self.bench_uncertainty:
            return 0.0
        return BARE_M if self.flatness_m is None else self.flatness_m

    @model_validator(mode="before")
    @classmethod
    def _flatness_is_no_number_to_look_for(cls, given: Any) -> Any:
        """Users say with ``--prior`` how flat the base is, as of all that is not known exactly."""
        if not isinstance(given, dict) or FLATNESS not in (given.get("priors") or {}):
            return given
        others = dict(given["priors"])
        return {FLATNESS: others.pop(FLATNESS), **given, "priors": others}
