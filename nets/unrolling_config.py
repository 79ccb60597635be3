"""How the network of ``unrolled`` is iterated, in training and afterwards, and with which photons.

A reconstruction reads it from the weights file, so it lies below the training.
"""

from typing import Annotated

from pydantic import Field, model_validator

from warp_caustics.scene import Placement
from warp_caustics.strict import Finite, Strict

Share = Annotated[Finite, Field(ge=0, le=1)]


class PhotonVariant(Strict):
    """One way to simulate training images; a step takes one of several, so that networks do not learn a lattice."""

    placement: Placement = "lattice"
    """Where photons start."""
    photons_per_pixel: Annotated[Finite, Field(gt=0, le=1000)] = 4.0
    """Light paths per pixel and wavelength."""
    smoothing: Annotated[Finite, Field(ge=0, le=1e4)] | None = None
    """s; the lattice preset's if None."""
    share: Share = 1.0
    """Of the steps, relative to the other variants."""


class StartShares(Strict):
    """Where unrolled iterations start, as shares of a batch."""

    flat: Share = 0.5
    """A flat plate."""
    perturbed: Share = 0.5
    """The true relief, perturbed as in Tab. 3."""
    direct: Share = 0.0
    """The answer of a trained direct network; needs ``direct_weights``."""

    @model_validator(mode="after")
    def _not_empty(self) -> "StartShares":
        if self.flat + self.perturbed + self.direct <= 0:
            raise ValueError("all shares are 0, so nothing starts anywhere; raise one")
        return self


class UnrollingConfig(Strict):
    """Iterations of ``unrolled`` training."""

    first_steps: Annotated[int, Field(ge=1, le=100)] = 1
    """K at the beginning."""
    last_steps: Annotated[int, Field(ge=1, le=100)] = 4
    """K from ``growth_share`` of the run on."""
    growth_share: Share = 0.5
    """Share of the run in which K grows."""
    step_weight_growth: Annotated[Finite, Field(ge=1, le=100)] = 1.5
    """Each step's loss weighs so much more than that of the step before."""
    through_steps: bool = False
    """Back-propagate through the chain of network steps (never through the simulator)."""
    start: StartShares = StartShares()
    direct_weights: str | None = None
    """Weights file of the direct network, which is not trained further."""
    photons: PhotonVariant = PhotonVariant(photons_per_pixel=1.5)
    """Of the simulation in the loop."""

    @model_validator(mode="after")
    def _consistent(self) -> "UnrollingConfig":
        if self.last_steps < self.first_steps:
            raise ValueError(f"last_steps {self.last_steps} is below first_steps {self.first_steps}; raise it")
        if self.start.direct > 0 and self.direct_weights is None:
            raise ValueError(f"a share of {self.start.direct:g} starts at a direct network; give direct_weights")
        return self
