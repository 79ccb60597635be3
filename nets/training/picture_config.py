"""Which pictures other than those of the run's scene a network in training sees."""

from typing import Annotated

from pydantic import Field, model_validator

from nets.unrolling_config import Share
from warp_caustics.strict import Strict


class PictureConfig(Strict):
    """Shares of the visits that see what users with fewer wavelengths or pixels have; see ``pictures.py``."""

    one_wavelength_share: Share = 0.0
    """Have the middle wavelength alone, in all channels; a dispersion of 0 is told."""
    two_wavelengths_share: Share = 0.0
    """Lack one of the others, any of them, whose channel shows the middle one; its dispersion is told as 0."""
    coarse_share: Share = 0.0
    """Come from an image of fewer pixels."""
    coarse_binning: Annotated[int, Field(ge=2, le=16)] = 2
    """Pixels per side that are one in such an image."""

    @model_validator(mode="after")
    def _consistent(self) -> "PictureConfig":
        if self.one_wavelength_share + self.two_wavelengths_share > 1:
            raise ValueError(
                f"one_wavelength_share {self.one_wavelength_share:g} and two_wavelengths_share "
                f"{self.two_wavelengths_share:g} are more than 1 together; lower one"
            )
        return self

    @property
    def is_off(self) -> bool:
        """Whether all pictures are those of the run's scene."""
        return not (self.one_wavelength_share or self.two_wavelengths_share or self.coarse_share)
