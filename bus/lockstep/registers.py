"""Register publishing: named registers and counters of a shard's cells, for the plant and for observers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, cast, final

import numpy as np
from numpy.typing import NDArray

from bus.errors import WireError
from bus.lattice import Lattice
from bus.lockstep.counters import MessageCounters
from bus.partition import Partition
from bus.transports.base import Publisher
from bus.wire.msgpack_codec import VERSION, binary, layout, packer, reader

NAMES_LIMIT: Final = 256
"""Most registers of a cell, and longest name of one, characters."""
COLUMNS_LIMIT: Final = 64
"""Most numbers that a register of one cell holds."""
_LAYOUT: Final = layout("cells", "registers")
_TYPES: Final = frozenset(("|b1", "|u1", "<u2", "<u4", "<u8", "|i1", "<i2", "<i4", "<i8", "<f4", "<f8"))
_PLACES: Final = np.dtype("<i4")
_PAIR: Final = 2 * _PLACES.itemsize


class RegisterFrame(NamedTuple):
    """The registers of some cells after a tick.

    Attributes:
        tick: The tick that they have computed.
        cells: ``(n, 2)`` integers, row and column of each.
        registers: By name, arrays with a row a cell.
    """

    tick: int
    cells: NDArray[Any]
    registers: Mapping[str, NDArray[Any]]


class RegisterRequest(NamedTuple):
    """Request of the plant for registers.

    Attributes:
        every: Interval between two snapshots, ticks.
        names: Names of the registers; None: all.
    """

    every: int
    names: frozenset[str] | None = None


def requested_at(wanted: Iterable[RegisterRequest], tick: int) -> RegisterRequest | None:
    """Merge the requests that are due in a tick into one; None if no request is due."""
    found = [one.names for one in wanted if tick % one.every == 0]
    if not found:
        return None
    named = [names for names in found if names is not None]
    return RegisterRequest(1, frozenset[str]().union(*named) if len(named) == len(found) else None)


class RegisterSnapshot(NamedTuple):
    """The registers of all cells after a tick, in the lattice's order.

    Attributes:
        tick: The tick that they have computed.
        cells: ``(n,)``, marks cells whose registers were received.
        registers: By name, arrays with a row a cell; zero for cells without registers.
    """

    tick: int
    cells: NDArray[np.bool_]
    registers: Mapping[str, NDArray[Any]]


def merge_frames(frames: Sequence[RegisterFrame], lattice: Lattice) -> list[RegisterSnapshot]:
    """Merge frames of several shards into one snapshot a tick.

    Args:
        frames: Frames of cells in the lattice. A register whose shape differs from that in an earlier frame has NaN
            in the rows of the later frame's cells, or zero in types without NaN.
        lattice: The cells.
    """
    by_tick: dict[int, list[RegisterFrame]] = {}
    for frame in frames:
        by_tick.setdefault(frame.tick, []).append(frame)
    n = len(lattice)
    found: list[RegisterSnapshot] = []
    for tick, together in by_tick.items():
        cells = np.zeros(n, dtype=np.bool_)
        registers: dict[str, NDArray[Any]] = {}
        for frame in together:
            rows = lattice.find(*frame.cells.T.astype(np.int64))
            cells[rows] = True
            for name, array in frame.registers.items():
                own = registers.get(name)
                if own is None:
                    own = registers[name] = np.zeros((n, *array.shape[1:]), dtype=array.dtype)
                elif own.dtype != array.dtype:
                    own = registers[name] = own.astype(np.result_type(own, array))
                if own.shape[1:] == array.shape[1:]:
                    own[rows] = array
                elif own.dtype.kind == "f":
                    own[rows] = np.nan
        found.append(RegisterSnapshot(tick, cells, registers))
    return found


def encodable(arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Select arrays that can be encoded: little-endian numbers and booleans, one at least a cell, limited in number."""
    fit: dict[str, NDArray[Any]] = {}
    for name, array in list(arrays.items())[:NAMES_LIMIT]:
        numbers = array.astype(array.dtype.newbyteorder("<"), copy=False)
        wide = int(np.prod(array.shape[1:], dtype=np.int64))
        named = len(name) <= NAMES_LIMIT and name.isprintable()
        if numbers.dtype.str in _TYPES and 0 < wide <= COLUMNS_LIMIT and named:
            fit[name] = numbers
    return fit


def encode_registers(frame: RegisterFrame) -> bytes:
    """Encode a frame whose registers passed ``encodable``."""
    return packer()(
        {
            "v": VERSION,
            "tick": frame.tick,
            "cells": frame.cells.astype(_PLACES, copy=False).tobytes(),
            "registers": {
                name: [array.dtype.str, list(array.shape[1:]), array.tobytes()]
                for name, array in frame.registers.items()
            },
        }
    )


def decode_registers(payload: bytes, cells: int) -> RegisterFrame:
    """A frame of at most ``cells`` cells.

    Raises:
        WireError: Anything else.
    """
    limit = cells * (_PAIR + 8 * NAMES_LIMIT) + NAMES_LIMIT * (4 * NAMES_LIMIT + 64)
    tick, fields = reader("registers", limit, _LAYOUT)(payload)
    places = fields["cells"]
    if type(places) is not bytes or len(places) % _PAIR or len(places) > cells * _PAIR:
        raise WireError("registers", "cells", f"must be bytes, {_PAIR} for each of at most {cells} cells")
    found = fields["registers"]
    if type(found) is not dict or len(cast("dict[Any, Any]", found)) > NAMES_LIMIT:
        raise WireError("registers", "type", f"registers must be a map of at most {NAMES_LIMIT}")
    n = len(places) // _PAIR
    registers = {_name(name): _array(value, n) for name, value in cast("dict[object, object]", found).items()}
    return RegisterFrame(tick, np.frombuffer(places, _PLACES).reshape(n, 2), registers)


def _name(name: object) -> str:
    # They are shown on terminals: nothing that moves the cursor, say.
    if type(name) is not str or len(name) > NAMES_LIMIT or not name.isprintable():
        raise WireError(
            "registers", "type", f"a name must be text of at most {NAMES_LIMIT} printable characters"
        )
    return name


def _array(value: object, rows: int) -> NDArray[Any]:
    """An array from its type, the shape of a row, and its bytes."""
    if type(value) is not list or len(cast("list[object]", value)) != 3:
        raise WireError("registers", "type", "a register must be its type, its shape and its bytes")
    code, shape, data = cast("list[Any]", value)
    if type(code) is not str or code not in _TYPES:
        raise WireError("registers", "type", "a register must hold numbers or booleans")
    if type(shape) is not list or not all(
        type(size) is int and 0 < size <= COLUMNS_LIMIT for size in cast("list[Any]", shape)
    ):
        raise WireError("registers", "shape", f"must be a list of numbers in 1..{COLUMNS_LIMIT}")
    sizes = cast("list[int]", shape)
    wide = 1
    for size in sizes:
        wide *= size
        if wide > COLUMNS_LIMIT:
            raise WireError(
                "registers", "shape", f"a cell's register must hold at most {COLUMNS_LIMIT} numbers"
            )
    dtype = np.dtype(code)
    raw = binary("registers", data, rows * wide * dtype.itemsize)
    if dtype.kind == "b" and set(raw) - {0, 1}:
        raise WireError("registers", "type", "a boolean must be 0 or 1")
    return np.frombuffer(raw, dtype).reshape(rows, *sizes)


_SHOW_S: Final = 0.2
"""Interval at which the registers are checked for observers, and published to them, wall seconds."""

Own = tuple[NDArray[np.int64], Mapping[str, NDArray[Any]]]
"""Rows and columns of cells, ``(n, 2)``, and registers by name, arrays with a row a cell."""


@final
class RegisterPublisher:
    """Publisher of the registers of a shard's cells.

    Args:
        publisher: Publisher on the shard's registers key.
        wanted: Requests of the plant.
        counts: Counters to update.
        clock: Monotonic wall seconds.

    Attributes:
        read: Returns the registers, for observers that ask before a tick has published any.
        next_look: Wall seconds by ``clock`` from which ``is_idle`` looks for observers again.
    """

    def __init__(
        self,
        publisher: Publisher,
        wanted: Sequence[RegisterRequest],
        counts: MessageCounters,
        clock: Callable[[], float],
    ) -> None:
        self.publisher = publisher
        self.requests = tuple(wanted)
        self._counts = counts
        self._clock = clock
        self.next_look = 0.0
        self._observed = False
        """Whether an observer was found and has not been shown the registers since."""
        self.read: Callable[[], Own] | None = None

    def is_idle(self) -> bool:
        """Return whether ``publish`` has nothing to do: neither the plant nor an observer requests registers."""
        return not self.requests and not self._is_observed()

    def publish(self, tick: int, read: Callable[[], Own]) -> None:
        """Publish the registers after ``tick`` if the plant or another observer requests them.

        Args:
            tick: The tick just computed.
            read: Returns the registers; called only if they are requested.
        """
        self.read = read
        wanted = requested_at(self.requests, tick) if self.requests else None
        if (wanted is None or wanted.names is not None) and self._is_observed():
            self._observed = False
            wanted = RegisterRequest(1)
        if wanted is None:
            return
        cells, registers = read()
        if wanted.names is not None:
            registers = {name: array for name, array in registers.items() if name in wanted.names}
        self.publisher.put(encode_registers(RegisterFrame(tick, cells, encodable(registers))))
        self._counts.sent += 1

    def show(self, tick: int) -> None:
        """Publish the registers after ``tick``, the last tick, once more if they have an observer; not counted."""
        if self.read is not None and tick >= 0 and self.publisher.matched():
            cells, registers = self.read()
            self.publisher.put(encode_registers(RegisterFrame(tick, cells, encodable(registers))))

    def _is_observed(self) -> bool:
        """Return whether the registers are to be shown to an observer, looked for a few times a second."""
        now = self._clock()
        if now >= self.next_look:
            self.next_look = now + _SHOW_S
            self._observed = self.publisher.matched()
        return self._observed


@final
class RegisterReceiver:
    """Receiver of the shards' registers on the plant's side.

    Args:
        partition: Partition of the cells into shards.
        wanted: Requests of the plant.
        counts: Counters to update.
        now: Returns the tick whose drives are gathered.
        latest: Returns the last tick whose senses were published, which cells may have computed.
    """

    def __init__(
        self,
        partition: Partition,
        wanted: Sequence[RegisterRequest],
        counts: MessageCounters,
        now: Callable[[], int],
        latest: Callable[[], int],
    ) -> None:
        self._latest = latest
        self._drained = -1
        self._partition = partition
        self._wanted = tuple(wanted)
        self._counts = counts
        self._now = now
        self._frames: dict[tuple[int, int], RegisterFrame] = {}
        """By tick and shard."""
        self._shown = -1
        """Tick whose registers were requested once more; those that come now are for observers."""

    def handle(self, shard: int, payload: bytes) -> None:
        """Handle a register payload of a shard.

        Raises:
            WireError: Not such a payload, of cells that are not its own, or not of this tick, or the second of it.
        """
        frame = decode_registers(payload, len(self._partition.cells(shard)))
        rows = self._partition.lattice.find(*frame.cells.T.astype(np.int64))
        if (rows < 0).any() or (self._partition.shard_of[rows] != shard).any():
            raise WireError("registers", "cells", f"must be cells of shard {shard}")
        # They come between the senses of their tick and its drives.
        now = self._now()
        again = frame.tick <= self._drained or (frame.tick, shard) in self._frames
        if frame.tick == self._shown and again:
            return
        if frame.tick > (latest := max(now, self._latest())):
            raise WireError(
                "registers", "ahead", f"tick {frame.tick}: must be at most {latest}, the last begun"
            )
        if frame.tick < now:
            self._counts.late += 1
            return
        if (frame.tick, shard) in self._frames:
            raise WireError("registers", "duplicate", f"tick {frame.tick} was received already")
        self._counts.delivered += 1
        if requested_at(self._wanted, frame.tick) is not None:
            self._frames[frame.tick, shard] = frame  # others are for those who watch

    def show(self, tick: int) -> None:
        """Ignore second registers of ``tick``, the last tick of which cells have senses."""
        self._shown = tick

    def drain(self) -> list[RegisterSnapshot]:
        """Return the snapshots of ticks whose drives have been gathered since the last call."""
        self._drained = self._now()
        frames = [frame for (tick, _), frame in self._frames.items() if tick <= self._drained]
        self._frames = {key: frame for key, frame in self._frames.items() if key[0] > self._drained}
        return merge_frames(frames, self._partition.lattice)
