"""A cell's process dies: from one tick on it computes, drives and sends nothing."""

from __future__ import annotations

from typing import Annotated, Literal, final

from pydantic import Field

from bus.spec import CellName, Spec


@final
class CrashFault(Spec):
    """A cell that dies for good at the first tick boundary not before ``at_s``.

    A worker process all of whose cells are dead ends itself by SIGKILL, as a real death does; in a shared
    worker the cell's agent stops. Its wheels do what the scene's stall policy says.
    """

    kind: Literal["crash"] = "crash"
    at_s: Annotated[float, Field(ge=0, allow_inf_nan=False)]
    """Simulated time."""
    cell: CellName
    """``[row, column]``."""
