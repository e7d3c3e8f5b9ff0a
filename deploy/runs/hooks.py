"""What a run does around every tick: what it takes in when one is over, and what it lets happen before the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from deploy.util.signals import Interrupted, Interruption

if TYPE_CHECKING:
    from bus.lockstep import Coordinator
    from deploy.checkpoints.checkpointer import Checkpointer
    from deploy.control.server import ControlServer
    from deploy.protocol_report.reporter import Reporter
    from deploy.recordings.run_log import RunLog
    from deploy.runs.rejections import RejectionMonitor
    from deploy.workers.respawn import Respawner
    from plant.process import PlantProcess, TickRecord


@final
@dataclass(slots=True, eq=False)
class RunHooks:
    """Passes on what happens, to whoever a run has for it.

    Attributes:
        host: The plant's side of the lockstep.
        ledger: Of the run.
        interruption: Heeded when a tick is over.
        hangs: Whether programs may hang.
        registers: Record the cells' registers every so many ticks; None: not.
        refused: Tells what is refused.
        reporter: Watches the protocol, where that is asked for.
        console: Takes requests, where somebody can ask.
        respawn: Starts lost workers anew, where that is asked for.
        keeper: Takes checkpoints, where that is asked for.
        process: The plant's process; set before the first tick.
    """

    coordinator: Coordinator
    log: RunLog
    interruption: Interruption
    hangs: bool
    registers: int | None
    rejections: RejectionMonitor
    reporter: Reporter | None
    control_server: ControlServer | None = None
    respawner: Respawner | None = None
    checkpointer: Checkpointer | None = None
    process: PlantProcess | None = None

    def after_tick(self, record: TickRecord) -> None:
        """A tick is over.

        Raises:
            Interrupted: A signal has come.
        """
        self.log.tick(record)
        if record.losses and self.respawner is not None:
            self.respawner.on_lost(record.losses)
        if self.hangs:
            self.log.on_hung(self.coordinator.drain_hung())
        for shown in self.coordinator.drain_registers():
            if self.registers is not None and shown.tick % self.registers == 0:
                self.log.registers(shown)
            if self.reporter is not None:
                self.reporter.take(shown)
        self.rejections.poll(self.coordinator.counters)
        if self.reporter is not None:
            self.reporter.take_drive(record.tick, record.drives, self.coordinator.live(record.tick))
        if self.checkpointer is not None:
            self.checkpointer.poll()
        if self.interruption.requested:
            raise Interrupted

    @property
    def has_before(self) -> bool:
        """Whether anything may happen between two ticks."""
        return any(one is not None for one in (self.control_server, self.respawner, self.checkpointer))

    def before_tick(self, tick: int) -> None:
        """``tick`` is the next: workers come back, somebody asks for something."""
        assert self.process is not None, "this is a bug: no plant to conduct"
        if self.checkpointer is not None:
            self.checkpointer.before_tick(self.process)
        if self.respawner is not None and (cells := self.respawner.poll_rejoined(tick)):
            self.process.revive(cells)
            self.log.on_rejoin(tick, cells)
            if self.control_server is not None:
                self.control_server.resend_faults(cells, tick)
        if self.control_server is not None:
            self.control_server.before_tick(tick)
