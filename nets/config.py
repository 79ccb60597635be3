"""Networks of the paper: the family of Tab. 2 of the supplement, its ranges and its two best members.

``RANGES`` is the only place where limits are spelled: networks are checked
against it and a search draws from it.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

from pydantic import Field, ValidationInfo, field_validator, model_validator

from warp_caustics.strict import Positive, Strict

Nonlinearity = Literal["ELU", "ReLU", "PReLU", "SELU"]


@dataclass(frozen=True)
class Range:
    """Search interval of a number, both ends included.

    Attributes:
        low: lowest value.
        high: highest value.
        is_log: values are drawn evenly in their logarithm.
    """

    low: float
    high: float
    is_log: bool = False

    def __contains__(self, value: float) -> bool:
        return self.low <= value <= self.high

    def __str__(self) -> str:
        return f"between {self.low:g} and {self.high:g}"


@dataclass(frozen=True)
class Choice:
    """Search set of a value."""

    values: tuple[Any, ...]

    def __contains__(self, value: Any) -> bool:
        return value in self.values

    def __str__(self) -> str:
        return f"one of {', '.join(map(str, self.values))}"


RANGES: dict[str, Range | Choice] = {
    "learning_rate": Range(1e-4, 0.1, is_log=True),
    "c_init": Range(1, 32),
    "nonlinearity": Choice(get_args(Nonlinearity)),
    "k_down": Range(2, 11),
    "k_up": Range(2, 11),
    "m_s": Range(1, 8),
    "n_s": Range(1, 4),
    # Tab. 2 prints [2, 11] for m_dec and {2, 4, 8, 16} for k_dec, which look swapped; the best updater
    # (m_dec 8, k_dec 4) fits either way.
    "m_dec": Range(2, 11),
    "k_dec": Choice((2, 4, 8, 16)),
    "lambda_tv": Range(5e-10, 5e-9, is_log=True),
}


class NetworkConfig(Strict):
    """One member of the family (Tab. 2), validated and immutable; unknown fields are refused.

    Fields that a network has no use for are None: the denoiser has no output
    blocks (m_dec, k_dec) and no total variation, the updater no initial block.
    """

    learning_rate: float = Field(description="learning rate of Adam")
    nonlinearity: Nonlinearity = Field(description="nonlinearity after convolutions")
    k_down: int = Field(description="kernel size on the way down")
    k_up: int = Field(description="kernel size on the way up")
    m_s: int = Field(description="channel multiplier per level")
    n_s: int = Field(description="number of skip connections, the depth")
    c_init: int | None = Field(default=None, description="initial number of channels")
    m_dec: int | None = Field(default=None, description="channel divisor of each output block")
    k_dec: int | None = Field(default=None, description="kernel size of each output block")
    lambda_tv: float | None = Field(default=None, description="weight of the total variation in the updater's loss")

    @field_validator("*")
    @classmethod
    def _in_range(cls, value: Any, info: ValidationInfo) -> Any:
        allowed = RANGES[info.field_name or ""]
        if value is not None and value not in allowed:
            raise ValueError(f"{value} is outside the family of networks (Tab. 2); use {allowed}")
        return value


BEST_DENOISER = NetworkConfig(learning_rate=0.00151, c_init=31, nonlinearity="PReLU", k_down=5, k_up=2, m_s=2, n_s=4)
"""Column "Best Denoiser" of Tab. 2."""

BEST_UPDATER = NetworkConfig(
    learning_rate=0.005155,
    nonlinearity="PReLU",
    k_down=9,
    k_up=9,
    m_s=8,
    n_s=1,
    m_dec=8,
    k_dec=4,
    lambda_tv=9.81e-10,
)
"""Column "Best Update" of Tab. 2."""


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
