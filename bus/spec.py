"""What every part of a scene is made of, whichever package it concerns."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite]
CellName = tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]]
"""``[row, column]``."""


class Spec(BaseModel):
    """Base of every part of a scene and of every firmware's parameters: frozen, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)
