"""What every section of a configuration has in common."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """Keys with defaults; one that is not known and a value of another type are refused."""

    # strict: "1" is no number and true is no 1; inf is TOML, but no interval
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
