"""Base class and common types of all scene specifications."""

from __future__ import annotations

from typing import Annotated, Literal, final

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector = tuple[Finite, Finite]
CellName = tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]]
"""``[row, column]``."""


class Spec(BaseModel):
    """Base of every part of a scene and of every firmware's parameters: frozen, unknown keys refused.

    pydantic builds a part's validator at its first use. Most parts are validated within the scene alone.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, defer_build=True)


Seconds = Annotated[float, Field(gt=0, le=86_400, allow_inf_nan=False)]


@final
class StallSpec(Spec):
    """Handling of cells that disconnect or stall: deadlines, and the policy for their wheels.

    The deadlines are wall time: a run that meets one is recorded as such and its digest promises nothing.
    """

    policy: Literal["coast", "brake", "hold", "abort"] = "coast"
    """Behaviour of a dropped cell's wheels; or ``abort``: end the run."""
    deadline_s: Seconds = 5.0
    """Wall seconds a tick may wait for a cell before the cell counts as stalled."""
    lease_s: Annotated[float, Field(ge=0.1, le=86_400, allow_inf_nan=False)] = 2.0
    """Wall seconds of silence after which a process counts as lost, because it is stopped or its link is cut."""
    start_s: Seconds = 30.0
    """Wall seconds within which every cell must be ready."""
