"""What a shard sends in a tick: checked, encoded, and only to those who live."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, Final, final

import numpy as np

from bus.errors import BusError, WireError
from bus.forms.form import MemberForm, Wiring
from bus.lattice import NEVER
from bus.lives import Lives
from bus.transport import Endpoint, Publisher
from bus.wire import DriveFrame, LinkFrame

_F8: Final = np.dtype(np.float64)


@final
class Outgoing:
    """Makes a shard's frames into payloads with their publishers.

    Args:
        endpoint: The endpoint of the shard's process.
        wiring: What both sides agreed on.
        shard: Which shard this is.
        form: Its side of the wire form.
        lives: Who takes part, kept by the caller, who tells of changes by ``bury``.

    Attributes:
        publishers: All of them, by key.
    """

    def __init__(
        self, endpoint: Endpoint, wiring: Wiring, shard: int, form: MemberForm, lives: Lives
    ) -> None:
        self._shard = shard
        self._form = form
        self._lives = lives
        self._lattice = wiring.partition.lattice
        self._message = self._seen = wiring.message
        self._cells = wiring.partition.cells(shard)
        self._shape = (len(self._cells), 2)
        self._sources = wiring.partition.outgoing(shard).source
        self._links_shape = self._sources.shape
        self._drive = [endpoint.publisher(key) for key in form.drive_keys]
        self._out = [endpoint.publisher(key) for key in form.out_keys]
        self.publishers = dict(
            zip((*form.drive_keys, *form.out_keys), (*self._drive, *self._out), strict=True)
        )
        self._drive_until = [NEVER] * len(self._drive)
        self._out_until = self._target_until = [NEVER] * len(self._out)

    def bury(self) -> None:
        """Takes note of who is gone."""
        last, form = self._lives.last, self._form
        self._drive_until = last(form.unit_cells)
        self._out_until, self._target_until = last(form.out_sources), last(form.out_targets)

    def towards(self, cells: Collection[int]) -> list[Publisher]:
        """Publishers of messages to any of ``cells`` (indices)."""
        return [
            publisher
            for publisher, targets in zip(self._out, self._form.out_targets, strict=True)
            if not set(targets.tolist()).isdisjoint(cells)
        ]

    def puts(self, drive: DriveFrame, links: LinkFrame | None) -> list[tuple[Publisher, bytes]]:
        """A tick's payloads, each with its publisher.

        Messages come first: when the plant has the drives, it has passed the messages on.

        Raises:
            BusError: A shape or type is not what was agreed, or a drive is not finite; names the cell.
        """
        self._check(drive, links)
        tick = drive.tick
        puts = [] if links is None else self.link_puts(links)
        try:
            driven = list(zip(self._drive, self._form.drive_payloads(drive), strict=True))
        except WireError:
            raise self._not_finite(drive) from None
        if not self._lives.all:
            driven = [put for put, until in zip(driven, self._drive_until, strict=True) if until > tick]
        return puts + driven

    def link_puts(self, links: LinkFrame) -> list[tuple[Publisher, bytes]]:
        """A tick's messages, each payload with its publisher."""
        tick = links.tick
        if not self._out:
            return []
        if self._lives.all:
            return list(zip(self._out, self._form.link_payloads(links), strict=True))
        live = self._lives.until[self._sources] > tick
        payloads = self._form.link_payloads(LinkFrame(tick, links.sent & live, links.message))
        puts = zip(self._out, payloads, strict=True)
        return [put for put, spoken in zip(puts, self._spoken(tick), strict=True) if spoken]

    def _spoken(self, tick: int) -> list[bool]:
        """Which parts of the outgoing links have somebody to send them, and somebody to read them a tick later."""
        return [
            source > tick and target > tick + 1
            for source, target in zip(self._out_until, self._target_until, strict=True)
        ]

    def _check(self, drive: DriveFrame, links: LinkFrame | None) -> None:
        values = drive.drive
        if values.shape != self._shape or (values.dtype is not _F8 and values.dtype != _F8):
            raise BusError(
                f"drive of shard {self._shard}, tick {drive.tick}: must be float64 {self._shape}, "
                f"is {values.dtype} {values.shape}"
            )
        if (links is None) != (self._message is None):
            raise BusError(
                f"links of shard {self._shard}: the firmware {'has' if links is None else 'has no'} messages"
            )
        if links is not None and not (
            links.tick == drive.tick
            and links.sent.shape == links.message.shape == self._links_shape
            and (links.message.dtype is self._seen or self._is_agreed(links.message.dtype))
        ):
            raise BusError(
                f"links of shard {self._shard}, tick {drive.tick}: must be {len(self._sources)} of {self._message}"
                f", are {links.message.shape} of {links.message.dtype} of tick {links.tick}"
            )

    def _not_finite(self, frame: DriveFrame) -> BusError:
        i = int(np.nonzero(~np.isfinite(frame.drive).all(axis=1))[0][0])
        row, column = self._lattice.cells[int(self._cells[i])]
        return BusError(
            f"drive of cell {row},{column}, tick {frame.tick}: must be finite, is {frame.drive[i].tolist()}"
        )

    def _is_agreed(self, dtype: np.dtype[Any]) -> bool:
        # Comparing structured types takes long, and it is the same object every tick.
        if dtype != self._message:
            return False
        self._seen = dtype
        return True
