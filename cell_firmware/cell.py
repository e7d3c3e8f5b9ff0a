"""Firmware in plain Python, for one cell at a time, and its adapter to arrays."""

from __future__ import annotations

import traceback
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, final

import numpy as np

from bus.lattice import SIDES, Lattice
from bus.sensors import CameraFrame
from bus.state_codec import is_record
from cell_firmware.errors import MessageValueError
from cell_firmware.firmware import (
    Bools,
    Cells,
    Firmware,
    Floats,
    Inputs,
    Messages,
    Outputs,
    State,
)
from cell_firmware.firmware_files import modules_beside
from cell_firmware.plain_messages import Message, PlainMessages, Sent
from cell_firmware.plain_registers import registers_of, unrecorded
from cell_firmware.program import Program, Theory
from cell_firmware.random_draws import NO_DRAWS, Draws, no_draws
from cell_firmware.stepping import NOW


@final
@dataclass(frozen=True, slots=True)
class Cell:
    """Identity and geometry of a cell.

    Attributes:
        row: Row, from the bottom.
        column: Column, from the left.
        position_m: Centre of the cell, m.
        neighbours: The sides with a cell on them, of ``north east south west``.
        period_s: The control period, s.
        sensors_m: Its presence sensors, from its centre, m.
        pitch_m: Distance of neighbouring cells, m.
        random: By name, random numbers of the cell in [0, 1) for ``init``, the same at every start of its program.
    """

    row: int
    column: int
    position_m: tuple[float, float]
    neighbours: tuple[str, ...]
    period_s: float
    sensors_m: tuple[tuple[float, float], ...]
    pitch_m: float
    random: Mapping[str, float] = field(default_factory=no_draws)


@final
@dataclass(frozen=True, slots=True)
class CellInputs:
    """Inputs of a cell at the start of a tick.

    Attributes:
        presence: One bit a sensor.
        encoder_m: Surface travel of the two wheels since the start, m; None without encoders.
        inbox: By side, the message that the neighbour sent in the tick before, or None.
        level: How much of each sensor's spot is covered, 0 to 1; None unless sensors are analogue.
        label: Number of the exit that the parcel over the cell is meant for, 0 for none; None without scanners.
        camera: By number of the parcel, x, y (m) and angle (rad) of parcels in a camera frame; None without a frame.
        random: By name, random numbers of the cell and tick in [0, 1), for the names that the program declares.
    """

    presence: tuple[bool, ...]
    encoder_m: tuple[float, float] | None
    inbox: Mapping[str, Message | None]
    level: tuple[float, ...] | None = None
    label: int | None = None
    camera: Mapping[int, tuple[float, float, float]] | None = None
    random: Mapping[str, float] = field(default_factory=no_draws)


@final
@dataclass(frozen=True, slots=True)
class CellOutputs:
    """Outputs of a cell in a tick.

    Attributes:
        speed_m_s: Surface speed along x and y, m/s.
        outbox: By side, the message to that neighbour; a side that is absent or None sends nothing.
        served: Whether the program served its watchdog; used with the effect ``cop`` only.
    """

    speed_m_s: tuple[float, float]
    outbox: Mapping[str, Message | None] = field(default_factory=dict[str, Message | None])
    served: bool = True


class CellFirmware(Program, ABC):
    """A cell's program in plain Python: one cell at a time, any state.

    ``step`` is a function of its arguments: no clock, no chance but ``inputs.random``, nothing shared between cells.
    """

    @abstractmethod
    def init(self, cell: Cell) -> Any:
        """The state before tick 0."""

    def warm_start(self, cell: Cell, state: Any) -> Any:  # noqa: ARG002
        """The state after a watchdog's reset (effect ``cop``): by default that of ``init``.

        Memory keeps its power in such a reset; start-up code clears what a program doesn't set aside.

        Args:
            cell: That is reset.
            state: What the last step that ended returned, or ``init``.
        """
        return self.init(cell)

    @abstractmethod
    def step(self, state: Any, inputs: CellInputs) -> tuple[Any, CellOutputs]:
        """One control period."""


@final
class PerCellAdapter(Firmware):
    """Adapter that runs a ``CellFirmware`` for every cell of an array, in cell order.

    A cell that raises is named in ``Outputs.failed`` with its traceback, and the others are stepped. No cell is stepped
    speculatively, as a user's program may print.

    Args:
        firmware: The program of one cell.
    """

    speculative = False
    refuses_misfits = True
    form = "cell by cell"

    def __init__(self, firmware: CellFirmware) -> None:
        super().__init__(firmware.parameters)
        self.firmware = firmware
        self.observable = firmware.observable  # pyright: ignore[reportIncompatibleVariableOverride, reportAttributeAccessIssue]
        self.message = firmware.message  # pyright: ignore[reportIncompatibleVariableOverride, reportAttributeAccessIssue]
        self.random = firmware.random  # pyright: ignore[reportIncompatibleVariableOverride, reportAttributeAccessIssue]
        self._messages = None if self.message is None else PlainMessages(self.message)

    @property
    def author(self) -> Program:
        """The firmware."""
        return self.firmware

    def check(self, lattice: Lattice) -> None:
        """Delegate to the firmware."""
        self.firmware.check(lattice)

    def check_geometry(self, lattice: Lattice, position_m: Floats, pitch_m: float) -> None:
        """Delegate to the firmware."""
        self.firmware.check_geometry(lattice, position_m, pitch_m)

    def required_effects(self) -> tuple[str, ...]:
        """Delegate to the firmware."""
        return self.firmware.required_effects()

    def uses_camera(self) -> bool:
        """Delegate to the firmware."""
        return self.firmware.uses_camera()

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Delegate to the firmware."""
        return self.firmware.value_ranges()

    def accepts(self, messages: Messages) -> Bools:
        """Delegate to the firmware."""
        return self.firmware.accepts(messages)

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """Delegate to the firmware."""
        return self.firmware.warnings(lattice)

    def theory(self, lattice: Lattice) -> Theory | None:
        """Delegate to the firmware."""
        return self.firmware.theory(lattice)

    def init(self, cells: Cells) -> State:
        """Return one state of any type per cell, in an ``(n,)`` array of objects."""
        states = np.empty(len(cells), dtype=object)
        for i in range(len(cells)):
            states[i] = self.firmware.init(_cell(cells, i))
        return {"cell": states}

    def warm_start(self, cells: Cells, state: State) -> State:
        """Delegate to the firmware, cell by cell."""
        states = np.empty(len(cells), dtype=object)
        for i in range(len(cells)):
            states[i] = self.firmware.warm_start(_cell(cells, i), state["cell"][i])
        return {"cell": states}

    def observables(self, state: State) -> State:
        """The numbers in the cells' own states, by name, ``observed`` among them."""
        return registers_of(state["cell"], self.observable)

    def unrecorded(self, cells: Cells) -> str | None:
        """Why the cells' variables can't be recorded, or not all of them; None if they can."""
        return unrecorded(self.firmware.init(_cell(cells, 0)))

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Step each cell on plain values."""
        n = len(inputs.presence)
        states = state["cell"].copy()
        speeds: list[tuple[float, float]] = []
        sent = Sent(self._messages)
        failed: dict[int, str] = {}
        unserved: list[int] = []
        step = self.firmware.step
        for i, (before, own) in enumerate(
            zip(states.tolist(), _each_inputs(inputs, self._messages), strict=True)
        ):
            speed, NOW.index = _STANDS, i  # the index names the cell in what it prints
            try:
                states[i], outputs = _pair(step(before, own))
                speed = _speed(outputs)
                if not outputs.served:
                    unserved.append(i)
                if outputs.outbox:
                    sent.add(i, outputs.outbox)
            except MessageValueError as error:
                failed[i] = str(error)
            except BaseException:  # noqa: BLE001 - whatever a user's program raises, SystemExit too, is that cell's failure
                failed[i] = traceback.format_exc()
            speeds.append(speed)
        served = None
        if unserved:
            served = np.ones(n, dtype=np.bool_)
            served[unserved] = False
        return {"cell": states}, Outputs(
            np.array(speeds, dtype=np.float64).reshape(n, 2), sent.outbox(n), failed or None, served
        )


_STANDS: Final = (0.0, 0.0)


def records_of(firmware: Firmware) -> tuple[type, ...]:
    """Return the record types that cells' states may hold: dataclasses and named tuples in the program's file.

    Types in modules beside the program's file are included.
    """
    if not isinstance(firmware, PerCellAdapter):
        return ()
    step = type(firmware.firmware).step
    known = [*map(vars, modules_beside(step.__module__)), step.__globals__]
    return tuple(kind for names in known for kind in names.values() if is_record(kind))


def _cell(cells: Cells, i: int) -> Cell:
    return Cell(
        int(cells.row[i]),
        int(cells.column[i]),
        (float(cells.position_m[i, 0]), float(cells.position_m[i, 1])),
        tuple(side for s, side in enumerate(SIDES) if cells.has_neighbour[i, s]),
        cells.period_s,
        tuple((x, y) for x, y in cells.sensors_m.tolist()),
        cells.pitch_m,
        _random(cells.random, i),
    )


def cell_inputs(inputs: Inputs, i: int) -> CellInputs:
    """Return the inputs of one of n cells as plain values."""
    messages = None if inputs.inbox is None else PlainMessages(inputs.inbox.message.dtype)
    return next(iter(_each_inputs(inputs.select(np.array([i])), messages)))


def _each_inputs(inputs: Inputs, messages: PlainMessages | None) -> Iterator[CellInputs]:
    """Yield the inputs of each cell in plain values, converted all at once."""
    n = len(inputs.presence)
    nothing: list[None] = [None] * n
    encoders: Iterable[Any] = nothing if inputs.encoder_m is None else map(tuple, inputs.encoder_m.tolist())
    levels: Iterable[Any] = nothing if inputs.level is None else map(tuple, inputs.level.tolist())
    presences: Iterable[Any] = map(tuple, inputs.presence.tolist())
    inboxes: Iterable[dict[str, Message | None]]
    labels = nothing if inputs.label is None else inputs.label.tolist()
    if inputs.inbox is None or messages is None:
        inboxes = (dict.fromkeys(SIDES) for _ in nothing)
    else:
        inboxes = messages.inboxes(inputs.inbox)
    for presence, encoder, inbox, level, label, random in zip(
        presences, encoders, inboxes, levels, labels, _randoms(inputs.random, n), strict=True
    ):
        # a frame of its own for each cell: a program may keep or change it
        camera = None if inputs.camera is None else _picture(inputs.camera)
        yield CellInputs(presence, encoder, inbox, level, label, camera, random)


def _random(random: Mapping[str, Floats], i: int) -> Mapping[str, float]:
    return Draws({name: float(numbers[i]) for name, numbers in random.items()}) if random else NO_DRAWS


def _randoms(random: Mapping[str, Floats], n: int) -> Iterable[Mapping[str, float]]:
    """Return the random numbers of each of n cells."""
    if not random:
        return [NO_DRAWS] * n
    return (Draws(zip(random, row, strict=True)) for row in np.stack(list(random.values()), axis=1).tolist())


def _picture(picture: CameraFrame) -> dict[int, tuple[float, float, float]]:
    return {
        parcel: (x, y, angle)
        for parcel, (x, y, angle) in zip(picture.parcel.tolist(), picture.pose.tolist(), strict=True)
    }


def _pair(result: Any) -> tuple[Any, CellOutputs]:
    """Return the state and outputs from a program's step; refuse a result of the wrong type."""
    if not (isinstance(result, tuple) and len(result) == 2):  # pyright: ignore[reportUnknownArgumentType]
        raise TypeError(f"step must return (state, CellOutputs), not {type(result).__name__}")  # pyright: ignore[reportUnknownArgumentType]
    pair: tuple[Any, Any] = result  # pyright: ignore[reportUnknownVariableType]
    state, outputs = pair
    if not isinstance(outputs, CellOutputs):
        raise TypeError(f"step must return (state, CellOutputs), not {type(outputs).__name__} as the second")
    return state, outputs


def _speed(outputs: CellOutputs) -> tuple[float, float]:
    given: Any = outputs.speed_m_s
    try:
        x, y = given
    except (TypeError, ValueError):
        raise TypeError(f"speed_m_s must be two numbers, not {given!r}") from None
    if type(x) is float and type(y) is float:
        return x, y
    return _number(x), _number(y)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
        raise TypeError(f"speed_m_s must be two numbers, not {type(value).__name__} {value!r}")  # pyright: ignore[reportUnknownArgumentType]
    return float(value)  # pyright: ignore[reportUnknownArgumentType]
