"""What every configuration is: frozen, checked, and without keys that nobody reads."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Strict(BaseModel):
    """Base of every configuration; its defaults are checked as well."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)
