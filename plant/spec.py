"""What every part of a scene that concerns physics is made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, cast

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Point = tuple[Finite, Finite]
Cell = tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]]


class Spec(BaseModel):
    """Base of every spec: frozen, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True)


def tagged(key: str, default: str) -> Callable[[object], object]:
    """What a validator does to a table of a tagged union whose tag may be left out: fills in the default."""

    def fill(value: object) -> object:
        if not isinstance(value, dict):
            return value
        return {key: default, **cast("dict[str, object]", value)}

    return fill
