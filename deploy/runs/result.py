"""Result of a run, and its summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, final

from bus.lockstep.counters import MessageCounters
from deploy.recordings.losses import Places, failure, lines, nobody
from deploy.runs.output import parcel_outcomes, validity
from deploy.runs.rejections import DENIED, MALFORMED, MESSAGE, RejectionMonitor, total
from deploy.runs.summary import Messages, ProtocolMessages, Summary
from deploy.scenes.fault_schedule import crash_aborts
from deploy.util.notebook import facts_html
from deploy.util.signals import Interrupted
from plant.errors import PlantError, PlantStopped, PlantUnstable

if TYPE_CHECKING:
    from bus.lockstep.counters import Loss
    from deploy.protocol_report.report import ProtocolReport
    from deploy.recordings.run_log import RunLog
    from deploy.scenes.scene import Scene
    from deploy.workers.plan import Plan
    from plant.observations import Event, ParcelStatus
    from plant.plant import Plant
    from plant.tick import LoopResult
    from plant.wheels import Floats


@final
@dataclass(slots=True, kw_only=True, eq=False)
class RunResult:
    """Result of a run: status, losses and final state.

    Attributes:
        status: ``ok``, ``failed``, ``stalled``, ``unstable`` or ``interrupted``.
        reason: Why the status is not ``ok``, one line; empty where it is.
        detail: More lines on what went wrong, such as a program's traceback.
        losses: All cells that were lost, in order of ticks.
        last_losses: Those of the tick that ended the run, where losses ended it.
        failed: Of the last losses, the cells whose program failed, where that ended the run.
        died: Cells whose scheduled death ended the run.
        events: Events of the plant, as far as somebody collected them: see ``run_headless``.
        state: ``(m, 6)``, x, y, angle and their rates of every parcel, m, rad and s.
        parcel_status: Status of every parcel.
        footprints_m: ``(v, 2)`` each, corners of every parcel about its centre of mass, in its axes, m.
        misrouted: Parcels that left by another exit than theirs.
        counters: Messages of all sides; complete once the cells are stopped.
        startup_s: Wall time until the first tick, s.
        wall_s: Wall time of the run itself, s.
        reset: Whether an operator ended the run to begin it again.
    """

    status: str = "ok"
    reason: str = ""
    detail: str = ""
    losses: Sequence[Loss] = ()
    last_losses: Sequence[Loss] = ()
    failed: Sequence[Loss] = ()
    died: tuple[int, ...] = ()
    events: Sequence[Event] = ()
    state: Floats
    parcel_status: Sequence[ParcelStatus] = ()
    footprints_m: Sequence[Floats] = ()
    misrouted: int = 0
    counters: MessageCounters = field(default_factory=MessageCounters)
    startup_s: float = 0.0
    wall_s: float = 0.0
    reset: bool = False

    @classmethod
    def of(cls, plant: Plant) -> Self:
        """Return a result ``ok`` with the plant's current state."""
        traffic = plant.traffic()
        return cls(
            state=plant.state,
            parcel_status=tuple(plant.status),
            footprints_m=plant.footprints_m,
            misrouted=0 if traffic is None else traffic.misrouted,
        )

    def _repr_html_(self) -> str:
        """Representation in notebooks."""
        facts = [("status", f"{self.status}: {self.reason}" if self.reason else self.status)]
        facts += [("cells lost", str(self.cells_lost)), ("wall time", f"{self.wall_s:.3g} s")]
        for number, (state, status) in enumerate(zip(self.state, self.parcel_status, strict=True)):
            x, y, angle = state[:3].tolist()
            facts.append((f"parcel {number}", f"{status.state} at ({x:.4g}, {y:.4g}) m, {angle:.4g} rad"))
        return facts_html("Result of a run", facts)

    @property
    def cells_lost(self) -> int:
        """Number of ``losses``."""
        return len(self.losses)

    @property
    def ok(self) -> bool:
        """Whether the run reached the end of its scene."""
        return self.status == "ok"

    def end(self, status: str, reason: str) -> None:
        """Set status and reason."""
        self.status, self.reason = status, reason

    def from_loop(
        self, ended: LoopResult, cells: Places, tick: int, period_ns: int, found: Sequence[Loss] = ()
    ) -> None:
        """Set the result from the end of the tick loop.

        Args:
            ended: Result of the tick loop.
            cells: ``(row, column)`` of every cell, in the lattice's order.
            tick: Ticks that are over.
            period_ns: Length of a tick, ns.
            found: Losses before the last tick.
        """
        self.losses = (*found, *ended.losses)
        self.last_losses, self.failed, self.died = ended.losses, ended.failed, ended.died
        if ended.failed:
            self.end("failed", failure(ended.failed, cells, period_ns))
            self.detail = ended.failed[0].detail
        elif ended.nobody:
            self.end("failed", nobody(found, cells, period_ns))
            self.detail = next((loss.detail for loss in found if loss.detail), "")
        elif ended.died:
            self.end("failed", crash_aborts(cells[ended.died[0]], tick * period_ns * 1e-9))
        elif ended.losses:
            lost = "; ".join(lines(ended.losses, cells, period_ns))
            self.end(ended.status, f"{lost}; stall.policy is abort")
            self.detail = next((loss.detail for loss in ended.losses if loss.detail), "")

    def from_error(self, error: BaseException, tick: int, time_ns: int) -> None:
        """Set the result from the error that ended the tick loop.

        Args:
            error: Raised by the loop or one of its hooks.
            tick: Ticks that are over.
            time_ns: Simulated time reached, ns.
        """
        if isinstance(error, (Interrupted, PlantStopped)):
            self.reset = getattr(error, "reset", False)
            said = str(error) if isinstance(error, Interrupted) else ""
            self.end("interrupted", f"{said or 'interrupted'} at {time_ns * 1e-9:g} s of simulated time")
        elif isinstance(error, PlantError):
            self.end(status_of(error), f"{error} (tick {tick})")
        else:
            self.end("failed", str(error))


def summary_of(
    scene: Scene,
    plan: Plan,
    ending: RunResult,
    plant: Plant,
    run_log: RunLog,
    refused: RejectionMonitor,
    folder: Path,
    *,
    warnings: tuple[str, ...],
    protocol: ProtocolReport | None,
    check: Mapping[str, Any] | None,
    resumed: tuple[int, ...],
) -> Summary:
    """Return the summary of a run.

    Args:
        scene: Scene of the run.
        plan: Plan of the run.
        ending: Result of the run.
        plant: Plant at the end.
        run_log: Log of the run.
        refused: Monitor of rejections.
        folder: Output folder.
        warnings: Warnings given before the start.
        protocol: Protocol report; None without one.
        check: Violations of invariants; None where they weren't checked.
        resumed: Ticks before which the run was resumed.
    """
    counts = ending.counters
    firmware = _firmware(scene)
    rows = refused.summary_rows(counts)
    messages = Messages(
        sent=counts.sent,
        delivered=counts.delivered,
        lost=counts.lost,
        late=counts.late,
        denied=total(rows, DENIED, MESSAGE),
        malformed=total(rows, MALFORMED),
        protocol=_protocol_messages(firmware, counts.cell_counters),
    )
    return Summary(
        status=ending.status,
        reason=ending.reason or None,
        scene=scene.name,
        seed=scene.seed,
        duration_s=scene.duration_s,
        simulated_s=run_log.time_ns * 1e-9,
        cells=len(plant.array),
        firmware=firmware,
        processes=plan.workers,
        transport=plan.transport,
        solver=scene.solver.accuracy(),
        ticks=run_log.ticks,
        wall_s=ending.wall_s,
        startup_s=ending.startup_s,
        parcels=parcel_outcomes(plant),
        support_changes=plant.support_changes,
        **validity(plant, scene),
        messages=messages,
        refused=rows,
        faults=run_log.faults,
        cells_lost=run_log.cells_lost,
        feeders=plant.traffic(),
        warnings=warnings,
        effects=_of_effects(counts.cell_counters),
        protocol=protocol,
        check=check,
        digest=run_log.digest,
        motion_digest=run_log.motion_digest,
        resumed=resumed,
        output=str(folder),
    )


def _firmware(scene: Scene) -> dict[str, str | int]:
    """Return name, form and message size of the cells' firmware."""
    from cell_firmware.loader import load

    firmware = load(scene.cells)
    size = 0 if firmware.message is None else firmware.message.itemsize
    return {"name": scene.cells.firmware.rpartition("/")[2], "form": firmware.form, "message_bytes": size}


def _protocol_messages(
    firmware: Mapping[str, str | int], counters: Mapping[str, int]
) -> ProtocolMessages | None:
    """Return the cells' counts of messages between cells; None for firmware without messages."""
    if not firmware["message_bytes"]:
        return None
    return ProtocolMessages(
        sent=counters.get("messages.sent", 0), received=counters.get("messages.received", 0)
    )


def _of_effects(counters: Mapping[str, int]) -> dict[str, int]:
    """Return the counters of effects; message counters are left out."""
    return {name: number for name, number in sorted(counters.items()) if not name.startswith("messages.")}


def status_of(error: PlantError) -> str:
    """Return ``unstable`` if a motion can't be followed, ``interrupted`` after a stop request, else ``failed``."""
    if isinstance(error, PlantStopped):
        return "interrupted"
    return "unstable" if isinstance(error, PlantUnstable) else "failed"
