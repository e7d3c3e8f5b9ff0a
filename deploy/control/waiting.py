"""Control requests to a run that still waits for its cells."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, final

from deploy.control.flow import EndedByOperator
from deploy.control.requests import (
    FlowRequest,
    PauseRequest,
    Request,
    ResumeRequest,
    SpeedRequest,
    StatusRequest,
    StopRequest,
)
from deploy.control.server import read_request
from deploy.errors import RequestError

if TYPE_CHECKING:
    from bus.transports.zenoh.requests import IncomingRequest, RequestQueue

_AT_ONCE: Final = 8
"""Most requests handled at a time."""


@final
class WaitingControl:
    """Control server of a run whose cells are not ready yet; the run's own server takes its queue over.

    A stop ends the wait. A pause, its end and the pace are kept, and act before the first tick. All else is refused,
    since nothing has begun.

    Args:
        run: Name of the run.
        queue: Queue of incoming requests.
        awaited: Describes what the run waits for.
        speed: Simulated seconds per wall second; None: as fast as possible.
        paused: Whether the run begins paused.

    Attributes:
        queue: As given.
        accepted: Requests that act before the first tick, in their order.
        ended: End of the run on request; None: nobody has requested it.
        tick: First tick of the run.
        time_s: Simulated time at its start, s.
    """

    def __init__(
        self,
        run: str,
        queue: RequestQueue,
        awaited: Callable[[], str],
        *,
        speed: float | None,
        paused: bool,
    ) -> None:
        self.queue = queue
        self.accepted: list[FlowRequest] = []
        self.ended: EndedByOperator | None = None
        self.tick, self.time_s = 0, 0.0
        self._run = run
        self._awaited = awaited
        self._speed = speed
        self._paused = paused

    def serve(self) -> None:
        """Answer some of the requests that wait."""
        for _ in range(_AT_ONCE):
            request = self.queue.drain()
            if request is None:
                return
            request.answer(json.dumps({"run": self._run, **self._response(request)}).encode())

    def _response(self, request: IncomingRequest) -> dict[str, Any]:
        try:
            self._handle(read_request(request.payload))
        except RequestError as error:
            return {"ok": False, "problems": error.problems}
        return {
            "ok": True,
            "tick": self.tick,
            "time_s": self.time_s,
            "state": "waiting",
            "waits_for": self._awaited(),
            "paused": self._paused,
            "speed": self._speed,
            "real_time_factor": 0.0,
            "lag_s": 0.0,
        }

    def _handle(self, request: Request) -> None:
        """Note a request.

        Raises:
            RequestError: The run must have begun for it, or is not paused.
        """
        match request:
            case StatusRequest():
                return
            case StopRequest():
                self.ended = EndedByOperator(reset=False)
                return
            case PauseRequest():
                self._paused = True
            case ResumeRequest():
                if not self._paused:
                    raise RequestError("resume: the run is not paused")
                self._paused = False
            case SpeedRequest(factor=factor):
                self._speed = factor
            case _:
                raise RequestError(
                    f"{request.op}: the run has not begun, and takes status, pause, resume, speed and stop alone; it "
                    f"waits for {self._awaited()}"
                )
        self.accepted.append(request)
