"""Log of a run: passes ticks, events and faults to digest, recording, progress display and summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Final, final

from bus.fault import transition_ticks
from bus.state import StateFields
from deploy.faults.records import transition_records
from deploy.recordings.digest import Digest
from deploy.recordings.losses import found, lines
from deploy.recordings.mishaps import Mishaps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from bus.fault import FaultInstance, FaultSpec
    from bus.lockstep.counters import Loss
    from bus.wire.frames import Report
    from deploy.recordings.writer import Recorder
    from deploy.util.progress import Progress
    from plant.observations import Event
    from plant.tick import TickRecord

MESSAGES_LIMIT: Final = 1 << 30
"""Most bytes of messages that a run records, before compression."""


@final
class RunLog:
    """Log of a run's ticks, events, faults, losses and live commands.

    Args:
        cells: ``(row, column)`` of every cell, in the lattice's order.
        period_ns: Length of a tick, ns.
        digest: Digest of the run, continued tick by tick.
        recorder: Recorder of ticks, events and faults.
        progress: Progress display.
        policy: Stall policy for the wheels of dead cells.
        warn: Called with one line for every loss, and for parcels that tip or fall.
        injected: Faults that begin and end during the run.

    Attributes:
        cells: As given.
        period_ns: As given.
        ticks: Number of complete ticks.
        time_ns: Simulated time reached, ns.
        faults: Faults and losses in order: ``time_s``, ``kind``, ``cell``, ``tick``, ``detail``; faults that begin and
            end have ``phase``, ``number`` and all their ``cells``.
        cells_lost: ``(row, column)`` of each dead or lost cell, in order.
        warn: As given.
        disturbed: Whether faults were injected or repaired by live commands.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        "_digest", "ticks", "time_ns", "faults", "cells_lost", "_hung", "_turns"
    )

    def __init__(
        self,
        cells: Sequence[tuple[int, int]],
        period_ns: int,
        *,
        digest: Digest,
        recorder: Recorder,
        progress: Progress,
        policy: str,
        warn: Callable[[str], None],
        injected: Sequence[FaultInstance[FaultSpec]] = (),
    ) -> None:
        self.cells = cells
        self.period_ns = period_ns
        self._digest = digest
        self._recorder = recorder
        self._progress = progress
        self._policy = policy
        self.warn = warn
        self._mishaps = Mishaps(warn)
        self.ticks = 0
        self.time_ns = 0
        self.faults: list[Mapping[str, Any]] = []
        self.cells_lost: list[tuple[int, int]] = []
        self.disturbed = False
        self._message_bytes = Counter[str]()
        self._hung: set[str] = set()
        self._injected = list(injected)
        self._turns = transition_ticks(self._injected)

    def show(self, events: int) -> None:
        """Restore the progress display after a resume; ``events``: number of plant events before the checkpoint."""
        self._progress.events, self._progress.lost = events, len(self.cells_lost)

    def tick(self, record: TickRecord) -> None:
        """Log a complete tick."""
        if self._turns and record.tick >= self._turns[0]:
            self._on_transition(record.tick)
        if record.died:
            self.on_died(record.tick, record.died)
        if record.losses:
            self.on_lost(record.losses)
        self._digest.tick(record.tick, record.sense.presence, record.drives, record.after)
        self._recorder.tick(
            record.tick,
            record.start_ns,
            record.sense.presence,
            record.drives,
            record.wheel_speed,
            record.before,
        )
        if record.events:
            self._take_events(record.events)
        self.ticks = record.tick + 1
        self.time_ns = record.until_ns
        self._progress.update(self.ticks, self.time_ns)

    @property
    def digest(self) -> str:
        """Digest of the run so far, in hexadecimal."""
        return self._digest.hexdigest

    @property
    def motion_digest(self) -> str:
        """Motion digest of the run so far, in hexadecimal."""
        return self._digest.motion_hexdigest

    def inject(self, fault: FaultInstance[FaultSpec]) -> None:
        """Add a fault that begins in a tick not yet logged."""
        self._injected.append(fault)
        self.replan()

    def replan(self) -> None:
        """Update the transitions after a fault's end tick has changed."""
        self._turns = [turn for turn in transition_ticks(self._injected) if turn >= self.ticks]

    def control(self, record: Mapping[str, Any]) -> None:
        """Log a live command."""
        self.disturbed = self.disturbed or record["kind"] in ("fault", "repair")
        self._recorder.control(record)

    def _on_transition(self, tick: int) -> None:
        """Log the faults that begin or end."""
        self._turns.pop(0)
        for one in self._injected:
            for fault in transition_records(one, tick, self.period_ns, self.cells):
                self.faults.append(fault)
                self._recorder.fault(fault)

    def registers(self, tick: int, registers: Mapping[str, NDArray[Any]]) -> None:
        """Record the cells' registers after a tick."""
        self._recorder.registers(tick, tick * self.period_ns, registers)

    def messages(self, tick: int, messages: Mapping[str, NDArray[Any]]) -> None:
        """Record the messages that cells sent in a tick, up to ``MESSAGES_LIMIT`` bytes in all."""
        if self._fits("messages", tick, messages):
            self._recorder.messages(tick, tick * self.period_ns, messages)

    def trace(self, tick: int, trace: Mapping[str, NDArray[Any]]) -> None:
        """Record what programs read and sent in a tick, up to ``MESSAGES_LIMIT`` bytes in all."""
        if self._fits("trace-messages", tick, trace):
            self._recorder.trace(tick, tick * self.period_ns, trace)

    def _fits(self, option: str, tick: int, arrays: Mapping[str, NDArray[Any]]) -> bool:
        """Whether more messages may be recorded for an option; warns where its limit is reached."""
        before, size = self._message_bytes[option], sum(array.nbytes for array in arrays.values())
        if before + size <= MESSAGES_LIMIT:
            self._message_bytes[option] += size
            return True
        if before < MESSAGES_LIMIT:
            self._message_bytes[option] = MESSAGES_LIMIT
            self.warn(f"--{option}: {MESSAGES_LIMIT >> 20} MB of messages are recorded, up to tick {tick:,}")
        return False

    def _take_events(self, events: Sequence[Event]) -> None:
        for event in events:
            self._recorder.event(event_record(event))
        self._mishaps.take(events)
        self._progress.events += len(events)

    def on_died(self, tick: int, cells: Sequence[int]) -> None:
        """Log cells that died by schedule at the start of a tick."""
        for cell in cells:
            self._fault(tick, "crash", cell, "scheduled")

    def on_lost(self, losses: Sequence[Loss]) -> None:
        """Log lost cells, with one warning for all cells lost alike."""
        self.note(losses)
        then = "the run ends" if self._policy == "abort" else f"wheels {self._policy}"
        for line in lines(losses, self.cells, self.period_ns):
            self.warn(f"{line}; {then}")

    def note(self, losses: Sequence[Loss]) -> None:
        """Log lost cells: a traceback once, for the first cell that has it, and its first line for the others."""
        logged = {fault.get("detail") for fault in self.faults if isinstance(fault.get("detail"), str)}
        for loss in losses:
            detail = loss.detail.partition("\n")[0] if loss.detail in logged else loss.detail
            logged.add(loss.detail)
            self._fault(loss.tick, loss.reason, loss.cell, detail)

    def on_rejoin(self, tick: int, cells: Sequence[int]) -> None:
        """Log cells that rejoin at ``tick``."""
        places = [self.cells[cell] for cell in cells]
        fault = {
            "time_s": tick * self.period_ns * 1e-9,
            "kind": "respawn",
            "phase": "happens",
            "cell": list(places[0]) if len(places) == 1 else None,
            "cells": [list(place) for place in places],
            "tick": tick,
            "detail": "as after power-on",
        }
        self.faults.append(fault)
        self._recorder.fault(fault)
        self.cells_lost = [place for place in self.cells_lost if place not in places]
        self._progress.lost -= len(places)

    def on_hung(self, reports: Sequence[Report]) -> None:
        """Warn of programs that hang, once for each reason."""
        for report in reports:
            problem = report.detail.partition("\n")[0]
            if problem in self._hung:
                continue
            self._hung.add(problem)
            row, column = report.cells[0]
            since = f"tick {report.tick} ({report.tick * self.period_ns * 1e-9:g} s)"
            self.warn(
                f"the program of cell {row},{column} hangs from {since} until a reset (further cells that hang for "
                f"this reason are only counted): {report.detail}"
            )

    @property
    def found(self) -> list[Loss]:
        """Losses of cells so far, neither scheduled nor injected, rejoined cells included."""
        return found(self.faults, self.cells)

    def _fault(self, tick: int, kind: str, cell: int, detail: str) -> None:
        place = self.cells[cell]
        fault = {
            "time_s": tick * self.period_ns * 1e-9,
            "kind": kind,
            "cell": list(place),
            "tick": tick,
            "detail": detail,
        }
        self.faults.append(fault)
        self.cells_lost.append(place)
        self._recorder.fault(fault)
        self._progress.lost += 1


def event_record(event: Event) -> dict[str, Any]:
    """Return an event of the plant as a record for the recording."""
    return {
        "time_s": event.time_s,
        "kind": event.kind,
        "parcel": event.parcel,
        "cells": event.cells,
        "position_m": event.position_m,
        "detail": event.detail,
    }
