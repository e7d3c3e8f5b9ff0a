"""Source of the page over a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.shard import MESSAGES
from deploy.errors import RequestError
from deploy.faults.fault_state import FaultState
from deploy.recordings.trace import mask_absent
from deploy.view.source import Floats, Instant, Ints, RunState

if TYPE_CHECKING:
    from deploy.recordings.recording import Recording


@final
class ReplaySource:
    """A recording, all of whose instants are there from the beginning; see `RunSource`.

    Args:
        recording: The recording, whole or cut.
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.header = recording.header
        self.live = False
        self.revision = 0
        self.events: Sequence[Mapping[str, Any]] = recording.events
        self.faults: Sequence[Mapping[str, Any]] = recording.faults
        self._times_s = recording.time_s
        own = self.header.get("own_parcels", recording.parcels.shape[1])
        self._states = mask_absent(recording.parcels, self._times_s, own, recording.events)
        self.fault_state = FaultState(self.header["cells"])
        self.fault_state.add(recording.faults)

    @property
    def times_s(self) -> Floats:
        """``(T,)`` simulated time of every instant."""
        return self._times_s

    @property
    def states(self) -> Floats:
        """``(T, m, 6)`` states of the parcels."""
        return self._states

    def at(self, index: int) -> Instant:
        """Return one instant."""
        recording, time_s = self._recording, float(self._times_s[index])
        return Instant(
            int(recording.tick[index]),
            time_s,
            self._states[index],
            recording.held_wheel_speeds.at(index),
            recording.held_presence.at(index),
            self.fault_state.health(time_s),
        )

    def speeds_of(self, cell: int, indices: Ints) -> Floats:
        """Return the wheel speeds of a cell at some instants, ``(k, 2)``."""
        return self._recording.held_wheel_speeds.of(cell, indices)

    def register_names(self) -> Sequence[str]:
        """Return the names of the recorded registers."""
        return list(self._recording.registers)

    def registers(self, index: int) -> tuple[float, Mapping[str, NDArray[Any]]]:
        """Return the registers after the last recorded tick that is over at an instant, and its messages.

        Without registers they are the messages of the last such tick.
        """
        recording = self._recording
        ticks = recording.register_tick if len(recording.register_tick) else recording.message_tick
        row = int(np.searchsorted(ticks, int(recording.tick[index]), side="left")) - 1
        if row < 0:
            return 0.0, {}
        time_s = float(ticks[row] + 1) * self.header["period_ns"] * 1e-9
        found: dict[str, NDArray[Any]] = {}
        if len(recording.register_tick):
            found = {name: values[row] for name, values in recording.registers.items()}
        return time_s, {**found, **self._messages(int(ticks[row]))}

    def _messages(self, tick: int) -> dict[str, NDArray[Any]]:
        """Return the messages sent in a tick, as the registers of a running cell have them; none if not recorded."""
        ticks = self._recording.message_tick
        row = int(np.searchsorted(ticks, tick))
        if row == len(ticks) or int(ticks[row]) != tick:
            return {}
        return {f"{MESSAGES}{name}": values[row] for name, values in self._recording.messages.items()}

    def register_series(self, name: str, cell: int) -> tuple[Floats, Floats]:
        """Return the times and the numbers of a cell's register."""
        times = (self._recording.register_tick.astype(np.float64) + 1.0) * (self.header["period_ns"] * 1e-9)
        values = self._recording.registers[name][:, cell]
        return times, values.reshape(len(times), -1).astype(np.float64)

    def run_state(self) -> RunState:
        """Return the state of a recording."""
        return RunState("recorded")

    def poll(self) -> None:
        """Do nothing: a recording doesn't grow."""

    def allows(self, operation: str) -> bool:  # noqa: ARG002
        """Return False: a recording takes no requests."""
        return False

    def request(self, request: dict[str, Any]) -> dict[str, Any]:
        """Refuse."""
        raise RequestError(f"{request.get('op')}: a recording takes no requests")

    def close(self) -> None:
        """Do nothing."""
