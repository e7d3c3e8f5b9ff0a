"""How a run ended, and its summary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, final

from bus.lockstep.counters import MessageCounters
from deploy.recordings.losses import failure, lines, nobody
from deploy.runs.output import parcel_outcomes, validity
from deploy.runs.rejections import DENIED, MALFORMED, MESSAGE, RejectionMonitor, total
from deploy.runs.summary import Messages, ProtocolMessages, Summary
from deploy.scenes.fault_schedule import crash_aborts

if TYPE_CHECKING:
    from deploy.protocol_report.report import ProtocolReport
    from deploy.recordings.run_log import RunLog
    from deploy.scenes.scene import Scene
    from deploy.workers.plan import Plan
    from plant.plant import Plant
    from plant.process import LoopResult


@final
@dataclass(slots=True, eq=False)
class RunResult:
    """What is known of a run's end, as far as it has come.

    Attributes:
        status: ``ok`` as long as nothing else ended it.
        reason: Why, where it is not ``ok``.
        detail: Several lines on what went wrong.
        counts: Messages of all sides.
        startup_s: Wall time until the first tick.
        wall_s: Wall time of the run itself.
    """

    status: str = "ok"
    reason: str | None = None
    detail: str = ""
    counts: MessageCounters = field(default_factory=MessageCounters)
    startup_s: float = 0.0
    wall_s: float = 0.0

    def end(self, status: str, reason: str) -> None:
        """It ended so, for this reason."""
        self.status, self.reason = status, reason

    def from_loop(self, ended: LoopResult, ledger: RunLog) -> None:
        """Tell what ended the run before its time, or that nobody was left at its end."""
        cells, period_ns = ledger.cells, ledger.period_ns
        if ended.failed:
            ledger.note(ended.losses)
            self.end("failed", failure(ended.failed, cells, period_ns))
            self.detail = ended.failed[0].detail
        elif ended.nobody:
            self.end("failed", nobody(ledger.found, cells, period_ns))
            self.detail = next((loss.detail for loss in ledger.found if loss.detail), "")
        elif ended.died:
            ledger.on_died(ledger.ticks, ended.died)
            cell = ledger.cells_lost[-len(ended.died)]
            self.end("failed", crash_aborts(cell, ledger.time_ns * 1e-9))
        elif ended.losses:
            ledger.on_lost(ended.losses)
            told = "; ".join(lines(ended.losses, cells, period_ns))
            self.end(ended.status, f"{told}; stall.policy is abort")
            self.detail = next((loss.detail for loss in ended.losses if loss.detail), "")


def summary_of(
    scene: Scene,
    plan: Plan,
    ending: RunResult,
    plant: Plant,
    ledger: RunLog,
    refused: RejectionMonitor,
    folder: Path,
    *,
    cautions: tuple[str, ...],
    protocol: ProtocolReport | None,
    resumed: tuple[int, ...],
) -> Summary:
    """The summary of a run.

    Args:
        scene: What ran.
        plan: What was started.
        ending: How it ended.
        plant: At the end.
        ledger: Of the run.
        refused: What it refused.
        folder: What it left is there.
        cautions: What was said before it began.
        protocol: What the protocol did, where that was asked for.
        resumed: Ticks before which it was taken up again.
    """
    counts = ending.counts
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
        reason=ending.reason,
        scene=scene.name,
        seed=scene.seed,
        duration_s=scene.duration_s,
        simulated_s=ledger.time_ns * 1e-9,
        cells=len(plant.array),
        firmware=firmware,
        processes=plan.workers,
        transport=plan.transport,
        solver=scene.solver.accuracy(),
        ticks=ledger.ticks,
        wall_s=ending.wall_s,
        startup_s=ending.startup_s,
        parcels=parcel_outcomes(plant),
        support_changes=plant.support_changes,
        **validity(plant, scene),
        messages=messages,
        refused=rows,
        faults=ledger.faults,
        cells_lost=ledger.cells_lost,
        feeders=plant.traffic(),
        cautions=cautions,
        effects=_of_effects(counts.cell_counters),
        protocol=protocol,
        digest=ledger.digest,
        resumed=resumed,
        output=str(folder),
    )


def _firmware(scene: Scene) -> dict[str, str | int]:
    """What the cells ran, for the summary."""
    from cell_firmware.loader import load

    firmware = load(scene.cells)
    size = 0 if firmware.message is None else firmware.message.itemsize
    return {"name": scene.cells.firmware.rpartition("/")[2], "form": firmware.form, "message_bytes": size}


def _protocol_messages(
    firmware: Mapping[str, str | int], tally: Mapping[str, int]
) -> ProtocolMessages | None:
    """Messages between cells, as the cells counted them; None for firmware without messages."""
    if not firmware["message_bytes"]:
        return None
    return ProtocolMessages(sent=tally.get("messages.sent", 0), heard=tally.get("messages.heard", 0))


def _of_effects(tally: Mapping[str, int]) -> dict[str, int]:
    """What effects counted; what cells count of their messages stands with the bus's."""
    return {name: number for name, number in sorted(tally.items()) if not name.startswith("messages.")}
