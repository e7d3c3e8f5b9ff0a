"""What a run does around every tick: what it takes in when one is over, and what it lets happen before the next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from deploy.util.signals import Interrupted, Interruption

if TYPE_CHECKING:
    from bus.lockstep import Host
    from deploy.checkpoints.checkpointer import Keeper
    from deploy.control.server import Console
    from deploy.protocol_report.reporter import Reporter
    from deploy.recordings.run_log import Ledger
    from deploy.runs.rejections import Refused
    from deploy.workers.respawn import Respawn
    from plant.process import PlantProcess, TickRecord


@final
@dataclass(slots=True, eq=False)
class Conduct:
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

    host: Host
    ledger: Ledger
    interruption: Interruption
    hangs: bool
    registers: int | None
    refused: Refused
    reporter: Reporter | None
    console: Console | None = None
    respawn: Respawn | None = None
    keeper: Keeper | None = None
    process: PlantProcess | None = None

    def observe(self, record: TickRecord) -> None:
        """A tick is over.

        Raises:
            Interrupted: A signal has come.
        """
        self.ledger.tick(record)
        if record.losses and self.respawn is not None:
            self.respawn.lost(record.losses)
        if self.hangs:
            self.ledger.hung(self.host.take_hung())
        for shown in self.host.take_registers():
            if self.registers is not None and shown.tick % self.registers == 0:
                self.ledger.registers(shown)
            if self.reporter is not None:
                self.reporter.take(shown)
        self.refused.look(self.host.counts)
        if self.reporter is not None:
            self.reporter.take_drive(record.tick, record.drives, self.host.live(record.tick))
        if self.keeper is not None:
            self.keeper.look()
        if self.interruption.requested:
            raise Interrupted

    @property
    def attends(self) -> bool:
        """Whether anything may happen between two ticks."""
        return any(one is not None for one in (self.console, self.respawn, self.keeper))

    def attend(self, tick: int) -> None:
        """``tick`` is the next: workers come back, somebody asks for something."""
        assert self.process is not None, "this is a bug: no plant to conduct"
        if self.keeper is not None:
            self.keeper.attend(self.process)
        if self.respawn is not None and (cells := self.respawn.admitted(tick)):
            self.process.revive(cells)
            self.ledger.rejoined(tick, cells)
            if self.console is not None:
                self.console.retell(cells, tick)
        if self.console is not None:
            self.console.attend(tick)
