"""Transitions of single cells, computed once each: states and messages are numbers."""

from __future__ import annotations

import pickle
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from bus.errors import StateError
from bus.state_codec import encode
from cell_firmware.array_view import PROGRAM
from cell_firmware.board import PROGRAM as PART
from cell_firmware.board import Board
from cell_firmware.cell import records_of
from cell_firmware.controller import ControllerState, StepTime, read_only
from cell_firmware.firmware import Cells, Firmware, Inbox, Inputs, State

NO_MESSAGE: Final = 0
Key = tuple[int, int, int, int, int, int, int]
"""Cell, number of its state, whether it is covered, and numbers of the messages from the four sides."""


class Step(NamedTuple):
    """Result of a control period of one cell.

    Attributes:
        state: Number of the next state.
        sent: Numbers of the messages to the four sides.
        failure: Problem of a program that failed; empty otherwise.
        speed_m_s: Surface speed along x and y, m/s.
    """

    state: int
    sent: tuple[int, int, int, int]
    failure: str
    speed_m_s: tuple[float, float]


@final
class Transitions:
    """Transitions of a program's cells, with numbers for states and messages.

    A step is a function of its arguments and has the same bits for one cell and for many, so that rows of one call may
    be any cells in any states.

    Args:
        program: The program.
        cells: All cells of the world.
        sensors: Presence sensors of a cell.

    Attributes:
        computed: Number of transitions that were computed.
    """

    def __init__(self, program: Firmware, cells: Cells, sensors: int = 1) -> None:
        self._program = program
        self._board = Board(program)
        self._cells = cells
        self._sensors = sensors
        self._records = {kind.__qualname__: kind for kind in records_of(program)}
        self._there = cells.has_neighbour
        state = dict(self._board.init(cells).parts[PART])
        self._types = self._settled_types(state)
        self._rows: dict[str, list[Any]] = {name: [] for name in state}
        self._states: dict[bytes, int] = {}
        self._messages: dict[bytes, int] = {b"": NO_MESSAGE}
        self._payloads: list[bytes] = [b""]
        self._memo: dict[Key, Step] = {}
        self.computed = 0
        self.initial = self.numbers(state)

    def _settled_types(self, state: State) -> dict[str, np.dtype[Any]]:
        """Return the types of the state's arrays after a step, which may be wider than those of ``init``."""
        n, message = len(self._cells), self._program.message
        inbox = None
        if message is not None:
            inbox = Inbox(np.zeros((n, 4), dtype=np.bool_), np.zeros((n, 4), dtype=message))
        after, _ = self._compute(np.arange(n), state, np.zeros((n, self._sensors), dtype=np.bool_), inbox)
        return {name: np.result_type(array, after[name]) for name, array in state.items()}

    def numbers(self, state: State) -> tuple[int, ...]:
        """Return the number of each row's state."""
        arrays = {
            name: np.asarray(array).astype(self._types[name], copy=False) for name, array in state.items()
        }
        keys = self._row_keys(arrays)
        found: list[int] = []
        for row, key in enumerate(keys):
            number = self._states.get(key)
            if number is None:
                number = self._states[key] = len(self._states)
                for name, array in arrays.items():
                    self._rows[name].append(array[row])
            found.append(number)
        return tuple(found)

    def state(self, numbers: Sequence[int]) -> State:
        """Return the states of these numbers, a row each."""
        found: dict[str, NDArray[Any]] = {}
        for name, rows in self._rows.items():
            if self._types[name].hasobject:
                found[name] = np.empty(len(numbers), dtype=object)
                for i, number in enumerate(numbers):
                    found[name][i] = rows[number]
            else:
                found[name] = np.array([rows[number] for number in numbers], dtype=self._types[name])
        return found

    def registers(self, numbers: Sequence[int]) -> dict[str, NDArray[Any]]:
        """Return the registers of cells in states of these numbers, a row each, by full name."""
        observed = self._program.observables(read_only(self.state(numbers)))
        return {PROGRAM + name: array for name, array in observed.items()}

    def steps(self, keys: Iterable[Key]) -> Mapping[Key, Step]:
        """Return the memory of all steps, with these computed: in one call, as far as they are missing."""
        missing = sorted({key for key in keys if key not in self._memo})
        if missing:
            self._compute_all(missing)
        return self._memo

    def known(self) -> Mapping[Key, Step]:
        """All steps so far."""
        return self._memo

    def _compute_all(self, keys: list[Key]) -> None:
        self.computed += len(keys)
        rows = np.array([key[0] for key in keys])
        presence = np.array([[bool(key[2])] * self._sensors for key in keys])
        inbox, message = None, self._program.message
        if message is not None:
            heard = [number for key in keys for number in key[3:]]
            received = np.array(heard) != NO_MESSAGE
            blank = bytes(message.itemsize)
            raw = b"".join(self._payloads[number] or blank for number in heard)
            words = np.frombuffer(bytearray(raw), dtype=message).reshape(-1, 4)
            inbox = Inbox(received.reshape(-1, 4), words)
        state, outputs = self._compute(rows, self.state([key[1] for key in keys]), presence, inbox)
        after = self.numbers(state)
        sent = self._sent(outputs.outbox, rows)
        speeds = outputs.drive.tolist()
        for i, key in enumerate(keys):
            failure = outputs.failures.get(i)
            self._memo[key] = Step(
                after[i], sent[i], "" if failure is None else failure.problem, tuple(speeds[i])
            )

    def _compute(
        self, rows: NDArray[np.int64], state: State, presence: NDArray[np.bool_], inbox: Inbox | None
    ) -> tuple[State, Any]:
        whole = ControllerState(self._cells.select(rows), {PART: read_only(dict(state))})
        done, outputs = self._board.compute(StepTime(0, np.array(0)), whole, Inputs(presence, None, inbox))
        return done.parts[PART], outputs

    def _sent(self, outbox: Any, rows: NDArray[np.int64]) -> list[tuple[int, int, int, int]]:
        if outbox is None:
            return [(NO_MESSAGE, NO_MESSAGE, NO_MESSAGE, NO_MESSAGE)] * len(rows)
        sent = (outbox.sent & self._there[rows]).tolist()
        words = np.ascontiguousarray(outbox.message)
        found: list[Any] = []
        for i, flags in enumerate(sent):
            numbers = [NO_MESSAGE] * 4
            for side in range(4):
                if flags[side]:
                    payload = words[i, side].tobytes()
                    number = self._messages.get(payload)
                    if number is None:
                        number = self._messages[payload] = len(self._payloads)
                        self._payloads.append(payload)
                    numbers[side] = number
            found.append(tuple(numbers))
        return found

    def _row_keys(self, arrays: Mapping[str, NDArray[Any]]) -> list[bytes]:
        """Return bytes that two rows share if their states are equal."""
        n = len(next(iter(arrays.values()))) if arrays else len(self._cells)
        parts: list[list[bytes]] = []
        for array in arrays.values():
            if array.dtype.hasobject:
                parts.append([self._object_key(one) for one in array.tolist()])
            else:
                flat = np.ascontiguousarray(array).reshape(n, -1)
                parts.append([row.tobytes() for row in flat])
        return [b"|".join(row) for row in zip(*parts, strict=True)] if parts else [b""] * n

    def _object_key(self, value: Any) -> bytes:
        try:
            return encode(value, self._records)
        except StateError:
            return pickle.dumps(value)
