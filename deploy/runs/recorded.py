"""A recorded run: the simulation of ``mdms run`` with everything that hooks into its ticks."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from bus.errors import BusError
from bus.lockstep.counters import MessageCounters
from bus.lockstep.registers import RegisterRequest
from bus.wire.message_type import leaves
from cell_firmware.message_tracer import TRACE, trace_registers
from cell_firmware.shard import MESSAGES
from deploy.checkpoints.checkpointer import make_checkpointer, restore_run
from deploy.errors import DeployError
from deploy.recordings.losses import rejoined, unreported
from deploy.recordings.message_trace import trace_of
from deploy.runs.backends import BusCells
from deploy.runs.result import RunResult
from deploy.runs.simulation import Simulation
from deploy.util.cell_ranges import select_cells
from deploy.util.signals import Interrupted, Interruption
from deploy.workers.status import RunProgress
from deploy.workers.worker import ResumePoint, cell_faults, make_controller
from plant.errors import PlantError, PlantStopped
from plant.tick import TickHooks, TickRecord

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bus.fault import FaultInstance, FaultSpec
    from bus.lockstep import Coordinator
    from bus.lockstep.registers import RegisterSnapshot
    from cell_firmware.controller import Controller
    from deploy.checkpoints.checkpointer import Checkpointer, CheckpointMetadata
    from deploy.control.server import ControlServer
    from deploy.recordings.run_log import RunLog
    from deploy.recordings.writer import Recorder
    from deploy.runs.checking import RunChecker
    from deploy.runs.rejections import RejectionMonitor
    from deploy.runs.setup import RunSetup
    from deploy.workers.respawn import Respawner
    from deploy.workers.system import System
    from plant.plant import Plant


@final
@dataclass(eq=False)
class RecordedRun:
    """One run of a prepared scene, with its log, recording, checkpoints, control server and respawned workers.

    Attributes:
        setup: The scene and how it is run.
        metadata: Common part of its checkpoints; None: there are none.
        system: Opened endpoints of the run.
        plant: The plant at its start.
        log: Log of the run.
        recorder: Recording of the run.
        rejections: Monitor of denied and malformed messages.
        interruption: Ends the run between two ticks, or while it only waits.
        checker: Checker of the program's invariants; None without ``--check``, or before the cells have started.
    """

    setup: RunSetup
    metadata: CheckpointMetadata | None
    system: System
    plant: Plant
    log: RunLog
    recorder: Recorder
    rejections: RejectionMonitor
    interruption: Interruption
    checker: RunChecker | None = None
    _checkpointer: Checkpointer | None = field(default=None, init=False)
    _control: ControlServer | None = field(default=None, init=False)

    @cached_property
    def _step_lag(self) -> int:
        """Ticks by which the number of a step lags behind its exchange: 1 where cells have clocks of their own."""
        return int(self.setup.scene.effects.clock is not None)

    @cached_property
    def _traced(self) -> NDArray[np.int64]:
        """Indices of the cells whose messages are traced."""
        named = self.setup.options.trace_messages
        if named is None:
            return np.zeros(0, dtype=np.int64)
        return select_cells(named, self.log.cells, "--trace-messages")

    def run(self, begun: float) -> RunResult:
        """Start the cells, run to the end, stop the cells.

        Args:
            begun: Start of the whole command, monotonic wall seconds.
        """
        simulation: Simulation | None = None
        started = time.monotonic()
        try:
            with self.interruption.interruptible():
                simulation = self._open()
            process = simulation.process
            started = time.monotonic()
            self.interruption.is_idle = lambda: process.waiting
            result = simulation.run()
        except (Interrupted, PlantStopped, BusError, DeployError, PlantError) as error:
            result = RunResult.of(self.plant)
            result.from_error(error, self.log.ticks, self.log.time_ns)
        finally:
            self.interruption.is_idle = lambda: False
        if simulation is not None:
            result.startup_s = started - begun
        if self.checker is not None:
            self.checker.judge(result)
        self._log_end(result)
        self._stop(result, time.monotonic() - started)
        if simulation is not None and not self.recorder.broken:
            process = simulation.process
            self.recorder.tick(
                process.tick,
                process.time_ns,
                process.sense.presence,
                None,
                self.plant.wheel_speed,
                self.plant.state,
            )
        return result

    def _log_end(self, result: RunResult) -> None:
        """Log the deaths and losses of the tick that ended the run."""
        if result.died:
            self.log.on_died(self.log.ticks, result.died)
        elif result.failed:
            self.log.note(result.last_losses)
        elif result.last_losses:
            self.log.on_lost(result.last_losses)

    def _stop(self, result: RunResult, wall_s: float) -> None:
        """Stop the cells, ``wall_s`` after the first tick."""
        resumed = self.setup.resumed
        result.wall_s = wall_s if resumed is None else wall_s + resumed.wall_s
        if self._checkpointer is not None:
            self._checkpointer.close()
        if self._control is not None:
            self._control.close()
        if result.status == "failed" or self.log.cells_lost:
            result.detail = "\n".join(text for text in (result.detail, self.system.explain()) if text)
        counters = self.system.stop(result.reason or "the run is over")
        if counters is not None:
            result.counters = counters
        self.rejections.poll(result.counters)
        if self.system.unreported:
            self.log.warn(unreported(self.system.unreported, self.log.cells))

    # --- the simulation and its hooks -------------------------------------------------------------

    def _open(self) -> Simulation:
        """Start the cells and register everything that hooks into ticks."""
        setup, resumed = self.setup, self.setup.resumed
        self.checker = self._checker()
        self.system.while_waiting = lambda: self.rejections.poll(MessageCounters())
        for asked in (self.system.status, self.system.waiting):
            if asked is not None and resumed is not None:
                asked.tick, asked.time_s = resumed.tick, resumed.tick * setup.scene.tick_ns * 1e-9
        simulation = Simulation.open(
            setup.scene,
            BusCells(
                self.system,
                self._register_requests(),
                metered=True,
                snapshots=self.metadata is not None,
                messages=setup.options.messages is not None,
                traced=setup.options.trace_messages is not None,
                resume=resumed
                and ResumePoint(resumed.tick, resumed.dead, resumed.states, resumed.links, resumed.relayed),
                counters=resumed and resumed.all_counts(),
            ),
            plant=self.plant,
            faults=setup.in_run_faults,
        )
        coordinator = self.system.coordinator
        assert coordinator is not None, "this is a bug: the cells have started without a coordinator"
        self._add_hooks(simulation, coordinator)
        if self.system.status is not None:
            self.system.status.progress = lambda: self._progress(simulation, coordinator)
        if resumed is not None:
            restore_run(resumed, simulation.process, self.log, setup.reporter)
            simulation.losses = self.log.found
        return simulation

    def _add_hooks(self, simulation: Simulation, coordinator: Coordinator) -> None:
        """Register the log, monitors, respawner, control server and checkpointer, in the order in which they act."""
        process = simulation.process
        if self.checker is not None:  # a violation ends the run before anything of the next tick is sent
            simulation.add_hooks(TickHooks(before_tick=(lambda _: process.report(),)))
        checkpointer = self._checkpointer = make_checkpointer(
            self.metadata,
            self.setup.options,
            coordinator,
            self.log,
            self.recorder,
            self.setup.reporter,
            self.setup.resumed,
            self.setup.scene.stall.deadline_s,
        )
        respawner = self._respawner(coordinator)
        control = self._control = self._control_server(simulation, coordinator)
        simulation.add_hooks(TickHooks(after_tick=(self.log.tick,)))
        if checkpointer is not None:
            simulation.add_hooks(TickHooks(before_tick=(lambda _: checkpointer.before_tick(process),)))
        if respawner is not None:

            def readmit(tick: int) -> None:
                cells = respawner.poll_rejoined(tick)
                if cells:
                    process.revive(cells)
                    self.log.on_rejoin(tick, cells)
                    self.log.warn(rejoined(cells, self.log.cells, tick, self.setup.scene.tick_ns))
                    control.faults.resend_faults(cells, tick)

            def lost(record: TickRecord) -> None:
                if record.losses:
                    respawner.on_lost(record.losses)

            simulation.add_hooks(TickHooks((readmit,), (lost,)))
        simulation.add_hooks(TickHooks(before_tick=(control.before_tick,)))
        simulation.add_hooks(TickHooks(after_tick=(self._watch(coordinator),)))
        if checkpointer is not None:
            simulation.add_hooks(TickHooks(after_tick=(lambda _: checkpointer.poll(),)))
        simulation.add_hooks(TickHooks(after_tick=(self._interrupt,)))

    def _watch(self, coordinator: Coordinator) -> Callable[[TickRecord], None]:
        """Return the hook that handles hang reports, registers and rejections after a tick."""
        hangs, reporter = self.setup.scene.effects.cop is not None, self.setup.reporter
        checker = self.checker

        def watch(record: TickRecord) -> None:
            if hangs:
                self.log.on_hung(coordinator.drain_hung())
            for registers in coordinator.drain_registers():
                self._record_registers(registers)
                if reporter is not None:
                    reporter.take(registers)
                if checker is not None:
                    checker.take(registers)
            self.rejections.poll(coordinator.counters)
            if reporter is not None:
                reporter.take_drive(record.tick, record.drives, coordinator.live(record.tick))

        return watch

    def _record_registers(self, shown: RegisterSnapshot) -> None:
        """Record registers, messages and the trace of a tick, as far as they are requested."""
        options = self.setup.options
        registers, messages, trace = dict[str, Any](), dict[str, Any](), dict[str, Any]()
        for name, array in shown.registers.items():
            if name.startswith(MESSAGES):
                messages[name.removeprefix(MESSAGES)] = array
            elif name.startswith(f"{TRACE}."):
                trace[name.removeprefix(f"{TRACE}.")] = array
            else:
                registers[name] = array
        if options.registers is not None and shown.tick % options.registers == 0:
            self.log.registers(shown.tick, registers)
        if options.messages is not None and shown.tick % options.messages == 0:
            self.log.messages(shown.tick, messages)
        if len(self._traced):
            self.log.trace(shown.tick, trace_of(trace, self._traced, shown.tick - self._step_lag))

    def _progress(self, simulation: Simulation, coordinator: Coordinator) -> RunProgress:
        """Return the progress of the run, for whoever asks; called by another thread."""
        assert self._control is not None, "this is a bug: the run has begun without a control server"
        lost = {self.log.cells[loss.cell] for loss in simulation.losses}
        return RunProgress(
            simulation.tick,
            simulation.time_s,
            self._control.flow.state(),
            [cell for cell in self.log.cells_lost if cell in lost],
            coordinator.awaited(),
        )

    def _interrupt(self, record: TickRecord) -> None:
        """End the run after a signal; a hook."""
        del record
        if self.interruption.requested:
            raise Interrupted

    def _register_requests(self) -> tuple[RegisterRequest, ...]:
        """Return the registers that the recording and the protocol's reporter need."""
        registers, reporter = self.setup.options.registers, self.setup.reporter
        requests = () if registers is None else (RegisterRequest(registers),)
        if self.setup.options.messages is not None:
            requests += (RegisterRequest(self.setup.options.messages, self._message_names()),)
        if len(self._traced):
            message = self._controller().message_type
            assert message is not None, "this is a bug: a trace of a program without messages"
            requests += (RegisterRequest(1, frozenset(trace_registers(message))),)
        if self.checker is not None:
            requests += self.checker.wanted
        return requests if reporter is None else (*requests, *reporter.wanted)

    def _controller(self) -> Controller:
        setup = self.setup
        return make_controller(setup.scene, cell_faults(setup.scene), live=setup.byte_accurate_links)

    def _checker(self) -> RunChecker | None:
        """Return the checker of the program's invariants; None without ``--check``."""
        check = self.setup.options.check
        if check is None:
            return None
        from deploy.runs.checking import RunChecker

        def faults() -> Sequence[FaultInstance[FaultSpec]]:
            return self.setup.in_run_faults if self._control is None else self._control.faults.known

        return RunChecker(self.setup.scene, self.plant.array.lattice, check, faults)

    def _message_names(self) -> frozenset[str]:
        """Return the names of the registers that show messages."""
        link = self._controller().link_type
        names = () if link is None else ("sent", *(leaf.name for leaf in leaves(link)))
        return frozenset(f"{MESSAGES}{name}" for name in names)

    def _respawner(self, coordinator: Coordinator) -> Respawner | None:
        """Return the respawner of lost workers; None without ``--respawn``."""
        times = self.setup.options.respawn
        if not times:
            return None
        from deploy.workers.respawn import Respawner

        done = "may be started again" if self.setup.plan.external else "is restarted"
        return Respawner(self.system, coordinator, self.setup.plan.partition, times, self.log.warn, done)

    def _control_server(self, simulation: Simulation, coordinator: Coordinator) -> ControlServer:
        """Return the control server, whose feed answers the run's viewers."""
        from deploy.control.server import ControlServer

        setup, system, run = self.setup, self.system, self.setup.plan.run
        server = ControlServer(
            setup.scene,
            run,
            setup.in_run_faults,
            coordinator.control,
            self.log,
            simulation.process,
            system.questions("operator"),
            setup.script,
            show=coordinator.show_registers,
            lines=setup.byte_accurate_links,
            factor=setup.options.realtime,
            paused=setup.options.paused,
        )
        if system.waiting is not None:
            for request in system.waiting.accepted:
                server.flow.handle(request, simulation.process.tick)
        viewers = system.questions("view")
        if viewers is not None:
            from deploy.live.feed import Feed

            feed = Feed(viewers, simulation.process, self.plant, server, self.log, self.recorder.header)
            simulation.add_hooks(TickHooks(after_tick=(feed.after_tick,)))
            server.watch = feed.serve
        return server
