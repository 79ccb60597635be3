"""Configuration of the residual networks, this project's own (``direct`` and ``unrolled``), and their presets by size.

They are not of the paper's family (:mod:`nets.config`): residual blocks with
normalisation, images encoded by their logarithm, and all work at the
resolution of the height map or below.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from warp_caustics.strict import Finite, Strict


class BackboneConfig(Strict):
    """Residual U-Net; the first entry of each tuple is the level at the resolution of the height map."""

    widths: Annotated[tuple[Annotated[int, Field(ge=1, le=2048)], ...], Field(min_length=1, max_length=8)]
    """Channels per level; each level has half the resolution of the one before."""
    depths: Annotated[tuple[Annotated[int, Field(ge=1, le=32)], ...], Field(min_length=1, max_length=8)]
    """Residual blocks per level, on the way down and again on the way up; once at the lowest level."""
    attention_levels: frozenset[Annotated[int, Field(ge=0, le=7)]] = frozenset()
    """Levels whose blocks are followed by self-attention; memory and time grow with the fourth power of their side."""
    head_channels: Annotated[int, Field(ge=1, le=512)] = 64
    """Most channels of one attention head."""
    conditions: Annotated[int, Field(ge=0, le=256)] = 0
    """Numbers that a ``direct`` network is told of its bench, 8 and one for each wavelength (``nets/told.py``); 0: it
    is told nothing, and has no weights for it."""

    @model_validator(mode="after")
    def _consistent(self) -> "BackboneConfig":
        if len(self.depths) != len(self.widths):
            raise ValueError(f"{len(self.depths)} depths for {len(self.widths)} widths; give one per level")
        absent = sorted(level for level in self.attention_levels if level >= len(self.widths))
        if absent:
            raise ValueError(
                f"attention at level {absent[0]}, but the levels are 0 to {len(self.widths) - 1}; "
                "lower it or add a width"
            )
        return self


class EncodingConfig(Strict):
    """How physical quantities become numbers of order one; the inverse is applied to the output."""

    log_floor: Annotated[Finite, Field(gt=0, le=1)] = 0.02
    """eps of log(I + eps), a fraction of the light a flat plate lets through: below it, differences are noise."""
    irradiance_clip: Annotated[Finite, Field(gt=1, le=1e4)] = 4.0
    """Where the raw image is cut, a multiple of the light of a flat plate: focal lines are left to the logarithm."""
    height_unit_m: Annotated[Finite, Field(gt=0, le=1)] = 1e-3
    """Unit of heights inside the network [m]: reliefs are a fraction of a millimetre RMS."""
    slope_clip: Annotated[Finite, Field(gt=0, le=100)] = 4.0
    """Where slopes of the current relief are cut; the 95 % quantile of Tab. 3's reliefs is 1.2."""


class DirectConfig(Strict):
    """A network that maps an image to heights at once."""

    kind: Literal["direct"] = "direct"
    backbone: BackboneConfig
    encoding: EncodingConfig = EncodingConfig()
    told_by: Literal["film", "maps", "picture"] = "film"
    """How what is told of a bench reaches a network with ``backbone.conditions``: it scales and shifts the channels of
    every block (film), or comes as planes beside the picture (maps). With ``picture`` no weights see it: the picture is
    moved by it, as it always is, and no more."""
    feedback: bool = False
    """Whether it is also given an earlier answer of its own and the image that this would make; only with
    ``backbone.conditions``."""

    @model_validator(mode="after")
    def _told(self) -> "DirectConfig":
        if self.feedback and not self.backbone.conditions:
            raise ValueError(
                "feedback is for a network that is told of its bench; set backbone.conditions, as configs/family.yaml "
                "does, or feedback to false"
            )
        if self.told_by != "film" and not self.backbone.conditions:
            raise ValueError(
                f"told_by is {self.told_by}, but the network is told nothing; set backbone.conditions, as "
                "configs/family.yaml does, or leave told_by out"
            )
        return self


class UnrolledConfig(Strict):
    """A network that improves heights, given the image they would make and their gradient."""

    kind: Literal["unrolled"] = "unrolled"
    backbone: BackboneConfig
    encoding: EncodingConfig = EncodingConfig()
    hidden_channels: Annotated[int, Field(ge=0, le=256)] = 0
    """Channels of memory handed from one iteration to the next; 0 for none."""
    numbered_steps: Annotated[int, Field(ge=0, le=1000)] = 0
    """Iterations that the network can tell apart; later ones count as the last. 0: it does not know the iteration."""
    use_gradient: bool = True
    """False leaves the simulator's gradient out, the ablation of the paper."""

    @model_validator(mode="after")
    def _not_told(self) -> "UnrolledConfig":
        if self.backbone.conditions:
            raise ValueError(
                f"backbone.conditions is {self.backbone.conditions}, but only a direct network is told of its bench; "
                "set it to 0"
            )
        return self


_ATTENTION = frozenset({3, 4})
SMALL = BackboneConfig(widths=(32, 48, 64, 96, 96), depths=(2, 2, 2, 2, 1), attention_levels=_ATTENTION)
MEDIUM = BackboneConfig(widths=(64, 96, 128, 160, 192), depths=(2, 2, 2, 2, 2), attention_levels=_ATTENTION)
LARGE = BackboneConfig(widths=(96, 128, 192, 256, 288), depths=(2, 2, 2, 2, 2), attention_levels=_ATTENTION)

RESIDUAL_PRESETS: dict[str, DirectConfig | UnrolledConfig] = {
    "direct-small": DirectConfig(backbone=SMALL),
    "direct": DirectConfig(backbone=MEDIUM),
    "direct-large": DirectConfig(backbone=LARGE),
    "unrolled-small": UnrolledConfig(backbone=SMALL, hidden_channels=8, numbered_steps=16),
    "unrolled": UnrolledConfig(backbone=MEDIUM, hidden_channels=16, numbered_steps=16),
}
"""By size: about 2, 8 and 18 million parameters. At n = 128 the attention levels are 16 x 16 and 8 x 8."""
