"""What every configuration is: frozen, checked, and without keys that nobody reads."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from warp_caustics.units import record_with_lengths

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Strict(BaseModel):
    """Base of every configuration; its defaults are checked as well. Lengths (``..._m``) may have units, as ``3mm``."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)

    @model_validator(mode="before")
    @classmethod
    def _in_metres(cls, values: Any) -> Any:
        return record_with_lengths(values) if isinstance(values, Mapping) else values
