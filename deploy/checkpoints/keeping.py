"""What a run does that keeps checkpoints, or goes on from one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from bus.errors import MemoryRefusedError
from deploy.checkpoints.store import Store
from deploy.errors import InputError
from deploy.recordings.format import EVENTS

if TYPE_CHECKING:
    from bus.lockstep import Host
    from deploy.checkpoints.checkpoint import Checkpoint
    from deploy.checkpoints.keeper import About, Keeper
    from deploy.ledger import Ledger
    from deploy.processes.plan import Plan, RunOptions
    from deploy.protocol_report.reporter import Reporter
    from deploy.recordings.recorder import Recorder
    from deploy.scene import Scene
    from plant.plant import Plant
    from plant.process import PlantProcess


def about_run(
    scene: Scene, plan: Plan, options: RunOptions, plant: Plant, resumed: Checkpoint | None, *, live: bool
) -> About | None:
    """What all checkpoints of a run have in common; None where there are to be none.

    Args:
        scene: What runs.
        plan: What is started.
        options: How it runs.
        plant: Of the scene, at its start.
        resumed: From which it goes on; None: it begins.
        live: Whether faults may come while it runs.

    Raises:
        InputError: The run can't be kept, or can't go on from the one that it is to go on from.
    """
    if options.checkpoint_s is None:
        return None
    from bus.memory import remember
    from deploy.checkpoints.keeper import About
    from deploy.checkpoints.resume import bound, check, told

    try:
        remember(plant)
    except MemoryRefusedError as error:
        raise InputError(f"--checkpoint: this plant can't be kept: {error}") from None
    about = About(
        scene_name=scene.name,
        scene=scene.model_dump(mode="json"),
        bound=bound(scene),
        options=told(plan, options, live=live),
    )
    if resumed is None:
        return about
    check(resumed, about.bound)
    return replace(about, resumed=(*resumed.resumed, resumed.tick), wall_s=resumed.wall_s)


def keeper_of(
    about: About | None,
    options: RunOptions,
    host: Host,
    ledger: Ledger,
    recorder: Recorder,
    reporter: Reporter | None,
    resumed: Checkpoint | None,
    patience_s: float,
) -> Keeper | None:
    """What takes a run's checkpoints; None where there are to be none.

    Args:
        about: Of the run.
        options: How it runs.
        host: The plant's side of the lockstep.
        ledger: Of the run.
        recorder: In whose folder they are left.
        reporter: What watches the protocol, where that is asked for.
        resumed: From which it goes on; it stays until there is a newer one.
        patience_s: Wall seconds that the cells have to tell what they remember.
    """
    if about is None or options.checkpoint_s is None:
        return None
    from deploy.checkpoints.keeper import Keeper

    store = Store(recorder.path.parent)
    if resumed is not None:
        store.keep(resumed)
    return Keeper(
        options.checkpoint_s,
        host,
        ledger,
        recorder,
        reporter,
        store,
        about,
        patience_s=patience_s,
        warn=ledger.warn,
    )


def go_on(resumed: Checkpoint, process: PlantProcess, ledger: Ledger, reporter: Reporter | None) -> None:
    """Let all of the plant's process be as it was."""
    from bus.memory import recall

    recall(process, resumed.process)
    recall(ledger, resumed.ledger)
    ledger.show(resumed.recorded.get(EVENTS, 0))
    if reporter is not None and resumed.reporter is not None:
        recall(reporter, resumed.reporter)
