"""Inbound and outbound frames of a shard, and the shard's membership."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import Any, Final, NamedTuple, final

import numpy as np

from bus.errors import BusError, StateError, WireError
from bus.lattice import NO_TICK_LIMIT
from bus.lockstep.counters import MessageCounters
from bus.lockstep.intervals import Membership
from bus.lockstep.receive import FrameAssembler, PartialFrame, Route
from bus.lockstep.snapshots import MessageBytes
from bus.partition import Index
from bus.transports.base import Endpoint, Publisher
from bus.wire.fixed_layout import PayloadLayout
from bus.wire.format import ParticipantCodec, RunSchema
from bus.wire.frames import DriveFrame, LinkFrame, Mask, SenseFrame


class TickInputs(NamedTuple):
    """Inputs from which a shard computes a tick.

    Attributes:
        sense: Sense frame of this tick; rows in the order of ``partition.cells(shard)``, false and zero for dead
            cells.
        links: Messages on the links of ``partition.incoming(shard)``, sent ``link_ticks`` before. Before tick 0
            nothing was sent. None where the firmware has no messages.
    """

    sense: SenseFrame
    links: LinkFrame | None


@final
class InboundFrames:
    """Inbound frames of a shard, assembled from the payloads of live senders.

    Args:
        wiring: Schema of the run.
        shard: Number of the shard.
        form: The shard's side of the wire format.
        membership: Membership, owned by the caller, who announces changes by ``update_membership`` and ``admit``.
        counts: Counters to update.

    Attributes:
        parts_read: Payloads in which the messages of the last collected tick came.
    """

    def __init__(
        self,
        wiring: RunSchema,
        shard: int,
        form: ParticipantCodec,
        membership: Membership,
        counts: MessageCounters,
    ) -> None:
        self._form = form
        self._membership = membership
        self._counts = counts
        self._message = wiring.message
        self._links_shape = wiring.partition.incoming(shard).source.shape
        self._cells = wiring.partition.cells(shard)
        self._speaks = wiring.message is not None
        self._apart = self._speaks and bool(form.in_parts)
        """Whether messages come in payloads of their own."""
        self._link_keys = tuple(form.in_parts)
        self._link_ticks = wiring.latency.link_ticks
        self._first_read = self._link_ticks
        """First tick in which messages are read: nobody has sent the shard anything before its first tick."""
        self._first_whole = 0
        """First tick whose senses bring no messages that were sent before the shard's first tick."""
        self._recalled: dict[int, LinkFrame] = {}
        self.parts_read = 0
        self._senses = FrameAssembler("sense", form.blank_senses, form.decode_sense, counts)
        self._links = FrameAssembler("link", form.blank_links, form.decode_link, counts)

    def subscribe(self, endpoint: Endpoint, direct: bool) -> dict[str, Route]:
        """Subscribe to all inbound keys, and return the handler of each.

        Args:
            endpoint: The endpoint.
            direct: Whether the senses may be answered in a thread of the transport.
        """
        for key in self._form.sense_units:
            endpoint.subscribe(key, direct=direct)
        # The plant senses again only when all drives have come, and messages are put before drives: they are there
        # when the senses are.
        for key in self._form.in_parts:
            endpoint.subscribe(key, "quiet")
        return {
            **{key: (self._senses.handle, unit) for key, unit in self._form.sense_units.items()},
            **{key: (self._links.handle, part) for key, part in self._form.in_parts.items()},
        }

    # --- a tick ---------------------------------------------------------------------------------

    def slots(self, tick: int) -> tuple[PartialFrame, PartialFrame | None]:
        """Return the partial frames of the tick's senses and of the messages due in it; None without messages."""
        links = None
        if self._apart and tick >= self._first_read:
            links = self._links.slot(tick - self._link_ticks)
        return self._senses.slot(tick), links

    def received_count(self, tick: int) -> int:
        """Return the number of payloads received, without messages that are read after ``tick``."""
        sent = tick - self._link_ticks + 1
        later = self._links.early(sent) if self._apart else 0
        return self._counts.delivered - later - self._senses.early(tick + 1)

    def collect(self, tick: int) -> TickInputs:
        """Close a tick and return its inputs."""
        sensed = self._senses.close(tick).values
        senses = self._form.join_senses(sensed)
        if not self._membership.unchanged:
            gone = ~self._membership.live(tick)[self._cells]
            for readings in (senses.presence, senses.encoder_m, senses.level, senses.label):
                if readings is not None:
                    readings[gone] = 0
        sense = SenseFrame(tick, *senses)
        if not self._speaks:
            return TickInputs(sense, None)
        values, sent = self._form.blank_links, tick - self._link_ticks
        self.parts_read = 0
        if tick < self._first_read:
            recalled = self._recalled.pop(sent, None)
            if recalled is not None:
                return TickInputs(sense, recalled)
            sensed = self._form.blank_senses
        elif self._apart:
            closed = self._links.close(sent)
            values, self.parts_read = closed.values, sum(closed.have)
        return TickInputs(sense, LinkFrame(sent, *self._form.join_links(values, sensed)))

    @property
    def newest_sense(self) -> int:
        """Last tick of which senses have come, for dead cells too."""
        return self._senses.newest

    def single_layouts(self, tick: int) -> tuple[PayloadLayout, PayloadLayout] | None:
        """Return the layouts of the shard's only payload each way in a tick; None if there are others."""
        return self._form.layouts(tick)

    @property
    def single_key(self) -> str:
        """Key of the first unit's senses."""
        return next(iter(self._form.sense_units))

    def untouched(self, tick: int) -> bool:
        """Whether nothing of ``tick`` or later has arrived, and all messages that come with it are to be read."""
        return tick == self._senses.now and tick >= self._first_whole and self._senses.untouched

    def skip(self) -> None:
        """Close a tick whose only payload the caller has received by itself."""
        self._senses.skip(1)

    # --- intervals and sources ------------------------------------------------------------------

    def accept_any_tick(self) -> None:
        """Accept frames of any tick until ``resume`` or ``enter`` sets the first."""
        self._senses.accept_any_tick()
        self._links.accept_any_tick()

    @property
    def recorded_ticks(self) -> int:
        """Ticks whose messages are on their way at a time, in payloads of their own."""
        return self._link_ticks if self._apart else 0

    def resume(self, tick: int, links: Sequence[MessageBytes]) -> None:
        """Resume at ``tick``.

        Args:
            tick: First tick to collect.
            links: Messages that were on their way, from a snapshot.

        Raises:
            StateError: They are not those of this shard's links.
        """
        if self._apart:
            first = tick - self._link_ticks
            if len(links) != self._link_ticks:
                raise StateError(f"messages of {len(links)} ticks: must be of {self._link_ticks}")
            self._recalled = {first + i: self._frame(first + i, one) for i, one in enumerate(links)}
            self.enter(tick)
        else:
            self._senses.start_at(tick)

    def _frame(self, tick: int, data: MessageBytes) -> LinkFrame:
        """Decode the messages of a tick from a snapshot."""
        message = self._message
        assert message is not None, "this is a bug: messages of a program without them"
        count = self._links_shape[0]
        if [len(part) for part in data] != [count, count * message.itemsize]:
            raise StateError(f"messages of tick {tick}: must be of {count} links")
        sent, values = (bytearray(part) for part in data)
        return LinkFrame(tick, np.frombuffer(sent, np.bool_), np.frombuffer(values, message))

    def enter(self, tick: int) -> None:
        """Start at ``tick``: no neighbour sends the shard anything that was sent before."""
        self._first_read = self._first_whole = tick + self._link_ticks
        self._senses.start_at(tick)
        self._links.start_at(tick)

    def update_membership(self) -> None:
        """Update the expected senders and receivers after a change of membership."""
        last, form = self._membership.end_by_group, self._form
        self._senses.update_membership(last(form.unit_cells))
        # Nobody sends to a cell that will not read.
        sources, targets, later = last(form.in_sources), last(form.in_targets), self._link_ticks
        self._links.update_membership(
            [min(source, target - later) for source, target in zip(sources, targets, strict=True)]
        )

    def awaited_key(self, tick: int) -> str:
        """Return a key on which a message due in ``tick`` is missing."""
        return self._link_keys[self._links.missing(tick - self._link_ticks)[0]]

    def awaited(self, tick: int) -> int:
        """Return the number of messages sent in ``tick``, or the first tick that is not closed, that are missing."""
        return len(self._links.missing(max(tick, self._links.now)))

    def discard(self, tick: int) -> None:
        """Discard messages of ``tick`` from senders lost by then; call after ``update_membership``."""
        # What they sent before has arrived, or will; of that tick it may have, or not: it never was.
        gone = [part for part, until in enumerate(self._links.end_tick) if until <= tick]
        self._links.discard(gone, tick)

    def allow_early(self, cells: Iterable[int]) -> None:
        """Accept messages of dead cells (indices) that may rejoin before the rejoin is committed."""
        back = set(cells)
        sources = enumerate(self._form.in_sources)
        self._links.allow_early(part for part, source in sources if not back.isdisjoint(source.tolist()))

    def admit(self) -> None:
        """Update the expected senders after a rejoin."""
        first, last, form = self._membership.start_by_group, self._membership.end_by_group, self._form
        self._senses.admit(first(form.unit_cells), last(form.unit_cells))
        sources, targets = form.in_sources, form.in_targets
        since = [max(pair) for pair in zip(first(sources), first(targets), strict=True)]
        until = [min(s, t - self._link_ticks) for s, t in zip(last(sources), last(targets), strict=True)]
        self._links.admit(since, until)


_F8: Final = np.dtype(np.float64)


@final
class OutboundFrames:
    """Outbound frames of a shard, encoded into payloads with their publishers.

    Args:
        endpoint: The endpoint of the shard's process.
        wiring: Schema of the run.
        shard: Number of the shard.
        form: The shard's side of the wire format.
        membership: Membership, owned by the caller, who announces changes by ``update_membership``.

    Attributes:
        publishers: All of them, by key.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        wiring: RunSchema,
        shard: int,
        form: ParticipantCodec,
        membership: Membership,
    ) -> None:
        self._shard = shard
        self._form = form
        self._membership = membership
        self._link_ticks = wiring.latency.link_ticks
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
        self._single = form.relays and len(self._drive) == 1
        self._drive_until = [NO_TICK_LIMIT] * len(self._drive)
        self._out_until = self._target_until = [NO_TICK_LIMIT] * len(self._out)

    def update_membership(self) -> None:
        """Update the expected senders and receivers after a change of membership."""
        last, form = self._membership.end_by_group, self._form
        self._drive_until = last(form.unit_cells)
        self._out_until, self._target_until = last(form.out_sources), last(form.out_targets)

    def publishers_to(self, cells: Collection[int]) -> list[Publisher]:
        """Return the publishers of messages to any of ``cells`` (indices)."""
        return [
            publisher
            for publisher, targets in zip(self._out, self._form.out_targets, strict=True)
            if not set(targets.tolist()).isdisjoint(cells)
        ]

    def encode(self, drive: DriveFrame, links: LinkFrame | None) -> list[tuple[Publisher, bytes]]:
        """A tick's payloads, each with its publisher.

        Messages come first: when the plant has the drives, it has passed the messages on.

        Raises:
            BusError: A shape or type is not what was agreed, or a drive is not finite; names the cell.
        """
        self._check(drive, links)
        return self._encode(drive, links)

    def _encode(self, drive: DriveFrame, links: LinkFrame | None) -> list[tuple[Publisher, bytes]]:
        if self._single and self._membership.unchanged:
            try:
                return [(self._drive[0], self._form.drive_payloads(drive, links)[0])]
            except WireError:
                raise self._not_finite(drive) from None
        links = None if links is None else self._from_live(links)
        puts = [] if links is None else self._encode_links(links)
        try:
            driven = list(zip(self._drive, self._form.drive_payloads(drive, links), strict=True))
        except WireError:
            raise self._not_finite(drive) from None
        if not self._membership.unchanged:
            driven = [put for put, until in zip(driven, self._drive_until, strict=True) if until > drive.tick]
        return puts + driven

    def _from_live(self, links: LinkFrame) -> LinkFrame:
        """Return a tick's messages without those of dead cells."""
        if self._membership.unchanged:
            return links
        live = self._membership.end_tick[self._sources] > links.tick
        return LinkFrame(links.tick, links.sent & live, links.message)

    def _encode_links(self, links: LinkFrame) -> list[tuple[Publisher, bytes]]:
        """Encode a tick's messages for the keys of links, each payload with its publisher."""
        puts = list(zip(self._out, self._form.link_payloads(links), strict=True))
        if self._membership.unchanged:
            return puts
        return [put for put, read in zip(puts, self._has_reader(links.tick), strict=True) if read]

    def _has_reader(self, tick: int) -> list[bool]:
        """Return whether each part of the outgoing links has a live sender, and a receiver that lives to read it."""
        read = tick + self._link_ticks
        return [
            source > tick and target > read
            for source, target in zip(self._out_until, self._target_until, strict=True)
        ]

    @property
    def single(self) -> Publisher:
        """Publisher of the first unit's drives."""
        return self._drive[0]

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


@final
class ParticipantMembership:
    """Membership as one shard sees it. Cells are given by their index in the lattice.

    Args:
        cells: The shard's own cells.
        membership: Membership of the run's cells.
        incoming: Inbound frames of the shard.
        outgoing: Outbound frames of the shard.
        counts: Counters to update.

    Attributes:
        changes: Number of changes so far.
    """

    def __init__(
        self,
        cells: Index,
        membership: Membership,
        incoming: InboundFrames,
        outgoing: OutboundFrames,
        counts: MessageCounters,
    ) -> None:
        self.changes = 0
        self._cells = cells
        self._membership = membership
        self._incoming = incoming
        self._outgoing = outgoing
        self._counts = counts

    @property
    def unchanged(self) -> bool:
        """Whether no cell of the run ever died: masks of live cells can be skipped."""
        return self._membership.unchanged

    def live(self, tick: int) -> Mask:
        """Return the mask of the shard's cells that are live in ``tick``, ``(n,)``."""
        return self._membership.live(tick)[self._cells]

    def none_live(self, tick: int) -> bool:
        """Whether no cell of the shard is live in ``tick``."""
        return not self._membership.unchanged and not self.live(tick).any()

    def next_death(self, tick: int) -> int:
        """Return the first tick after ``tick`` in which a cell of the shard that is live in ``tick`` is dead."""
        ends = self._membership.end_tick[self._cells]
        return int(ends[ends > tick].min(initial=NO_TICK_LIMIT))

    def schedule_death(self, cells: Iterable[int], tick: int) -> None:
        """Schedule the permanent death of ``cells`` at ``tick``."""
        self._membership.schedule_death(cells, tick)
        self._update_membership()

    def mark_dead(self, cells: Iterable[int], tick: int) -> None:
        """Mark ``cells`` as dead from ``tick`` on."""
        self._membership.mark_dead(cells, tick)
        self._update_membership()

    def mark_lost(self, cells: Iterable[int], tick: int) -> None:
        """Mark ``cells`` as lost in ``tick``: count their missing messages as lost and discard those of ``tick``."""
        waited = self._incoming.awaited(tick)
        self.mark_dead(cells, tick)
        self._counts.lost += waited - self._incoming.awaited(tick)
        self._incoming.discard(tick)

    def allow_early(self, cells: Iterable[int]) -> None:
        """Accept messages of dead ``cells`` that may rejoin."""
        self._incoming.allow_early(cells)

    def admit(self, cells: Collection[int], tick: int) -> bool:
        """Readmit ``cells`` from ``tick`` on, the next tick; return whether any is the shard's own."""
        self._membership.admit(cells, tick)
        own = self.owns(cells)
        if own:
            self._incoming.enter(tick)
        self._incoming.admit()
        self._outgoing.update_membership()
        self.changes += 1
        return own

    def owns(self, cells: Iterable[int]) -> bool:
        """Whether any of ``cells`` is the shard's own."""
        return not set(cells).isdisjoint(self._cells.tolist())

    def _update_membership(self) -> None:
        self.changes += 1
        self._incoming.update_membership()
        self._outgoing.update_membership()
