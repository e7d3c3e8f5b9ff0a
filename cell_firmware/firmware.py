"""Firmware interface: a pure step of one control period, on arrays of all cells of a process."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import SIDES, Lattice
from bus.sensors import CameraFrame, Labels
from bus.wire.message_type import Leaf, bounded_lists, clear_tails, leaves
from cell_firmware.message_values import misfit, values_of
from cell_firmware.program import Program
from cell_firmware.random_draws import Draws, no_draws

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Messages = NDArray[Any]
State = Mapping[str, NDArray[Any]]
"""Arrays by name, each with one row per cell."""


def opaque_view(array: NDArray[Any]) -> NDArray[Any]:
    """Return a view with opaque items, which NumPy moves at once instead of field by field."""
    return array if array.dtype.names is None else array.view(np.dtype((np.void, array.dtype.itemsize)))


def take_rows(array: NDArray[Any], rows: NDArray[np.int64]) -> NDArray[Any]:
    """``array[rows]``, a tenth of its time for rows of several items."""
    return opaque_view(array).take(rows, axis=0).view(array.dtype)


def select_draws(random: Mapping[str, Floats], rows: NDArray[np.int64]) -> Mapping[str, Floats]:
    """Return the random numbers of ``rows``, in order."""
    return Draws({name: numbers[rows] for name, numbers in random.items()}) if random else random


def put_rows(array: NDArray[Any], rows: NDArray[np.int64], values: NDArray[Any]) -> None:
    """Assign ``array[rows] = values``, in a tenth of the time; ``array`` must be contiguous."""
    if array.ndim == 1 or array.dtype != values.dtype or array.dtype.hasobject:
        opaque_view(array)[rows] = opaque_view(values)
        return
    whole_row = np.dtype((np.void, array.strides[0]))
    array.reshape(len(array), -1).view(whole_row)[rows] = (
        np.ascontiguousarray(values).reshape(len(values), -1).view(whole_row)
    )


@final
@dataclass(frozen=True, slots=True)
class Cells:
    """Identity and geometry of n cells.

    Attributes:
        row: ``(n,)`` int64.
        column: ``(n,)`` int64.
        position_m: ``(n, 2)``, centre of each cell, m.
        has_neighbour: ``(n, 4)``, in the order of ``bus.lattice.SIDES``: is there a cell on that side?
        period_s: The control period, s.
        sensors_m: ``(sensors, 2)``, where each cell has its presence sensors, from its centre, m.
        pitch_m: Distance of neighbouring cells, m.
        random: By name, ``(n,)`` random numbers in [0, 1) for ``init``: always those of tick "before 0".
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    position_m: Floats
    has_neighbour: Bools
    period_s: float
    sensors_m: Floats
    pitch_m: float
    random: Mapping[str, Floats] = field(default_factory=no_draws)

    @property
    def sensors(self) -> int:
        """Presence sensors of a cell."""
        return len(self.sensors_m)

    def __len__(self) -> int:
        return len(self.row)

    def name(self, index: int) -> tuple[int, int]:
        """``(row, column)`` of a cell."""
        return int(self.row[index]), int(self.column[index])

    def select(self, indices: NDArray[np.int64]) -> Cells:
        """Select the cells of ``indices``, in order."""
        return Cells(
            take_rows(self.row, indices),
            take_rows(self.column, indices),
            take_rows(self.position_m, indices),
            take_rows(self.has_neighbour, indices),
            self.period_s,
            self.sensors_m,
            self.pitch_m,
            select_draws(self.random, indices),
        )

    @staticmethod
    def of(
        lattice: Lattice,
        position_m: Floats,
        period_s: float,
        sensors_m: Sequence[tuple[float, float]] = ((0.0, 0.0),),
        *,
        pitch_m: float = 0.1,
    ) -> Cells:
        """All cells of an array, in its order.

        Args:
            lattice: The cells and their neighbours.
            position_m: ``(n, 2)``, centre of each cell, m.
            period_s: The control period, s.
            sensors_m: Presence sensors of a cell, from its centre, m.
            pitch_m: Distance of neighbouring cells, m.
        """
        positions = np.asarray(position_m, dtype=np.float64)
        sensors = np.array(sensors_m, dtype=np.float64).reshape(-1, 2)
        has_neighbour = lattice.neighbours >= 0
        return Cells(lattice.rows, lattice.columns, positions, has_neighbour, period_s, sensors, pitch_m)


@final
@dataclass(frozen=True, slots=True)
class Inbox:
    """Messages that the neighbours sent in the previous tick.

    Attributes:
        received: ``(n, 4)``, whether a message arrived on the side.
        message: ``(n, 4)`` of the firmware's message type; zeros where nothing came.
    """

    received: Bools
    message: Messages


@final
@dataclass(frozen=True, slots=True)
class Inputs:
    """Inputs of cells at the start of a tick.

    Attributes:
        presence: ``(n, sensors)``: is there a parcel over the sensor?
        encoder_m: ``(n, 2)``, surface travel of the two wheels since the start, m; None without encoders.
        inbox: Messages of the tick before; None for firmware that has none.
        level: ``(n, sensors)``, how much of each sensor's spot is covered, 0 to 1; None unless sensors are analogue.
        label: ``(n,)``, number of the exit that the parcel over each cell is meant for, 0: none; None without scanners.
        camera: Frame of a camera, the same for all cells; None in ticks without a frame.
        random: By name, ``(n,)`` random numbers of this tick in [0, 1), for the names that the program declares.
    """

    presence: Bools
    encoder_m: Floats | None = None
    inbox: Inbox | None = None
    level: Floats | None = None
    label: Labels | None = None
    camera: CameraFrame | None = None
    random: Mapping[str, Floats] = field(default_factory=no_draws)

    # spelled out, as dataclasses.replace takes four times as long, and there are two a tick
    def with_presence(self, presence: Bools) -> Inputs:
        """Return these inputs with other presence bits."""
        return Inputs(presence, self.encoder_m, self.inbox, self.level, self.label, self.camera, self.random)

    def with_inbox(self, inbox: Inbox | None) -> Inputs:
        """Return these inputs with other messages."""
        return Inputs(self.presence, self.encoder_m, inbox, self.level, self.label, self.camera, self.random)

    def with_random(self, random: Mapping[str, Floats]) -> Inputs:
        """Return these inputs with other random numbers."""
        return Inputs(self.presence, self.encoder_m, self.inbox, self.level, self.label, self.camera, random)

    def select(self, indices: NDArray[np.int64]) -> Inputs:
        """Select the inputs of ``indices``, in order."""
        encoder_m = None if self.encoder_m is None else take_rows(self.encoder_m, indices)
        inbox = self.inbox and Inbox(
            take_rows(self.inbox.received, indices), take_rows(self.inbox.message, indices)
        )
        level = None if self.level is None else take_rows(self.level, indices)
        label = None if self.label is None else take_rows(self.label, indices)
        presence, random = take_rows(self.presence, indices), select_draws(self.random, indices)
        return Inputs(presence, encoder_m, inbox, level, label, self.camera, random)


@final
@dataclass(frozen=True, slots=True)
class Outbox:
    """Messages to the neighbours, delivered in the next tick.

    Attributes:
        sent: ``(n, 4)``, whether a message is sent on the side; it is ignored where there is no neighbour.
        message: ``(n, 4)`` of the firmware's message type.
    """

    sent: Bools
    message: Messages

    @staticmethod
    def empty(n: int, message: np.dtype[Any]) -> Outbox:
        """An outbox of n cells with nothing in it, to be filled."""
        return Outbox(np.zeros((n, 4), dtype=np.bool_), np.zeros((n, 4), dtype=message))

    @staticmethod
    def to_all(message: np.dtype[Any] | None, **values: NDArray[Any]) -> Outbox:
        """Return an outbox with one message to all sides: ``(n,)`` values by name of the message's fields.

        Raises:
            ValueError: There is no message type, or the names are not those of its fields.
        """
        if message is None:
            raise ValueError("the firmware sends messages but declares no message type")
        if set(values) != set(message.names or ()):
            raise ValueError(
                f"message has fields {sorted(values)}; its type has {sorted(message.names or ())}"
            )
        n = len(next(iter(values.values())))
        outbox = Outbox(np.ones((n, 4), dtype=np.bool_), np.empty((n, 4), dtype=message))
        for name in message.names or ():
            outbox.message[name] = values[name][:, None]
        return outbox

    def settled(self, message: np.dtype[Any]) -> tuple[Outbox, dict[int, str]]:
        """Round messages to the wire type, from a draft of it or any type for which ``can_settle`` holds.

        Args:
            message: The wire type.

        Returns:
            The outbox of the wire type; by cell that sends what doesn't fit, the problem.
        """
        drafts, fixed = self.message, self.message
        if bounded_lists(message):
            drafts = fixed = drafts.copy()
            clear_tails(drafts, message)
        if drafts.dtype != message:
            fixed = np.empty(drafts.shape, dtype=message)
            with np.errstate(all="ignore"):
                for leaf in leaves(message):
                    leaf.of(fixed)[...] = leaf.of(drafts)
        wrong = np.zeros(self.sent.shape, dtype=np.bool_)
        for leaf in leaves(message):
            found = _misfits(leaf, leaf.of(drafts), leaf.of(fixed))
            if found is not None and found.any():
                wrong |= np.logical_or.reduce(found, axis=tuple(range(wrong.ndim, found.ndim)))
        wrong &= self.sent
        problems: dict[int, str] = {}
        for row in np.flatnonzero(wrong.any(axis=1)).tolist():
            side = int(wrong[row].argmax())
            problems[row] = _first_misfit(message, SIDES[side], drafts[row, side], fixed[row, side])
        return Outbox(self.sent, fixed), problems


def _misfits(leaf: Leaf, given: NDArray[Any], rounded: NDArray[Any]) -> Bools | None:
    """Return which numbers of a field don't fit it; None where all do by their type."""
    if leaf.type.kind == "f":
        return ~np.isfinite(rounded)
    if leaf.most is not None:
        return (given != rounded) | (rounded > leaf.most)
    return None if given.dtype == leaf.type else given != rounded


def _first_misfit(message: np.dtype[Any], side: str, given: Any, rounded: Any) -> str:
    """Return the problem of the first number of a message that doesn't fit its field."""
    for value in values_of(message):
        number = np.asarray(value.of(given))
        found = _misfits(value.leaf, number, np.asarray(value.of(rounded)))
        if found is not None and found.any():
            return misfit(value, side, number[()])
    raise AssertionError("this is a bug: a message that fits")


@final
@dataclass(frozen=True, slots=True)
class Outputs:
    """Outputs of cells in a tick.

    Attributes:
        speed_m_s: ``(n, 2)``, surface speed along x and y, m/s.
        outbox: Messages to the neighbours; None if there are none at all.
        failed: Cells that could not be stepped: index to traceback. Their rows are ignored. Array firmware raises
            instead, and the board finds the cell.
        served: ``(n,)``, whether the program served its watchdog; None: all did. Used with the effect ``cop`` only.
    """

    speed_m_s: Floats
    outbox: Outbox | None = None
    failed: Mapping[int, str] | None = None
    served: Bools | None = None


class Firmware(Program, ABC):
    """A cell's program, written on arrays: n cells at once, a single cell being an array of one.

    Both methods are pure: everything that changes is in the state, and the same arguments give the same
    answer. One cell must get the same bits alone and among thousands: so elementwise ``+ - * /``,
    comparisons, ``np.where``, ``np.sqrt``; no ``math``, no ``**``, no reduction across cells, no access to a
    neighbour but through messages. State arrays are handed in read-only.
    """

    speculative: ClassVar[bool] = True
    """Whether ``step`` may be run speculatively: all cells are stepped, and rows of cells not due are rolled back."""

    refuses_misfits: ClassVar[bool] = False
    """Whether ``step`` itself fails a cell that sends what doesn't fit; its messages are then of the wire type."""

    form: ClassVar[str] = "on arrays"
    """Description of the execution, for summaries."""

    def observables(self, state: State) -> State:
        """Return the state visible from outside: arrays by name, each with a row a cell; by default all."""
        return state

    @abstractmethod
    def init(self, cells: Cells) -> State:
        """The state before tick 0: arrays by name, each with one row per cell."""

    def warm_start(self, cells: Cells, state: State) -> State:  # noqa: ARG002
        """The state after a watchdog's reset (effect ``cop``): by default that of ``init``.

        Memory keeps its power in such a reset; start-up code clears what a program doesn't set aside.

        Args:
            cells: That are reset.
            state: What the last step that ended returned for them, or ``init``.
        """
        return self.init(cells)

    @abstractmethod
    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """One control period of every cell."""


@contextmanager
def drafting(firmware: Firmware, draft: np.dtype[Any] | None) -> Generator[None]:
    """Let ``firmware.message`` be the draft while the program is stepped.

    Args:
        firmware: The program.
        draft: Draft of its message type; None: leave the program as it is.
    """
    if draft is None:
        yield
        return
    own: dict[str, Any] = vars(firmware)
    before = own.copy()
    own["message"] = draft
    try:
        yield
    finally:
        if "message" in before:
            own["message"] = before["message"]
        else:
            own.pop("message", None)


def can_settle(given: np.dtype[Any], message: np.dtype[Any]) -> bool:
    """Whether an array's type has the fields of a message type, in whatever numbers."""
    if given.shape != message.shape or given.base.names != message.base.names:
        return False
    if message.base.names is None:
        return given.base.kind in "biuf"
    return all(can_settle(given.base[name], message.base[name]) for name in message.base.names)
