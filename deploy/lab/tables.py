"""Accessors of a lab's cells: registers, programs' states and messages, read and set between two ticks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, cast, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import OPPOSITE, SIDES, Lattice
from cell_firmware.array_view import PROGRAM
from cell_firmware.errors import MessageValueError
from cell_firmware.firmware import Outbox
from cell_firmware.plain_messages import PlainMessages
from cell_firmware.program_variables import PER_CELL, replaced
from deploy.errors import InputError

if TYPE_CHECKING:
    from cell_firmware.shard import Shard

CellName = tuple[int, int]
Message = dict[str, Any]
_LINK: Final = "must be a cell and a side, as in [(1, 2), 'east']"


class _Table:
    """Base of the accessors.

    Args:
        lattice: All cells.
        shard: Returns the shard of all cells.
    """

    def __init__(self, lattice: Lattice, shard: Callable[[], Shard]) -> None:
        self._lattice = lattice
        self._shard = shard

    def _index(self, cell: object) -> int:
        """Return a cell's index in the lattice.

        Raises:
            InputError: There is no such cell.
        """
        return index_of(self._lattice, cell)

    def _row(self, cell: object) -> int:
        """Return a live cell's row in the shard's state.

        Raises:
            InputError: There is no such cell, or it has left for good.
        """
        self._index(cell)
        alive = self._shard().alive
        if cell not in alive:
            raise InputError(f"cell {_shown(cell)}: has died for good, and has no state")
        return alive.index(cast("CellName", cell))

    def _side(self, cell: int, side: object) -> int:
        """Return a side's number.

        Raises:
            InputError: There is no such side, or no neighbour on it.
        """
        if side not in SIDES:
            raise InputError(f"side {side!r}: must be one of {', '.join(SIDES)}")
        number = SIDES.index(cast("str", side))
        if self._lattice.neighbours[cell, number] < 0:
            raise InputError(
                f"side {side!r}: cell {_shown(self._lattice.cells[cell])} has no neighbour there"
            )
        return number


@final
class Registers(_Table):
    """Registers of the cells after the last tick; variables of the program can be set.

    ``registers[name]`` has a row for each cell of the lattice, 0 for cells that died for good;
    ``registers[name, cell]`` is the value of one cell. Both can be assigned to.
    """

    def __getitem__(self, key: str | tuple[str, CellName]) -> Any:
        """Return a register of all cells, or of one.

        Raises:
            InputError: There is no such register or cell.
        """
        name, cell = key if isinstance(key, tuple) else (key, None)
        array = self._array(name)
        if cell is None:
            return array
        self._row(cell)
        return array[self._index(cell)].tolist()

    def __setitem__(self, key: str | tuple[str, CellName], value: Any) -> None:
        """Set a variable of the program of all cells, by a value for all or a row for each, or of one cell.

        Raises:
            InputError: There is no such cell.
            FirmwareError: There is no such variable, or a value doesn't fit.
        """
        name, cell = key if isinstance(key, tuple) else (key, None)
        shard = self._shard()
        if cell is not None:
            rows, values = np.array([self._row(cell)]), np.asarray(value)[None]
        else:
            given = np.asarray(value)
            alive = [self._lattice.index(one) for one in shard.alive]
            rows = np.arange(len(alive))
            each = given.ndim and len(given) == len(self._lattice)
            values = given[alive] if each else np.broadcast_to(given, (len(alive), *given.shape))
        shard.program_state = replaced(shard.program_state, name, rows, values)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __repr__(self) -> str:
        return f"<Registers of {len(self._lattice)} cells: {', '.join(self.names)}>"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all registers, those of the program without the prefix ``firmware.``."""
        return tuple(sorted(name.removeprefix(PROGRAM) for name in self._shard().registers()[1]))

    def _array(self, name: str) -> NDArray[Any]:
        cells, registers = self._shard().registers()
        array = registers.get(f"{PROGRAM}{name}")
        array = registers.get(name) if array is None else array
        if array is None:
            raise InputError(
                f"register {name}: the cells have no such register; they have {', '.join(self.names)}"
            )
        found = np.zeros((len(self._lattice), *array.shape[1:]), dtype=array.dtype)
        found[self._lattice.find(cells[:, 0], cells[:, 1])] = array
        return found


@final
class States(_Table):
    """States of the programs: ``states[cell]`` is the object of a plain program, or the values of arrays by name."""

    def __getitem__(self, cell: CellName) -> Any:
        """Return the state of a cell's program.

        Raises:
            InputError: There is no such cell, or it has died for good.
        """
        row, state = self._row(cell), self._shard().program_state
        if set(state) == {PER_CELL}:
            return state[PER_CELL][row]
        return {name: array[row].tolist() for name, array in state.items()}

    def __setitem__(self, cell: CellName, value: Any) -> None:
        """Set the state of a cell's program.

        Raises:
            InputError: There is no such cell, or it has died for good.
            FirmwareError: A value doesn't fit.
        """
        row, shard = self._row(cell), self._shard()
        state: Mapping[str, NDArray[Any]] = shard.program_state
        if set(state) == {PER_CELL}:
            states = state[PER_CELL]
            states[row] = value
            shard.program_state = {PER_CELL: states}
            return
        for name, one in value.items():
            state = replaced(state, name, np.array([row]), np.asarray(one)[None])
        shard.program_state = state


@final
class MessageSlots(_Table):
    """Messages under way, sent in the last tick: by sender and side (outbox), or by receiver and side (inbox).

    ``messages[cell, side]`` is a dict, or None without a message. An assigned message is read in the next tick, unless
    a fault or an effect of links acts on it.

    Args:
        lattice: All cells.
        shard: Returns the shard of all cells.
        received: Whether cell and side are those of the receiver.
    """

    def __init__(self, lattice: Lattice, shard: Callable[[], Shard], *, received: bool) -> None:
        super().__init__(lattice, shard)
        self._received = received

    def __getitem__(self, key: tuple[CellName, str]) -> Message | None:
        """Return a message.

        Raises:
            InputError: There is no such link.
        """
        cell, side = self._slot(key)
        outbox = self._shard().outbox
        if not outbox.sent[cell, side]:
            return None
        return PlainMessages(outbox.message.dtype).decode(outbox.message[cell, side].tolist())

    def __setitem__(self, key: tuple[CellName, str], message: Mapping[str, Any] | None) -> None:
        """Replace a message; None: it is not sent.

        Raises:
            InputError: There is no such link, or the message has other fields than its type, or values that don't fit.
        """
        cell, side = self._slot(key)
        shard = self._shard()
        outbox = shard.outbox
        outbox.sent[cell, side] = message is not None
        if message is not None:
            names = outbox.message.dtype.names or ()
            if set(message) != set(names):
                raise InputError(
                    f"message: must have the fields {', '.join(names)}, not {', '.join(message)}"
                )
            kind = outbox.message.dtype
            try:
                values = PlainMessages(kind).encode(message, SIDES[side])
            except (MessageValueError, TypeError, ValueError) as error:
                raise InputError(str(error)) from None
            outbox.message[cell, side] = np.array(values, dtype=kind)
        shard.outbox = Outbox(outbox.sent, outbox.message)

    def _slot(self, key: object) -> tuple[int, int]:
        """Return sender and side of a link."""
        if not isinstance(key, tuple) or len(cast("tuple[Any, ...]", key)) != 2:
            raise InputError(f"{key!r}: {_LINK}")
        place, side_name = cast("tuple[Any, Any]", key)
        cell = self._index(place)
        side = self._side(cell, side_name)
        if not self._received:
            return cell, side
        return int(self._lattice.neighbours[cell, side]), OPPOSITE[side]


def index_of(lattice: Lattice, cell: object) -> int:
    """Return a cell's index in a lattice.

    Raises:
        InputError: There is no such cell.
    """
    if cell not in lattice:
        first, last = lattice.cells[0], lattice.cells[-1]
        raise InputError(
            f"cell {_shown(cell)}: the array has no such cell; its {len(lattice)} cells are "
            f"{_shown(first)} to {_shown(last)}"
        )
    return lattice.index(cast("CellName", cell))


def _shown(cell: object) -> str:
    return ",".join(map(str, cast("tuple[Any, ...]", cell))) if isinstance(cell, tuple) else repr(cell)
