"""Requests of operators to a running simulation."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field

from bus.spec import Finite, Positive, Spec
from deploy.faults.registry import AnyFault

MOST_STEPS: Final = 1_000_000_000
"""Most ticks of one request for steps."""


class InjectRequest(Spec):
    """Request for a fault from the next tick on."""

    op: Literal["inject"]
    fault: Annotated[AnyFault, Field(discriminator="kind")]
    for_s: Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False)] | None = None
    """Simulated time until the repair, s; None: as ``fault.until_s`` says, or no repair."""


class RepairRequest(Spec):
    """Request to repair an active fault at the next tick."""

    op: Literal["repair"]
    number: Annotated[int, Field(ge=0)]


class ListRequest(Spec):
    """Request for the list of faults."""

    op: Literal["list"]


class StatusRequest(Spec):
    """Request for the state of the run: running or paused, its speed."""

    op: Literal["status"]


class PauseRequest(Spec):
    """Request to pause before the next tick."""

    op: Literal["pause"]


class ResumeRequest(Spec):
    """Request to go on after a pause."""

    op: Literal["resume"]


class StepRequest(Spec):
    """Request to run some ticks, then pause; answered when the run has paused."""

    op: Literal["step"]
    ticks: Annotated[int, Field(ge=1, le=MOST_STEPS)] = 1


class SpeedRequest(Spec):
    """Request for another pace."""

    op: Literal["speed"]
    factor: Positive | None
    """Simulated seconds per wall second; None: as fast as possible."""


class ResetRequest(Spec):
    """Request to end the run and begin it again from tick 0, in a new folder."""

    op: Literal["reset"]


class StopRequest(Spec):
    """Request to end the run."""

    op: Literal["stop"]


class MoveRequest(Spec):
    """Request to put a parcel at rest elsewhere, while the run is paused."""

    op: Literal["move"]
    parcel: Annotated[int, Field(ge=0)]
    x_m: Finite
    y_m: Finite
    angle_rad: Finite


class ShowRequest(Spec):
    """Request to publish the cells' registers once more, for observers of a paused run."""

    op: Literal["show"]


FaultRequest = InjectRequest | RepairRequest | ListRequest
FlowRequest = (
    StatusRequest | PauseRequest | ResumeRequest | StepRequest | SpeedRequest | ResetRequest | StopRequest
)
Request = FaultRequest | FlowRequest | MoveRequest | ShowRequest
