"""Fault ``babble``: cells flood their links with noise."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import CellTarget, FaultInstance
from bus.lattice import SIDES
from bus.random_streams import CounterStream
from cell_firmware.effects.base import stream_ids
from cell_firmware.faults.base import CellFault, stream_name
from cell_firmware.faults.message_fault import MessageContext, MessageFault
from cell_firmware.firmware import Bools, Messages, Outbox

if TYPE_CHECKING:
    from cell_firmware.controller import StepTime

Ints = NDArray[np.int64]


@final
class BabbleFault(CellTarget, CellFault):
    """Cells send random bytes to all their neighbours, in every control period in which their program runs.

    Links without serial lines carry messages of random bytes. On serial lines bytes follow one another without a
    pause, so that no message ever ends.
    """

    kind_name: ClassVar[str] = "babble"
    corrupts_messages: ClassVar[bool] = True
    kind: Literal["babble"] = "babble"

    def message_faults(self, talk: MessageContext, injected: FaultInstance[CellFault]) -> MessageFault:
        """Return a source of noise that replaces the programs' messages."""
        return _Noise(talk, injected)


@final
class _Noise(MessageFault):
    counts = "messages"

    def __init__(self, talk: MessageContext, injected: FaultInstance[CellFault]) -> None:
        from cell_firmware.effects.serial.lines import SerialLines
        from cell_firmware.faults.payload_bytes import MessageBytes, random_bytes_each

        super().__init__(injected, injected.cells)
        lattice, links = talk.lattice, talk.links
        self._line: np.dtype[Any] = talk.message if links is None else links.line
        self._whole = MessageBytes(talk.message)
        self._raw = links if isinstance(links, SerialLines) else None
        self._width = self._whole.width if self._raw is None else self._raw.most_bytes
        self._number = np.full(len(lattice), -1)
        self._number[injected.cells] = np.arange(len(injected.cells))
        self._sides: Bools = lattice.neighbours >= 0
        sides = stream_ids(injected.cells, len(SIDES))
        self._draws = CounterStream(
            talk.seed, stream_name(injected), stream_ids(sides, random_bytes_each(self._width))
        )

    def on_send(
        self, now: StepTime, tick: int, place: Ints, outbox: Outbox | None
    ) -> tuple[Outbox | None, Ints]:
        """Replace the messages of babbling cells by noise on all sides."""
        from cell_firmware.faults.payload_bytes import random_bytes

        rows = np.flatnonzero(self._number[place] >= 0)
        if not len(rows):
            return outbox, np.zeros(len(place), dtype=np.int64)
        outgoing = Outbox.empty(len(place), self._line)
        if outbox is not None:
            outgoing = Outbox(outbox.sent.copy(), np.array(outbox.message))
        sides = len(SIDES)
        data = random_bytes(self._draws, tick, sides * len(self.injected.cells), self._width)
        data = data.reshape(-1, sides, self._width)[self._number[place[rows]]]
        outgoing.sent[rows] = self._sides[place[rows]]
        outgoing.message[rows] = self._carried(now.select(rows), data)
        noise = np.zeros(len(place), dtype=np.int64)
        noise[rows] = outgoing.sent[rows].sum(axis=1)
        return outgoing, noise

    def _carried(self, now: StepTime, data: NDArray[np.uint8]) -> Messages:
        """Return link payloads that contain these bytes; a time stamp of 0 is the start of the window."""
        if self._raw is not None:
            return self._raw.raw(now, data)
        blank = np.zeros(data.shape[0] * data.shape[1], dtype=self._line)
        return self._whole.write(blank, data.reshape(len(blank), -1)).reshape(data.shape[:2])
