"""Source of the page over a run in progress."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, Protocol, final

import numpy as np
from numpy.typing import NDArray

from bus.errors import BusError
from deploy.errors import DeployError
from deploy.faults.fault_state import FaultState
from deploy.view.geometry import MOST_DETAILED
from deploy.view.history import History
from deploy.view.source import Floats, Instant, Ints, RunState

if TYPE_CHECKING:
    from deploy.live.frame import RunFrame
    from deploy.recordings.format import Header

_FRAME_S: Final = 0.08
"""Interval between two requests for a frame, wall seconds."""
_REGISTERS_S: Final = 0.5
"""Interval between two requests for registers, wall seconds."""
_SILENCE: Final = 3
"""Requests for a frame without an answer after which the run counts as ended."""


_AGAIN_S: Final = 60.0
"""Longest wait for the run that follows a reset, wall seconds."""
_BEGUN_AGAIN: Final = RunState("begun again")
"""In the place of a frame: a reset has come."""


class Connection(Protocol):
    """Connection to a run in progress; ``deploy.live.client.LiveRun`` is one."""

    header: Header

    def frame(self) -> RunFrame:
        """Return the state of the run, with the events and faults since the last frame."""
        ...

    def request(self, request: dict[str, Any]) -> dict[str, Any]:
        """Send a request, and return the answer."""
        ...

    def registers(self) -> Any:
        """Return the registers of all cells; see ``deploy.control.registers.RegisterReadings``."""
        ...

    def close(self) -> None:
        """Close the connection; the run goes on."""
        ...


@final
class LiveSource:
    """A run in progress; see `RunSource`. Frames are fetched by a thread of its own, and kept for looking back.

    The run answers when it has time to: a page that stalls asks for nothing, and a slow answer delays only the page.

    Args:
        connect: Opens a connection; called again after a reset.
    """

    def __init__(self, connect: Callable[[], Connection]) -> None:
        self._connect = connect
        self._connection = connect()
        self.header = self._connection.header
        self.live = True
        self.revision = 0
        self._events: list[Mapping[str, Any]] = []
        self._faults: list[Mapping[str, Any]] = []
        self.events: Sequence[Mapping[str, Any]] = self._events
        self.faults: Sequence[Mapping[str, Any]] = self._faults
        self.fault_state = FaultState(self.header["cells"])
        self._history = History(len(self.header["cells"]), len(self.header["footprints_m"]))
        self._state = RunState("running")
        self._arrived: deque[RunFrame | RunState] = deque(maxlen=256)
        self._registers: deque[tuple[float, dict[str, NDArray[Any]]]] = deque(maxlen=600)
        self._wants_registers = threading.Event()
        self._stopped = threading.Event()
        self._reset = threading.Event()
        self._runs_on = False
        self._index = {(row, column): i for i, (row, column) in enumerate(self.header["cells"])}
        self._threads = [
            threading.Thread(target=work, name=f"mdms-view-{name}", daemon=True)
            for name, work in (("frames", self._fetch_frames), ("registers", self._fetch_registers))
        ]
        for thread in self._threads:
            thread.start()

    # --- threads -----------------------------------------------------------------------------------

    def _fetch_frames(self) -> None:
        silent = 0
        while not self._stopped.wait(_FRAME_S):
            try:
                frame = self._connection.frame()
            except DeployError:
                silent += 1
                if self._begun_again():
                    silent = 0
                elif silent >= _SILENCE:
                    self._arrived.append(RunState("ended"))
                    return
            else:
                silent = 0
                self._arrived.append(frame)

    def _begun_again(self) -> bool:
        """Connect to the run that follows a reset; False if there was no reset, or no run follows."""
        if not self._reset.is_set():
            return False
        self._reset.clear()
        deadline = time.monotonic() + _AGAIN_S
        while time.monotonic() < deadline and not self._stopped.wait(_FRAME_S):
            try:
                before, self._connection = self._connection, self._connect()
            except DeployError:
                continue
            before.close()
            if self._runs_on:
                with suppress(DeployError):  # which refuses unless it begins paused
                    self._connection.request({"op": "resume"})
            self._arrived.append(_BEGUN_AGAIN)
            return True
        return False

    def _fetch_registers(self) -> None:
        interval_s = _REGISTERS_S if len(self._index) <= MOST_DETAILED else 4 * _REGISTERS_S
        while not self._stopped.wait(interval_s):
            if not self._wants_registers.is_set():
                continue
            self._wants_registers.clear()
            try:
                found = self._connection.registers()
            except (DeployError, BusError):  # of a run that ended, or a connection that was replaced
                continue
            values = self._arrays(found.cells)
            if values:
                time_s = (found.tick + 1) * self.header["period_ns"] * 1e-9
                self._registers.append((time_s, values))

    def _arrays(self, cells: Mapping[tuple[int, int], Mapping[str, Any]]) -> dict[str, NDArray[Any]]:
        """Return registers by name with a row a cell, NaN for cells that did not answer."""
        arrays: dict[str, NDArray[Any]] = {}
        for place, registers in cells.items():
            for name, value in registers.items():
                row = np.atleast_1d(np.asarray(value, dtype=np.float64)).ravel()
                if name not in arrays:
                    arrays[name] = np.full((len(self._index), len(row)), np.nan)
                if arrays[name].shape[1] == len(row) and place in self._index:
                    arrays[name][self._index[place]] = row
        return arrays

    # --- as a source -------------------------------------------------------------------------------

    @property
    def times_s(self) -> Floats:
        """``(T,)`` simulated time of every frame kept."""
        return self._history.times_s

    @property
    def states(self) -> Floats:
        """``(T, m, 6)`` states of the parcels."""
        return self._history.states

    def at(self, index: int) -> Instant:
        """Return one instant."""
        return self._history.at(index)

    def speeds_of(self, cell: int, indices: Ints) -> Floats:
        """Return the wheel speeds of a cell at some instants, ``(k, 2)``."""
        return self._history.speeds_of(cell, indices)

    def register_names(self) -> Sequence[str]:
        """Return the names of the registers that have arrived."""
        if not self._registers:
            self._wants_registers.set()
            return []
        return list(self._registers[-1][1])

    def registers(self, index: int) -> tuple[float, Mapping[str, NDArray[Any]]]:
        """Return the last registers that arrived up to an instant."""
        self._wants_registers.set()
        until_s = float(self.times_s[index]) if index < len(self.times_s) - 1 else np.inf
        for time_s, values in reversed(self._registers):
            if time_s <= until_s:
                return time_s, values
        return 0.0, {}

    def register_series(self, name: str, cell: int) -> tuple[Floats, Floats]:
        """Return the times and the numbers of a cell's register."""
        kept = [(time_s, values[name][cell]) for time_s, values in self._registers if name in values]
        times = np.array([time_s for time_s, _ in kept], dtype=np.float64)
        return times, np.array([row for _, row in kept], dtype=np.float64).reshape(len(kept), -1)

    def run_state(self) -> RunState:
        """Return the state of the run, by its last frame."""
        return self._state

    def poll(self) -> None:
        """Take the frames that have arrived."""
        while self._arrived:
            arrived = self._arrived.popleft()
            if arrived is _BEGUN_AGAIN:
                self._forget()
            elif isinstance(arrived, RunState):
                self._state, self.live = arrived, False  # what was kept is replayed from now on
            else:
                self._take(arrived)

    def _forget(self) -> None:
        """Drop all that is known of the run before a reset."""
        self._events.clear()
        self._faults.clear()
        self._registers.clear()
        self.fault_state = FaultState(self.header["cells"])
        self._history = History(len(self.header["cells"]), len(self.header["footprints_m"]))
        self.revision += 1

    def _take(self, frame: RunFrame) -> None:
        self._state = RunState(str(frame.state), frame.speed, frame.real_time_factor, frame.lag_s)
        self._events.extend(frame.events)
        self._faults.extend(frame.faults)
        self.fault_state.add(frame.faults)
        states = np.where(frame.in_play[:, None], frame.parcels, np.nan)
        speeds = frame.wheel_speeds.astype(np.float32, copy=False)
        instant = Instant(frame.tick, frame.time_s, states, speeds, frame.presence, frame.health)
        if not self._history.add(instant):
            self.revision += 1

    def allows(self, operation: str) -> bool:  # noqa: ARG002
        """Whether the run can still be asked."""
        return self._state.state != "ended"

    def request(self, request: dict[str, Any]) -> dict[str, Any]:
        """Send a request to the run.

        Raises:
            DeployError: The run refuses, or doesn't answer.
        """
        if request["op"] == "reset":
            self._runs_on = self._state.state == "running"
            self._reset.set()
        return self._connection.request(request)

    def close(self) -> None:
        """End the threads and the connection; the run goes on."""
        self._stopped.set()
        for thread in self._threads:
            thread.join(timeout=2.0)
        self._connection.close()
