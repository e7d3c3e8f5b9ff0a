"""Serial lines of cells: transfer of messages between neighbours' programs, byte by byte."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.components import LinkDriver, LinkMemory
from cell_firmware.controller import StepTime
from cell_firmware.effects.serial.bursts import BurstType
from cell_firmware.effects.serial.framing import Bytes, Frame
from cell_firmware.effects.serial.mux import PLACE, LineMultiplexer
from cell_firmware.effects.serial.receiver import COUNTERS, ErrorsOf, Receiver
from cell_firmware.effects.serial.sender import Sender
from cell_firmware.effects.serial.timing import LineSettings
from cell_firmware.errors import FirmwareError
from cell_firmware.firmware import Cells, Inbox, Messages, Outbox, State

_COUNTERS = ("sent", *COUNTERS, "replaced")


@final
class SerialLines(LinkDriver):
    """A UART for each side, or a multiplexed one, and the driver that transfers messages as bytes.

    Args:
        settings: Of the lines.
        message: The program's message type.
        window_ns: How long a window of the exchange is; None: a control period.
        errors_of: Clocks' errors, for cells with clocks of their own; None: all are equal.

    Attributes:
        settings: Of the lines.

    Raises:
        FirmwareError: Settings with which no message of this type would ever arrive.
    """

    kernels = "cell_firmware.kernels.uarts"

    def __init__(
        self,
        settings: LineSettings,
        message: np.dtype[Any],
        window_ns: int | None = None,
        errors_of: ErrorsOf | None = None,
    ) -> None:
        self._frame = frame = Frame(message)
        for problem in settings.problems(frame.length):
            raise FirmwareError(f"serial lines: {problem}")
        self._slots = settings.slots(frame.length)
        self._burst = burst = BurstType(self._slots)
        self._window_ns = window = settings.period_ns if window_ns is None else window_ns
        self.settings = settings
        self.line = burst.wire
        self._errors_of = errors_of
        self._sender = Sender(settings, frame, burst, window)
        self._receiver = Receiver(settings, frame, burst, window, errors_of)
        self._scan = None if settings.dwell_periods is None else LineMultiplexer(settings.dwell_periods)

    def init(self, cells: Cells) -> State:
        """Return the state of empty lines, with zero counters."""
        state = {**self._sender.init(cells), **self._receiver.init(cells)}
        if self._scan is not None:
            state.update(self._scan.init(cells))
        if self._errors_of is not None:
            state["ppb"] = self._errors_of(cells.row, cells.column)
        return state

    def constants(self) -> NDArray[Any]:
        """Return what kind of links these are as a record of ``kernels.lines.LINES``; see ``bind``."""
        from cell_firmware.kernels.lines import BYTES, LINES

        links = np.zeros(1, dtype=LINES)
        links["kind"], links["window_ns"], links["period_ns"] = (
            BYTES,
            self._window_ns,
            self.settings.period_ns,
        )
        return links

    def bind(self, state: State) -> LinkMemory:
        """Copy a state into the memory of kernels."""
        from cell_firmware.effects.serial.memory import uart_memory

        return uart_memory(
            state, self._frame, self.settings, self._receiver.times, self._receiver.shifts, self._window_ns
        )

    def reset(self, cells: Cells, state: State) -> State:
        """Empty the lines; counters, which belong to the observer, and the position of the switch are retained."""
        retained = _COUNTERS if self._scan is None else (*_COUNTERS, *PLACE)
        return {**self.init(cells), **{name: state[name] for name in retained}}

    def idle(self, now: StepTime, state: State) -> State:
        """Advance the switch; bytes that are not sent yet wait."""
        return state if self._scan is None else self._scan.advance(now.at_ns[..., None], state)[0]

    def receive(self, now: StepTime, state: State, lines: Inbox) -> tuple[State, Inbox]:
        """Return messages received since the cells' last step; of two on a side the later one."""
        at_ns = now.at_ns[..., None]
        state = self._receiver.queue(self._window(now), state, lines)
        if self._scan is None:
            return self._receiver.read(at_ns, state)
        return self._receiver.read(at_ns, state, *self._scan.selected(state))

    def send(self, now: StepTime, state: State, outbox: Outbox | None) -> tuple[State, Outbox]:
        """Send the bytes that start before the cells' next step."""
        at_ns, left = now.at_ns[..., None], None
        if self._scan is not None:
            state, left = self._scan.advance(at_ns, state)
        ppb = state["ppb"][:, None] if "ppb" in state else None
        return self._sender.step(self._window(now), at_ns, ppb, state, outbox, left)

    @property
    def most_bytes(self) -> int:
        """Bytes that fit on a line from one step of the cells' to the next, one right after another."""
        return min(self.settings.period_ns // self.settings.byte_ns, self._slots)

    def raw(self, now: StepTime, data: Bytes) -> Messages:
        """Return line data of unframed bytes, sent without a gap from the cells' step on.

        Args:
            now: When.
            data: ``(n, 4, most_bytes)``.
        """
        burst = np.zeros(data.shape[:2], dtype=self._burst.parts)
        burst["bytes_1"] = data.shape[2]
        burst["start_1_ns"] = (now.at_ns - self._window(now) * self._window_ns)[..., None]
        burst["byte"][..., : data.shape[2]] = data
        return self._burst.to_wire(burst)

    def _window(self, now: StepTime) -> int:
        """In which window the cells' instants lie: with clocks of their own that which the exchange follows."""
        return now.tick if self._errors_of is None else now.tick - 1

    def registers(self, state: State) -> dict[str, NDArray[Any]]:
        """Return the counters of each side, ``(n, 4)``."""
        return {name: state[name] for name in _COUNTERS}

    def counters(self, state: State) -> dict[str, int]:
        """Return the counters summed over all sides of all cells."""
        return {name: int(state[name].sum()) for name in _COUNTERS}
