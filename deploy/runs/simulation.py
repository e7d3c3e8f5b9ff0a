"""A run carried out: the cells started, ticks to whatever end, the cells stopped."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

from bus.errors import BusError
from bus.lockstep.counters import Counts
from bus.lockstep.registers import Wanted
from bus.wire.keys import plant_key
from deploy.checkpoints.checkpointer import go_on, keeper_of
from deploy.errors import DeployError
from deploy.recordings.losses import unreported
from deploy.runs.hooks import Conduct
from deploy.runs.pace import Pace
from deploy.runs.setup import process_of, readings_of, status_of
from deploy.util.signals import Interrupted, Interruption
from deploy.workers.worker import Resumed
from plant.errors import PlantError, PlantStopped

if TYPE_CHECKING:
    from bus.lockstep import Host
    from deploy.checkpoints.checkpointer import About, Keeper
    from deploy.control.server import Console
    from deploy.recordings.run_log import Ledger
    from deploy.recordings.writer import Recorder
    from deploy.runs.rejections import Refused
    from deploy.runs.result import Ending
    from deploy.runs.setup import Prepared
    from deploy.workers.respawn import Respawn
    from deploy.workers.system import System
    from plant.plant import Plant
    from plant.process import PlantProcess


@final
@dataclass(slots=True, eq=False)
class Execution:
    """Runs a prepared run once, and tells its ending.

    Attributes:
        asked: What is to be run.
        about: What its checkpoints have in common; None: there are none.
        system: Open.
        plant: At its start.
        ledger: Of the run.
        recorder: Likewise.
        refused: Likewise.
        interruption: Heeded between ticks, and where the run only waits.
        ending: Told how it ended, what was counted and how long it took.
    """

    asked: Prepared
    about: About | None
    system: System
    plant: Plant
    ledger: Ledger
    recorder: Recorder
    refused: Refused
    interruption: Interruption
    ending: Ending
    _keeper: Keeper | None = field(default=None, init=False)

    def run(self, begun: float) -> None:
        """Start the cells, run to whatever end, stop the cells.

        Args:
            begun: When all of it began, monotonic wall seconds.
        """
        process: PlantProcess | None = None
        started = time.monotonic()
        try:
            with self.interruption.allowed():
                process = self._process()
            started = time.monotonic()
            self.ending.startup_s = started - begun
            self.interruption.waits = lambda: process.waiting
            self.ending.take(process.run(), self.ledger)
        except (Interrupted, PlantStopped):
            self.ending.by(
                "interrupted", f"interrupted at {self.ledger.time_ns * 1e-9:g} s of simulated time"
            )
        except (BusError, DeployError) as error:
            self.ending.by("failed", str(error))
        except PlantError as error:
            self.ending.by(status_of(error), f"{error} (tick {self.ledger.ticks})")
        finally:
            self.interruption.waits = lambda: False
            self._stop(time.monotonic() - started)
        if process is not None and not self.recorder.broken:
            self.recorder.tick(
                process.tick,
                process.time_ns,
                process.sense.presence,
                None,
                self.plant.wheel_speed,
                self.plant.state,
            )

    def _stop(self, wall_s: float) -> None:
        """Stop the cells, after so long a time."""
        ending, resumed = self.ending, self.asked.resumed
        ending.wall_s = wall_s if resumed is None else wall_s + resumed.wall_s
        if self._keeper is not None:
            self._keeper.close()
        if ending.status == "failed" or self.ledger.cells_lost:
            ending.detail = "\n".join(text for text in (ending.detail, self.system.explain()) if text)
        ending.counts = self.system.stop(ending.reason or "the run is over") or Counts()
        self.refused.look(ending.counts)
        if self.system.unreported:
            self.ledger.warn(unreported(self.system.unreported, self.ledger.cells))

    # --- what is put together for it --------------------------------------------------------------

    def _process(self) -> PlantProcess:
        """Start the cells; the plant's process, ready to run."""
        asked, scene = self.asked, self.asked.scene
        readings = readings_of(scene, self.plant.sense())
        host = self.system.start(
            self.plant.array,
            readings,
            self._wanted(),
            metered=True,
            live=asked.live,
            keeps=self.about is not None,
            resumed=asked.resumed and Resumed(asked.resumed.tick, asked.resumed.dead, asked.resumed.states),
            counted=asked.resumed and asked.resumed.all_counts(),
        )
        conduct = self._conduct(host)
        process = process_of(
            scene,
            self.plant,
            host,
            readings,
            conduct.observe,
            lasts=asked.lasting,
            pace=None if asked.options.realtime is None else Pace(asked.options.realtime, self.ledger.warn),
            attend=conduct.attend if conduct.attends else None,
        )
        conduct.process = process
        if conduct.console is not None:
            conduct.console.attach(process)
        if asked.resumed is not None:
            go_on(asked.resumed, process, self.ledger, asked.reporter)
        return process

    def _wanted(self) -> tuple[Wanted, ...]:
        """Registers that the run records, or its reporter watches."""
        registers, reporter = self.asked.options.registers, self.asked.reporter
        wanted = () if registers is None else (Wanted(registers),)
        return wanted if reporter is None else (*wanted, *reporter.wanted)

    def _conduct(self, host: Host) -> Conduct:
        """What the run does around every tick."""
        asked = self.asked
        self._keeper = keeper_of(
            self.about,
            asked.options,
            host,
            self.ledger,
            self.recorder,
            asked.reporter,
            asked.resumed,
            asked.scene.stall.deadline_s,
        )
        return Conduct(
            host,
            self.ledger,
            self.interruption,
            asked.scene.effects.cop is not None,
            asked.options.registers,
            self.refused,
            asked.reporter,
            self._console(host),
            self._respawn(host),
            self._keeper,
        )

    def _respawn(self, host: Host) -> Respawn | None:
        """What starts lost workers anew; None where they are not to be."""
        times = self.asked.options.respawn
        if not times:
            return None
        from deploy.workers.respawn import Respawn

        return Respawn(self.system, host, self.asked.plan.partition, times, self.ledger.warn)

    def _console(self, host: Host) -> Console | None:
        """What takes requests while the run goes on; None where nobody can ask anything."""
        asked = self.asked
        questions = self.system.questions(plant_key(asked.plan.run, "operator"))
        if questions is None and asked.replayed is None:
            return None
        from deploy.control.server import Console

        return Console(
            asked.scene,
            asked.plan.run,
            asked.lasting,
            host.control,
            self.ledger,
            questions,
            asked.script,
            lines=asked.live,
        )
