"""Flow of a running simulation: pause, single steps, pace, and its end on request."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Final, Protocol, final

from deploy.control.pace import Pace
from deploy.control.requests import (
    FlowRequest,
    PauseRequest,
    ResetRequest,
    ResumeRequest,
    SpeedRequest,
    StatusRequest,
    StepRequest,
    StopRequest,
)
from deploy.errors import RequestError
from deploy.util.signals import Interrupted

if TYPE_CHECKING:
    from deploy.recordings.run_log import RunLog

POLL_S: Final = 0.005
"""Interval at which a run that pauses, or waits for its pace, looks for requests, wall seconds."""
_RATE_S: Final = 1.0
"""Wall time over which the real-time factor is measured, s."""


@final
class EndedByOperator(Interrupted):
    """End of a run on request.

    Attributes:
        reset: Whether the run is to begin again.
    """

    def __init__(self, *, reset: bool) -> None:
        super().__init__("reset by an operator" if reset else "stopped by an operator")
        self.reset = reset


class FlowProcess(Protocol):
    """Operations of ``plant.process.PlantProcess`` for the flow."""

    pace: Callable[[int], None] | None
    time_ns: int

    def report(self) -> None:
        """Hand the record of the last tick to the hooks, once."""
        ...

    def idle(self) -> AbstractContextManager[None]:
        """Mark the process as waiting inside the context."""
        ...


@final
class Flow:
    """Flow of a run: running or paused, and its pace.

    A paused run stands between two ticks. No deadline runs then: the cells have answered, and wait.

    Args:
        process: Plant's process.
        run_log: Log of the run, which records commands and reports a lag.
        tick_ns: Length of a tick, ns.
        factor: Simulated seconds per wall second; None: as fast as possible.
        paused: Whether the run begins paused.
        serve: Handles waiting requests while the run stands still.

    Attributes:
        paused: Whether the run is paused before the next tick.
    """

    def __init__(
        self,
        process: FlowProcess,
        run_log: RunLog,
        tick_ns: int,
        factor: float | None,
        *,
        paused: bool,
        serve: Callable[[], None],
    ) -> None:
        self._process = process
        self._run_log = run_log
        self._tick_ns = tick_ns
        self._serve = serve
        self._steps: int | None = 0 if paused else None
        """Ticks until the next pause; None: no pause is due."""
        self._rate_from = (time.monotonic(), process.time_ns)
        self._rate = 0.0
        self._pace: Pace | None = None
        self._set_pace(factor)
        if paused:
            run_log.warn("paused before the first tick; go on with mdms control resume")

    @property
    def paused(self) -> bool:
        """Whether the run is paused before the next tick."""
        return self._steps == 0

    @property
    def stepping(self) -> bool:
        """Whether the run pauses after some more ticks."""
        return bool(self._steps)

    def state(self) -> dict[str, Any]:
        """Return the fields of the flow in answers: ``state``, ``speed``, ``real_time_factor``, ``lag_s``."""
        pace = self._pace
        self._measure()
        return {
            "state": "paused" if self.paused else "running",
            "speed": None if pace is None else pace.factor,
            "real_time_factor": 0.0 if self.paused else self._rate,
            "lag_s": 0.0 if pace is None or self.paused else pace.lag_s,
        }

    def handle(self, request: FlowRequest, tick: int) -> None:
        """Handle a request before ``tick``.

        Raises:
            RequestError: The run is not in the state for it.
            EndedByOperator: The request ends the run.
        """
        match request:
            case StatusRequest():
                return
            case PauseRequest():
                if self._steps is None:
                    self._run_log.warn(f"paused before tick {tick:,}; go on with mdms control resume")
                self._steps = 0
                detail: dict[str, Any] = {}
            case ResumeRequest():
                if self._steps is None:
                    raise RequestError("resume: the run is not paused")
                self._steps = None
                self._restart()
                self._run_log.warn(f"resumed before tick {tick:,}")
                detail = {}
            case StepRequest(ticks=ticks):
                if not self.paused:
                    raise RequestError("step: the run is not paused: pause it first")
                self._steps = ticks
                self._restart()
                detail = {"ticks": ticks}
            case SpeedRequest(factor=factor):
                self._set_pace(factor)
                detail = {"factor": factor}
            case ResetRequest() | StopRequest():
                self._record(request.op, tick, {})
                raise EndedByOperator(reset=isinstance(request, ResetRequest))
        self._record(request.op, tick, detail)

    def before_tick(self) -> None:
        """Return when the next tick is to begin; handle requests while the run is paused."""
        if self.paused:
            self._process.report()
        while self.paused:
            self._wait(POLL_S)
            self._serve()
        if self._steps is not None:
            self._steps -= 1

    def _record(self, kind: str, tick: int, detail: dict[str, Any]) -> None:
        self._run_log.control(
            {"time_s": tick * self._tick_ns * 1e-9, "kind": kind, "tick": tick, "detail": detail}
        )

    # --- the pace ----------------------------------------------------------------------------------

    def _set_pace(self, factor: float | None) -> None:
        self._pace = None if factor is None else Pace(factor, self._run_log.warn, sleep=self._sleep)
        self._process.pace = self._pace

    def _restart(self) -> None:
        """Begin to keep the pace, and to measure it, from now on."""
        if self._pace is not None:
            self._pace.restart()
        self._rate_from = time.monotonic(), self._process.time_ns

    def _sleep(self, seconds: float) -> None:
        """Wait for the pace, and handle requests meanwhile; a pause or another pace ends the wait."""
        pace, until = self._pace, time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0.0 and not self.paused and self._pace is pace:
            self._wait(min(left, POLL_S))
            self._serve()

    def _wait(self, seconds: float) -> None:
        with self._process.idle():
            time.sleep(seconds)

    def _measure(self) -> None:
        """Measure the real-time factor, over a second at least."""
        now, (wall_s, time_ns) = time.monotonic(), self._rate_from
        if now - wall_s >= _RATE_S or not self._rate:
            self._rate = (self._process.time_ns - time_ns) * 1e-9 / max(now - wall_s, 1e-3)
        if now - wall_s >= _RATE_S:
            self._rate_from = now, self._process.time_ns
