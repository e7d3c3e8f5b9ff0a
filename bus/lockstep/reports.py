"""Reports of shards to the plant: failed, hung and reachable cells, and message counters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import final

from bus.errors import WireError
from bus.lockstep.counters import MessageCounters
from bus.lockstep.receive import EARLY_TICKS
from bus.partition import Partition
from bus.transports.base import Publisher
from bus.wire.frames import Report, decode_report, encode_report

Cell = tuple[int, int]


@final
class ReportPublisher:
    """Publisher of a shard's reports.

    Args:
        publisher: Publisher on the shard's report key.
        counts: Counters of the shard's side, to report and to update.
        cell_counters: Returns the cells' counters by name, reported as the shard leaves.
    """

    def __init__(
        self, publisher: Publisher, counts: MessageCounters, cell_counters: Callable[[], Mapping[str, int]]
    ) -> None:
        self.publisher = publisher
        self._counts = counts
        self._cell_counters = cell_counters

    def failed(self, cells: tuple[Cell, ...], tick: int, detail: str) -> None:
        """Report that ``cells`` failed in ``tick``."""
        self._put(Report("failed", tick, cells, detail))

    def hung(self, cell: Cell, tick: int, detail: str) -> None:
        """Report that the program of ``cell`` hangs since ``tick``."""
        self._put(Report("hung", tick, (cell,), detail))

    def linked(self, cells: tuple[Cell, ...], tick: int) -> None:
        """Report that rejoining ``cells`` can be sent to."""
        self._put(Report("rejoin_ready", tick, cells))

    def busy(self, tick: int) -> None:
        """Report that the shard still computes ``tick``; not counted, as it depends on the wall clock."""
        self.publisher.put(encode_report(Report("busy", tick)))

    def held(self, cell: Cell, tick: int) -> None:
        """Report that a debugger holds ``cell`` in ``tick``; not counted, as it depends on the wall clock."""
        self.publisher.put(encode_report(Report("held", tick, (cell,))))

    def _put(self, report: Report) -> None:
        self.publisher.put(encode_report(report))
        self._counts.sent += 1

    def publish_counters(self, tick: int) -> None:
        """Report the shard's counters as the shard leaves; the report itself is not counted."""
        counts = self._counts
        numbers = (counts.sent, counts.delivered, counts.lost, counts.late)
        report = Report("counters", tick, (), "", numbers, counts.to_report(self._cell_counters()))
        self.publisher.put(encode_report(report))


@final
class ReportReceiver:
    """Receiver of the shards' reports on the plant's side.

    Args:
        partition: Partition of the cells into shards.
        now: Returns the current tick.
        linked: Called with a shard and the rejoining cells (indices) that it can send to.

    Attributes:
        failed: Reports of failed cells that have not been drained, by cell. Only the first report of a cell is stored,
            which bounds the memory that a sender can fill.
        counters: By shard, counters of shards that have left.
    """

    def __init__(
        self,
        partition: Partition,
        now: Callable[[], int],
        linked: Callable[[int, Iterable[int]], None],
    ) -> None:
        self._lattice = partition.lattice
        self._shard_of = partition.shard_of
        self._now = now
        self._linked = linked
        self._hung: dict[Cell, Report] = {}
        self.failed: dict[Cell, Report] = {}
        self.counters: dict[int, MessageCounters] = {}
        self._busy: dict[int, int] = {}
        self._held: set[int] = set()

    def handle(self, shard: int, payload: bytes) -> None:
        """Handle a report of a shard.

        Raises:
            WireError: Not such a payload, of cells that are not its own, or too far ahead.
        """
        report = decode_report(payload, len(self._lattice))
        if report.kind == "counters":
            self.counters[shard] = MessageCounters.from_report(report.counts, report.counters)
        elif report.kind == "busy":
            self._busy[shard] = report.tick
        elif report.kind == "held":
            self._held.add(report.tick)
        elif report.kind == "rejoin_ready":
            cells = [self._lattice.index(cell) for cell in report.cells if cell in self._lattice]
            self._linked(shard, cells)
        else:
            self._check(shard, report)
            stored = self.failed if report.kind == "failed" else self._hung
            for cell in report.cells:
                stored.setdefault(cell, report)

    def _check(self, shard: int, report: Report) -> None:
        own = (c in self._lattice and self._shard_of[self._lattice.index(c)] == shard for c in report.cells)
        if not report.cells or not all(own):
            raise WireError("report", "cells", f"must be cells of shard {shard}")
        if report.tick > self._now() + EARLY_TICKS:
            raise WireError("report", "ahead", f"tick {report.tick}: must be at most {EARLY_TICKS} ahead")

    def drain_failed(self) -> list[tuple[str, Sequence[int]]]:
        """Return details and cells (indices) of reports on failures up to the current tick; each cell once."""
        now, due = self._now(), dict[int, tuple[str, list[int]]]()
        for cell, report in self.failed.items():
            if report.tick <= now:
                # a report is one object for all of its cells: hashing it would take a time of their number for each
                due.setdefault(id(report), (report.detail, []))[1].append(self._lattice.index(cell))
        self.failed = {cell: report for cell, report in self.failed.items() if report.tick > now}
        return list(due.values())

    def drain_busy(self, tick: int) -> set[int]:
        """Return shards that reported, since the last call, to be still computing ``tick``."""
        busy, self._busy = self._busy, {}
        return {shard for shard, at in busy.items() if at == tick}

    def drain_held(self, tick: int) -> bool:
        """Return whether a shard reported, since the last call, that a debugger holds one of its cells in ``tick``."""
        held, self._held = self._held, set()
        return tick in held

    def drain_hung(self) -> list[Report]:
        """Return reports of programs that hung since the last call; the cells of these programs stay live."""
        hung, self._hung = self._hung, {}
        return list(dict.fromkeys(hung.values()))
