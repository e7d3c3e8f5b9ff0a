"""Periodic checkpoints of a run in progress."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from bus.errors import StateError
from bus.state import save_state
from deploy.checkpoints.checkpoint import Checkpoint
from deploy.checkpoints.store import CheckpointStore
from deploy.errors import DeployError, InputError
from deploy.recordings.format import EVENTS

if TYPE_CHECKING:
    from bus.lockstep.coordinator import Coordinator
    from bus.lockstep.snapshots import GlobalSnapshot
    from deploy.protocol_report.reporter import Reporter
    from deploy.recordings.run_log import RunLog
    from deploy.recordings.writer import Recorder
    from deploy.scenes.scene import Scene
    from deploy.workers.plan import Plan, RunOptions
    from plant.plant import Plant
    from plant.process import PlantProcess


PATIENCE_S: Final = 5.0
"""Least wall time that cells get to send their snapshots."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CheckpointMetadata:
    """Fields that all checkpoints of a run share; see ``Checkpoint``.

    Attributes:
        wall_s: Wall time of the ticks that were complete when this process resumed the run, s.
    """

    scene_name: str
    scene: dict[str, Any]
    bound: dict[str, str]
    options: dict[str, Any]
    resumed: tuple[int, ...] = ()
    wall_s: float = 0.0


@final
@dataclass(slots=True)
class _Pending:
    """A checkpoint in progress.

    Attributes:
        tick: Tick before which the state is saved.
        requested_at: Time at which snapshots were requested, monotonic wall seconds.
        plant: State of the plant's side, by field of ``Checkpoint``; None until ``tick`` is next.
        mark: Position in the recording that must be on disk before the checkpoint.
    """

    tick: int
    requested_at: float
    plant: Mapping[str, Any] | None = None
    mark: int = 0


@final
class Checkpointer:
    """Checkpoints of a run, one every ``every_s`` of wall time.

    Each checkpoint starts early by the time that the previous one took to write. At most ``every_s`` of work is then
    lost when the process is killed.

    Snapshots of the shards are requested one tick ahead, and sent once the messages that were under way have been
    read. The plant goes on meanwhile, except while its own state is copied. A thread writes the file. One checkpoint is
    in progress at a time; a checkpoint that can't be finished is abandoned, and the run goes on.

    Args:
        every_s: Wall time between two checkpoints, s.
        host: Coordinator of the lockstep, which requests snapshots.
        run_log: Log of the run.
        recorder: Recorder of the run.
        reporter: Reporter of the protocol; None without a protocol report.
        store: Checkpoint files.
        about: Fields that all checkpoints share.
        patience_s: Wall time that shards get to send their snapshots, s; at least ``PATIENCE_S``.
        warn: Called with one line for every abandoned checkpoint.
        clock: Returns monotonic wall seconds.

    Attributes:
        written: Ticks before which a checkpoint was written.
    """

    def __init__(
        self,
        every_s: float,
        host: Coordinator,
        run_log: RunLog,
        recorder: Recorder,
        reporter: Reporter | None,
        store: CheckpointStore,
        about: CheckpointMetadata,
        *,
        patience_s: float,
        warn: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._every_s, self._patience_s = every_s, max(patience_s, PATIENCE_S)
        self._host, self._run_log, self._recorder, self._reporter = host, run_log, recorder, reporter
        self._store, self._about, self._warn, self._clock = store, about, warn, clock
        self._begun = clock()
        self._last = self._begun
        self._took_s = 0.0
        self._draft: _Pending | None = None
        self._writer: threading.Thread | None = None
        self._trouble: str | None = None
        self.written: list[int] = []

    def before_tick(self, process: PlantProcess) -> None:
        """Request snapshots when a checkpoint is due, and save the plant's side one tick later."""
        draft = self._draft
        if draft is None:
            due = self._last + self._every_s - self._took_s
            if self._clock() >= due and self._writer is None:
                self._last = self._clock()
                self._host.request_snapshot(process.tick + 1)
                self._draft = _Pending(process.tick + 1, self._last)
        elif draft.plant is None:
            process.catch_up()
            process.report()
            self._host.record_snapshot()
            if self._run_log.disturbed:
                self._stop(
                    "faults were injected at run time, and a checkpoint doesn't hold them; to repeat the run, use "
                    "mdms run --replay DIR"
                )
                return
            draft.plant, draft.mark = self._plant(process)

    def _plant(self, process: PlantProcess) -> tuple[dict[str, Any], int]:
        """Save the plant's side; return its fields and the position in the recording."""
        recorded, mark = self._recorder.position()
        return {
            "tick": process.tick,
            "time_ns": process.time_ns,
            "process": save_state(process),
            "run_log": save_state(self._run_log),
            "reporter": None if self._reporter is None else save_state(self._reporter),
            "recorded": recorded,
            "dead": tuple(np.flatnonzero(process.lost).tolist()),
            "wall_s": self._about.wall_s + self._clock() - self._begun,
        }, mark

    def poll(self) -> None:
        """Write the checkpoint once all shards have answered; call once a tick."""
        if self._writer is not None and not self._writer.is_alive():
            self._finish()
        draft = self._draft
        if draft is None or draft.plant is None:
            return
        together = self._host.poll_snapshot()
        if together is not None:
            self._draft = None
            self._write(draft.plant, together, draft)
        elif self._clock() > draft.requested_at + self._patience_s:
            self._draft = None
            shards = ", ".join(map(str, self._host.cancel_snapshot()))
            self._warn(
                f"no checkpoint before tick {draft.tick}: shard {shards} sent no snapshot within "
                f"{self._patience_s:g} s"
            )

    def _stop(self, why: str) -> None:
        """Take no more checkpoints."""
        self._host.cancel_snapshot()
        self._draft, self._last = None, float("inf")
        self._warn(f"no more checkpoints: {why}")

    def close(self) -> None:
        """Wait for the checkpoint that is being written."""
        if self._writer is not None:
            self._writer.join()
            self._finish()

    def _finish(self) -> None:
        self._writer = None
        if self._trouble is not None:
            self._warn(f"no checkpoint: {self._trouble}")
            self._trouble = None

    def _write(self, plant: Mapping[str, Any], together: GlobalSnapshot, draft: _Pending) -> None:
        about, counts = self._about, together.counts
        checkpoint = Checkpoint(
            scene_name=about.scene_name,
            scene=about.scene,
            bound=about.bound,
            options=about.options,
            resumed=about.resumed,
            states=together.states,
            links=together.links,
            relayed=together.relayed,
            counts=(counts.sent, counts.delivered, counts.lost, counts.late),
            refused=dict(counts.refused),
            counters=dict(counts.cell_counters),
            **plant,
        )
        self._writer = threading.Thread(
            target=self._put, args=(checkpoint, draft), name="checkpoint", daemon=True
        )
        self._writer.start()

    def _put(self, checkpoint: Checkpoint, draft: _Pending) -> None:
        """Sync the recording up to the mark, then write the checkpoint; runs in a thread."""
        try:
            self._recorder.sync_to(draft.mark)
            self._store.write(checkpoint.to_bytes())
            self.written.append(checkpoint.tick)
            self._took_s = self._clock() - draft.requested_at
        except (DeployError, OSError, ValueError) as error:  # ValueError: the recording has been closed
            self._trouble = str(error)


def checkpoint_metadata(
    scene: Scene, plan: Plan, options: RunOptions, plant: Plant, resumed: Checkpoint | None, *, live: bool
) -> CheckpointMetadata | None:
    """Return the fields that all checkpoints of a run share; None without checkpoints.

    Args:
        scene: Scene of the run.
        plan: Plan of the run.
        options: Options of the run.
        plant: Plant of the scene, at its start.
        resumed: Checkpoint to resume from; None: the run starts at tick 0.
        live: Whether serial lines are byte-accurate, so that faults can be injected at run time.

    Raises:
        InputError: The plant's state can't be saved, or the run can't resume from ``resumed``.
    """
    if options.checkpoint_s is None:
        return None
    from bus.state import save_state
    from deploy.checkpoints.store import check, options_record
    from deploy.scenes.fingerprint import fingerprint

    try:
        save_state(plant)
    except StateError as error:
        raise InputError(f"--checkpoint: the plant's state can't be saved: {error}") from None
    about = CheckpointMetadata(
        scene_name=scene.name,
        scene=scene.model_dump(mode="json"),
        bound=fingerprint(scene),
        options=options_record(plan, options, live=live),
    )
    if resumed is None:
        return about
    check(resumed, about.bound)
    return replace(about, resumed=(*resumed.resumed, resumed.tick), wall_s=resumed.wall_s)


def make_checkpointer(
    about: CheckpointMetadata | None,
    options: RunOptions,
    host: Coordinator,
    run_log: RunLog,
    recorder: Recorder,
    reporter: Reporter | None,
    resumed: Checkpoint | None,
    patience_s: float,
) -> Checkpointer | None:
    """Create the checkpointer of a run; None without checkpoints.

    Args:
        about: Fields that all checkpoints share; None without checkpoints.
        options: Options of the run.
        host: Coordinator of the lockstep.
        run_log: Log of the run.
        recorder: Recorder of the run, into whose folder checkpoints are written.
        reporter: Reporter of the protocol; None without a protocol report.
        resumed: Checkpoint to resume from, retained until a newer one is written.
        patience_s: Wall time that shards get to send their snapshots, s.
    """
    if about is None or options.checkpoint_s is None:
        return None

    store = CheckpointStore(recorder.path.parent)
    if resumed is not None:
        store.keep(resumed)
    return Checkpointer(
        options.checkpoint_s,
        host,
        run_log,
        recorder,
        reporter,
        store,
        about,
        patience_s=patience_s,
        warn=run_log.warn,
    )


def restore_run(
    resumed: Checkpoint, process: PlantProcess, run_log: RunLog, reporter: Reporter | None
) -> None:
    """Restore the plant's process, the log and the reporter from a checkpoint."""
    from bus.state import load_state

    load_state(process, resumed.process)
    load_state(run_log, resumed.run_log)
    run_log.show(resumed.recorded.get(EVENTS, 0))
    if reporter is not None and resumed.reporter is not None:
        load_state(reporter, resumed.reporter)
