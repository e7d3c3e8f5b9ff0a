"""Requests to a running simulation, as JSON."""

from __future__ import annotations

import json
from typing import Annotated, Any, Final, Literal, cast

from pydantic import Field, ValidationError, field_validator

from bus.spec import Spec
from deploy.errors import DeployError
from deploy.faults.registry import Fault
from deploy.scenes.errors import problems_of, strictly

_LONGEST: Final = 65_536
_MOST_PROBLEMS: Final = 20
"""Most problems that an answer lists, which bounds the length of the answer."""


def _kind_of(fault: object) -> object:
    return cast("dict[str, object]", fault).get("kind") if isinstance(fault, dict) else None


class InjectRequest(Spec):
    """Request for a fault from the next tick on."""

    op: Literal["inject"]
    fault: Fault
    for_s: Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False)] | None = None
    """Simulated time until the repair, s; None: as ``fault.until_s`` says, or no repair."""

    @field_validator("fault", mode="before")
    @classmethod
    def _can_begin_now(cls, fault: object) -> object:
        if _kind_of(fault) == "add":
            raise ValueError(
                "add is for scenes: inject remove, and repair that fault to plug the cells in again"
            )
        return fault


class RepairRequest(Spec):
    """Request to repair an active fault at the next tick."""

    op: Literal["repair"]
    number: Annotated[int, Field(ge=0)]


class ListRequest(Spec):
    """Request for the list of faults."""

    op: Literal["list"]


Request = InjectRequest | RepairRequest | ListRequest


class _Envelope(Spec):
    request: Annotated[Request, Field(discriminator="op")]


class RequestError(DeployError):
    """A request that the run refuses.

    Attributes:
        problems: Reasons, one line each.
    """

    def __init__(self, *problems: str) -> None:
        super().__init__("; ".join(problems))
        self.problems = problems


def read_request(payload: bytes | None) -> Request:
    """Decode and check a request.

    Args:
        payload: JSON; None for a payload that was too long to be received.

    Raises:
        RequestError: The payload is no valid request.
    """
    if payload is None or len(payload) > _LONGEST:
        raise RequestError(f"a request: must be at most {_LONGEST} bytes")
    try:
        data: Any = {"request": json.loads(payload)}
    except (ValueError, RecursionError):
        raise RequestError("a request: must be JSON with a few levels of nesting") from None
    try:
        return strictly(_Envelope, data).request
    except ValidationError as error:
        problems = problems_of(error, data, _Envelope)
        listed = [str(problem).removeprefix("request.") for problem in problems[:_MOST_PROBLEMS]]
        if len(problems) > _MOST_PROBLEMS:
            listed.append(f"and {len(problems) - _MOST_PROBLEMS} more")
        raise RequestError(*listed) from None
