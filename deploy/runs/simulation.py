"""A run carried out: the cells started, ticks to whatever end, the cells stopped."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, final

from bus.errors import BusError
from bus.lockstep.counters import MessageCounters
from bus.lockstep.registers import RegisterRequest
from bus.wire.keys import plant_key
from deploy.checkpoints.checkpointer import make_checkpointer, restore_run
from deploy.errors import DeployError
from deploy.recordings.losses import unreported
from deploy.runs.hooks import RunHooks
from deploy.runs.pace import Pace
from deploy.runs.setup import process_of, sensor_schema, status_of
from deploy.util.signals import Interrupted, Interruption
from deploy.workers.worker import ResumePoint
from plant.errors import PlantError, PlantStopped

if TYPE_CHECKING:
    from bus.lockstep import Coordinator
    from deploy.checkpoints.checkpointer import Checkpointer, CheckpointMetadata
    from deploy.control.server import ControlServer
    from deploy.recordings.run_log import RunLog
    from deploy.recordings.writer import Recorder
    from deploy.runs.rejections import RejectionMonitor
    from deploy.runs.result import RunResult
    from deploy.runs.setup import RunSetup
    from deploy.workers.respawn import Respawner
    from deploy.workers.system import System
    from plant.plant import Plant
    from plant.process import PlantProcess


@final
@dataclass(slots=True, eq=False)
class RecordedRun:
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

    setup: RunSetup
    about: CheckpointMetadata | None
    system: System
    plant: Plant
    ledger: RunLog
    recorder: Recorder
    refused: RejectionMonitor
    interruption: Interruption
    result: RunResult
    _keeper: Checkpointer | None = field(default=None, init=False)

    def run(self, begun: float) -> None:
        """Start the cells, run to whatever end, stop the cells.

        Args:
            begun: When all of it began, monotonic wall seconds.
        """
        process: PlantProcess | None = None
        started = time.monotonic()
        try:
            with self.interruption.interruptible():
                process = self._process()
            started = time.monotonic()
            self.result.startup_s = started - begun
            self.interruption.is_idle = lambda: process.waiting
            self.result.from_loop(process.run(), self.ledger)
        except (Interrupted, PlantStopped):
            self.result.end(
                "interrupted", f"interrupted at {self.ledger.time_ns * 1e-9:g} s of simulated time"
            )
        except (BusError, DeployError) as error:
            self.result.end("failed", str(error))
        except PlantError as error:
            self.result.end(status_of(error), f"{error} (tick {self.ledger.ticks})")
        finally:
            self.interruption.is_idle = lambda: False
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
        ending, resumed = self.result, self.setup.resumed
        ending.wall_s = wall_s if resumed is None else wall_s + resumed.wall_s
        if self._keeper is not None:
            self._keeper.close()
        if ending.status == "failed" or self.ledger.cells_lost:
            ending.detail = "\n".join(text for text in (ending.detail, self.system.explain()) if text)
        ending.counts = self.system.stop(ending.reason or "the run is over") or MessageCounters()
        self.refused.poll(ending.counts)
        if self.system.unreported:
            self.ledger.warn(unreported(self.system.unreported, self.ledger.cells))

    # --- what is put together for it --------------------------------------------------------------

    def _process(self) -> PlantProcess:
        """Start the cells; the plant's process, ready to run."""
        asked, scene = self.setup, self.setup.scene
        readings = sensor_schema(scene, self.plant.sense())
        host = self.system.start(
            self.plant.array,
            readings,
            self._register_requests(),
            metered=True,
            live=asked.byte_accurate_links,
            keeps=self.about is not None,
            resumed=asked.resumed
            and ResumePoint(asked.resumed.tick, asked.resumed.dead, asked.resumed.states),
            counted=asked.resumed and asked.resumed.all_counts(),
        )
        conduct = self._make_hooks(host)
        process = process_of(
            scene,
            self.plant,
            host,
            readings,
            conduct.after_tick,
            lasts=asked.in_run_faults,
            pace=None if asked.options.realtime is None else Pace(asked.options.realtime, self.ledger.warn),
            attend=conduct.before_tick if conduct.has_before else None,
        )
        conduct.process = process
        if conduct.control_server is not None:
            conduct.control_server.attach(process)
        if asked.resumed is not None:
            restore_run(asked.resumed, process, self.ledger, asked.reporter)
        return process

    def _register_requests(self) -> tuple[RegisterRequest, ...]:
        """Registers that the run records, or its reporter watches."""
        registers, reporter = self.setup.options.registers, self.setup.reporter
        wanted = () if registers is None else (RegisterRequest(registers),)
        return wanted if reporter is None else (*wanted, *reporter.wanted)

    def _make_hooks(self, host: Coordinator) -> RunHooks:
        """What the run does around every tick."""
        asked = self.setup
        self._keeper = make_checkpointer(
            self.about,
            asked.options,
            host,
            self.ledger,
            self.recorder,
            asked.reporter,
            asked.resumed,
            asked.scene.stall.deadline_s,
        )
        return RunHooks(
            host,
            self.ledger,
            self.interruption,
            asked.scene.effects.cop is not None,
            asked.options.registers,
            self.refused,
            asked.reporter,
            self._control_server(host),
            self._respawner(host),
            self._keeper,
        )

    def _respawner(self, host: Coordinator) -> Respawner | None:
        """What starts lost workers anew; None where they are not to be."""
        times = self.setup.options.respawn
        if not times:
            return None
        from deploy.workers.respawn import Respawner

        return Respawner(self.system, host, self.setup.plan.partition, times, self.ledger.warn)

    def _control_server(self, host: Coordinator) -> ControlServer | None:
        """What takes requests while the run goes on; None where nobody can ask anything."""
        asked = self.setup
        questions = self.system.questions(plant_key(asked.plan.run, "operator"))
        if questions is None and asked.replayed is None:
            return None
        from deploy.control.server import ControlServer

        return ControlServer(
            asked.scene,
            asked.plan.run,
            asked.in_run_faults,
            host.control,
            self.ledger,
            questions,
            asked.script,
            lines=asked.byte_accurate_links,
        )
