"""Traced messages: tick and place in which each was sent and read, and what became of those that were not."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Literal, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import OPPOSITE, SIDES, Lattice

if TYPE_CHECKING:
    from deploy.recordings.format import Header

Fate = Literal["read", "late", "altered", "lost", "repeated", "made up", "under way", "not traced"]
"""Fate of a message; see ``TracedMessage``."""
_LINK_EFFECTS: Final = ("link_loss", "link_delay", "serial", "clock")
"""Effects of a scene by which messages are lost or late."""


def trace_of(
    registers: Mapping[str, NDArray[Any]], cells: NDArray[np.int64], tick: int
) -> dict[str, NDArray[Any]]:
    """Return the record of a tick's messages for a recording.

    Args:
        registers: Registers of all cells' tracers, by name.
        cells: Indices of the traced cells.
        tick: Number of the step of the tick; a cell that was not stepped then has neither read nor sent.
    """
    chosen = {name: array[cells] for name, array in registers.items()}
    stepped = chosen.pop("tick") == tick
    for name in ("received", "sent"):
        chosen[name] = chosen[name] & stepped[:, None]
    return {"cell": cells, "stepped": stepped, **chosen}


@final
@dataclass(frozen=True, slots=True)
class TracedMessage:
    """A message over a link.

    Attributes:
        sender: ``(row, column)`` of the sender.
        receiver: ``(row, column)`` of the receiver.
        side: Side of the sender on which the receiver is.
        sent_tick: Tick in which the program sent the message; None: it was never sent.
        read_tick: Tick in which the receiver's program read it; None: never.
        sent: Values as sent, by field; empty if it was never sent.
        read: Values as read, by field; empty if it was never read.
        fate: ``read`` when due; ``late``; ``altered``: read when due with other values;
            ``lost``; ``repeated``: read once more; ``made up``: read though nothing with these values was sent;
            ``under way`` at the end of the recording; ``not traced``: only one of both cells was traced.
        why: Reasons that the recording has for a fate other than ``read``: faults of that time, effects of the scene.
            Empty: none.
    """

    sender: tuple[int, int]
    receiver: tuple[int, int]
    side: str
    sent_tick: int | None
    read_tick: int | None
    sent: dict[str, Any]
    read: dict[str, Any]
    fate: Fate
    why: str


def traced_messages(
    header: Header,
    ticks: NDArray[np.int64],
    trace: Mapping[str, NDArray[Any]],
    faults: Sequence[Mapping[str, Any]],
    cells: Collection[tuple[int, int]] | None = None,
) -> list[TracedMessage]:
    """Return the traced messages of a recording, ordered by the tick of sending, or of reading where there is none.

    A message is found again by its values. Of equal ones on a link the message counts whose delay is that of the
    message read before, else the newest; of the first ones the oldest, where the scene's effects delay messages. So a
    late message and a lost one can be taken for each other where a program sends the same over and over.

    Args:
        header: Header of the recording.
        ticks: ``(K,)`` ticks of the trace.
        trace: Its arrays, as ``Recording.trace`` has them.
        faults: Faults of the recording.
        cells: ``(row, column)`` of the cells whose messages are wanted; the others count as not traced. None: all.
    """
    if not len(ticks):
        return []
    return sorted(_messages(header, ticks, trace, _Reasons(header, faults), cells), key=_order)


def _order(message: TracedMessage) -> tuple[int, tuple[int, int], str]:
    tick = message.read_tick if message.sent_tick is None else message.sent_tick
    return (-1 if tick is None else tick, message.sender, message.side)


def _messages(
    header: Header,
    ticks: NDArray[np.int64],
    trace: Mapping[str, NDArray[Any]],
    reasons: _Reasons,
    wanted: Collection[tuple[int, int]] | None,
) -> Iterator[TracedMessage]:
    lattice = Lattice(tuple((int(row), int(column)) for row, column in header["cells"]))
    cells = trace["cell"][0]
    row_of = {
        int(cell): row
        for row, cell in enumerate(cells)
        if wanted is None or lattice.cells[int(cell)] in wanted
    }
    for cell, row in row_of.items():
        for side in range(4):
            other = int(lattice.neighbours[cell, side])
            if other < 0:
                continue
            link = _Link(lattice.cells[cell], lattice.cells[other], SIDES[side], ticks, trace, reasons)
            there = row_of.get(other)
            if there is None:
                yield from link.sent_only(row, side)
                yield from link.back().read_only(row, side)
                continue
            yield from link.traced(row, side, there, OPPOSITE[side])


@final
@dataclass(frozen=True, slots=True)
class _Link:
    """A link in one direction."""

    sender: tuple[int, int]
    receiver: tuple[int, int]
    side: str
    ticks: NDArray[np.int64]
    trace: Mapping[str, NDArray[Any]]
    reasons: _Reasons

    def back(self) -> _Link:
        """Return the link in the other direction."""
        side = SIDES[OPPOSITE[SIDES.index(self.side)]]
        return replace(self, sender=self.receiver, receiver=self.sender, side=side)

    def sent_only(self, row: int, side: int) -> Iterator[TracedMessage]:
        """Yield the messages sent over a link whose receiver is not traced."""
        for place in np.flatnonzero(self.trace["sent"][:, row, side]).tolist():
            values = self._values("sent", place, row, side)
            yield self._message(int(self.ticks[place]), None, values, {}, "not traced")

    def read_only(self, row: int, side: int) -> Iterator[TracedMessage]:
        """Yield the messages read from a link whose sender is not traced; the side is the receiver's."""
        for place in np.flatnonzero(self.trace["received"][:, row, side]).tolist():
            values = self._values("read", place, row, side)
            yield self._message(None, int(self.ticks[place]), {}, values, "not traced")

    def traced(self, row: int, side: int, there: int, their_side: int) -> Iterator[TracedMessage]:
        """Yield the messages of a link both of whose ends are traced."""
        sent, received = self.trace["sent"][:, row, side], self.trace["received"][:, there, their_side]
        waiting: dict[int, dict[str, Any]] = {}
        found: dict[int, dict[str, Any]] = {}
        due = self.reasons.link_ticks
        delay = None if self.reasons.delays else due
        for place, tick in enumerate(self.ticks.tolist()):
            if received[place]:
                values = self._values("read", place, there, their_side)
                message = self._arrived(tick, values, waiting, found, delay)
                if message.fate in ("read", "late") and message.sent_tick is not None:
                    delay = tick - message.sent_tick
                yield message
            if sent[place]:
                waiting[tick] = self._values("sent", place, row, side)
        last, stepped = int(self.ticks[-1]), self.trace["stepped"][:, there]
        for tick, values in waiting.items():
            if tick > last - due:
                yield self._message(tick, None, values, {}, "under way")
                continue
            idle = not stepped[int(np.searchsorted(self.ticks, tick + due))]
            why = ["the receiver was not stepped"] if idle else []
            yield self._message(tick, None, values, {}, "lost", why)

    def _arrived(
        self,
        tick: int,
        values: dict[str, Any],
        waiting: dict[int, dict[str, Any]],
        found: dict[int, dict[str, Any]],
        delay: int | None,
    ) -> TracedMessage:
        """Return the message read in a tick, and remove it from the waiting messages."""
        due = tick - self.reasons.link_ticks
        equal = [sent for sent in waiting if waiting[sent] == values]
        if equal:
            usual = equal[0] if delay is None else tick - delay
            sent_tick = usual if usual in equal else equal[-1]
            found[sent_tick] = said = waiting.pop(sent_tick)
            return self._message(sent_tick, tick, said, values, "read" if sent_tick == due else "late")
        if due in waiting:
            return self._message(due, tick, waiting.pop(due), values, "altered")
        before = next((sent for sent in reversed(found) if found[sent] == values), None)
        if before is not None:
            return self._message(before, tick, found[before], values, "repeated")
        return self._message(None, tick, {}, values, "made up")

    def _values(self, way: str, place: int, row: int, side: int) -> dict[str, Any]:
        prefix = f"{way}."
        return {
            name.removeprefix(prefix): array[place, row, side].tolist()
            for name, array in self.trace.items()
            if name.startswith(prefix)
        }

    def _message(
        self,
        sent_tick: int | None,
        read_tick: int | None,
        sent: dict[str, Any],
        read: dict[str, Any],
        fate: Fate,
        why: Sequence[str] = (),
    ) -> TracedMessage:
        told = list(why)
        if fate in ("late", "altered", "lost", "repeated", "made up"):
            tick = read_tick if sent_tick is None else sent_tick
            assert tick is not None, "this is a bug: a message neither sent nor read"
            told += self.reasons.at(
                tick,
                tick + self.reasons.link_ticks if read_tick is None else read_tick,
                (self.sender, self.receiver),
            )
        return TracedMessage(
            self.sender, self.receiver, self.side, sent_tick, read_tick, sent, read, fate, ", ".join(told)
        )


@final
class _Reasons:
    """Reasons of a recording for the fates of messages.

    Args:
        header: Header of the recording.
        faults: Its faults.

    Attributes:
        delays: Whether the scene has effects that delay messages.
        link_ticks: Ticks after which a message is read.
    """

    def __init__(self, header: Header, faults: Sequence[Mapping[str, Any]]) -> None:
        effects: Mapping[str, Any] = header["scene"].get("effects") or {}
        acting = [name for name in _LINK_EFFECTS if effects.get(name)]
        self._effects = [f"effects.{name}" for name in acting]
        self.link_ticks = int(header["scene"].get("bus", {}).get("link_ticks", 1))
        self.delays = any(name != "link_loss" for name in acting)
        self._faults: list[tuple[int, int | None, str, frozenset[tuple[int, int]]]] = []
        ends = {
            fault["number"]: int(fault["tick"])
            for fault in faults
            if fault.get("phase") == "ends" and "number" in fault
        }
        for fault in faults:
            if fault.get("phase") == "ends" or fault.get("tick") is None:
                continue
            places = fault.get("cells") or [fault["cell"]] if fault.get("cell") or fault.get("cells") else []
            cells = frozenset((int(row), int(column)) for row, column in places)
            self._faults.append(
                (int(fault["tick"]), ends.get(fault.get("number")), str(fault["kind"]), cells)
            )

    def at(self, first: int, last: int, ends: tuple[tuple[int, int], tuple[int, int]]) -> list[str]:
        """Return the faults of both cells between two ticks, then the scene's effects on links."""
        acting = [
            f"fault {kind}"
            for begin, end, kind, cells in self._faults
            if begin <= last and (end is None or end > first) and cells & set(ends)
        ]
        return list(dict.fromkeys(acting)) + self._effects
