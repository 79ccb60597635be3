"""What a denoiser and an updater of the paper's family are, beside the numbers of Tab. 2."""

from typing import Literal

from pydantic import model_validator

from nets.config import BEST_DENOISER, BEST_UPDATER, NetworkConfig
from warp_caustics.strict import Positive, Strict


class DenoiserConfig(Strict):
    """A denoiser: Tab. 2's numbers and what the tables leave open."""

    kind: Literal["denoiser"] = "denoiser"
    network: NetworkConfig = BEST_DENOISER
    irradiance_unit_W_m2: Positive = 1.0
    """Unit of images inside the network [W/m^2]; 1 is the light of a flat plate in Tab. 1."""
    is_residual: bool = True
    """The network's answer is added to its input. The supplement does not say; it starts near the right answer."""

    @model_validator(mode="after")
    def _complete(self) -> "DenoiserConfig":
        if self.network.c_init is None:
            raise ValueError("a denoiser needs c_init, the initial number of channels; give 1 to 32")
        return self


class UpdaterConfig(Strict):
    """An updater: Tab. 2's numbers and what the tables leave open."""

    kind: Literal["updater"] = "updater"
    network: NetworkConfig = BEST_UPDATER
    use_gradient: bool = True
    """False leaves the simulator's gradient out, the ablation of the paper."""
    irradiance_unit_W_m2: Positive = 1.0
    """Unit of images inside the network [W/m^2]; 1 is the light of a flat plate in Tab. 1."""
    height_unit_m: Positive = 1e-3
    """Unit of heights and of the update inside the network [m]."""
    gradient_unit: Positive = 10.0
    """Unit of the gradient inside the network [W^2/m^5]: its RMS for Tab. 3's perturbed reliefs is 3 to 16."""

    @model_validator(mode="after")
    def _complete(self) -> "UpdaterConfig":
        if self.network.m_dec is None or self.network.k_dec is None:
            raise ValueError("an updater needs m_dec and k_dec, its output blocks; give 2 to 11 and 2, 4, 8 or 16")
        return self


FAMILY_PRESETS: dict[str, DenoiserConfig | UpdaterConfig] = {
    "paper-denoiser": DenoiserConfig(),
    "paper-updater": UpdaterConfig(),
    "paper-updater-no-gradient": UpdaterConfig(use_gradient=False),
}
"""The best members of Tab. 2, and the paper's ablation of the updater."""
