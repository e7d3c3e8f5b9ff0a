"""Feed of a running simulation: answers viewers' requests for frames between two ticks.

A viewer gets a frame when it asks for one. A viewer that stalls, or leaves, doesn't ask, and costs the run nothing.
"""

from __future__ import annotations

import json
from collections import deque
from typing import TYPE_CHECKING, Any, Final, cast, final

import numpy as np

from deploy.live.frame import FAULTY, LOST, RunFrame
from deploy.recordings.run_log import event_record

if TYPE_CHECKING:
    from bus.transports.zenoh.requests import RequestQueue
    from deploy.control.server import ControlServer
    from deploy.recordings.format import Header
    from deploy.recordings.run_log import RunLog
    from plant.plant import Plant
    from plant.process import PlantProcess
    from plant.tick import TickRecord

_A_TICK: Final = 4
"""Most frames sent between two ticks; the other viewers wait."""
_EVENTS: Final = 10_000
"""Events kept for viewers; the oldest are dropped first."""
_AT_ONCE: Final = 1_000
"""Most events, and most faults, in a frame; the others follow in the next."""


@final
class Feed:
    """Source of frames for the viewers of a run.

    Args:
        requests: Queue of requests for frames.
        process: Plant's process.
        plant: The plant.
        control: Control server of the run.
        run_log: Log of the run.
        header: Header of the run's recording, sent to viewers on request.
    """

    def __init__(
        self,
        requests: RequestQueue,
        process: PlantProcess,
        plant: Plant,
        control: ControlServer,
        run_log: RunLog,
        header: Header,
    ) -> None:
        self._requests = requests
        self._process = process
        self._plant = plant
        self._control = control
        self._run_log = run_log
        self._header = header
        self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS)
        self._dropped = 0

    def after_tick(self, record: TickRecord) -> None:
        """Keep the events of a tick; a hook."""
        if record.events:
            self._dropped += max(len(self._events) + len(record.events) - _EVENTS, 0)
            self._events.extend(map(event_record, record.events))

    def serve(self) -> None:
        """Answer some of the requests for frames that wait."""
        for _ in range(_A_TICK):
            question = self._requests.drain()
            if question is None:
                return
            events, faults, header = _read(question.payload)
            self._process.report()
            question.answer(self._frame(events, faults).encode(self._header if header else None))

    def _frame(self, events_from: int, faults_from: int) -> RunFrame:
        process, plant, flow = self._process, self._plant, self._control.flow.state()
        state = plant.state
        in_play = np.zeros(len(state), dtype=np.bool_)
        in_play[plant.on_surface] = True
        first = min(max(events_from, self._dropped), self._dropped + len(self._events))
        found = list(self._events)[first - self._dropped :][:_AT_ONCE]
        return RunFrame(
            tick=process.tick,
            time_s=process.time_ns * 1e-9,
            parcels=state,
            in_play=in_play,
            status=tuple(status.state for status in plant.status),
            wheel_speeds=plant.wheel_speed.astype(np.float32),
            presence=process.sense.presence,
            health=self._health(),
            state=flow["state"],
            speed=flow["speed"],
            real_time_factor=flow["real_time_factor"],
            lag_s=flow["lag_s"],
            events=tuple(found),
            faults=tuple(dict(fault) for fault in self._run_log.faults[faults_from:][:_AT_ONCE]),
            first_event=first,
        )

    def _health(self) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Return the health of every cell, ``(n,)``."""
        process = self._process
        health = np.zeros(len(process.sense.presence), dtype=np.uint8)
        for one in self._control.faults.active(process.tick):
            health[one.cells] = LOST if one.fault.kind_name == "crash" else FAULTY
        health[process.lost] = LOST
        return health


def _read(payload: bytes | None) -> tuple[int, int, bool]:
    """Return where the events and the faults of the frame begin, and whether the header is wanted.

    A payload that is no request for a frame counts as one for a frame without a header and without events.
    """
    nothing = 2**62
    try:
        found = json.loads(payload or b"")
        fields = cast("dict[str, Any]", found) if isinstance(found, dict) else {}
        return (
            max(int(fields.get("events", nothing)), 0),
            max(int(fields.get("faults", nothing)), 0),
            fields.get("header") is True,
        )
    except (ValueError, TypeError, OverflowError, RecursionError):
        return nothing, nothing, False
