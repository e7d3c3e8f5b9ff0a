"""A run before anything of it is started: what is asked of it, looked up and checked."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

from deploy.cautions import cautions_of, cautions_of_registers
from deploy.errors import InputError
from deploy.faults.schedule import lasting
from deploy.output import run_name
from deploy.processes.plan import plan

if TYPE_CHECKING:
    from bus.fault import FaultSpec, Injected
    from bus.lattice import Lattice
    from deploy.checkpoints.checkpoint import Checkpoint
    from deploy.processes.plan import Plan, RunOptions
    from deploy.protocol_report.reporter import Reporter
    from deploy.recordings.replay import Recording
    from deploy.scene import Scene


@final
@dataclass(frozen=True, slots=True)
class Prepared:
    """What is to be run.

    Attributes:
        scene: What runs.
        options: How.
        plan: What will be started.
        resumed: From which it goes on; None: it begins.
        lasting: The scene's faults that begin and end on the way.
        live: Whether lines carry bytes: what keeps pace with a clock, or repeats what did, is what somebody watches,
            and has time for them.
        cautions: What is said before it begins.
        reporter: Watches the protocol, where that is asked for.
        replayed: The recording that it is to repeat, where there is one.
        script: What was done to the run that it repeats.
    """

    scene: Scene
    options: RunOptions
    plan: Plan
    resumed: Checkpoint | None
    lasting: tuple[Injected[FaultSpec], ...]
    live: bool
    cautions: tuple[str, ...]
    reporter: Reporter | None
    replayed: Recording | None
    script: Sequence[Mapping[str, Any]]


def prepared(scene: Scene, options: RunOptions, resumed: Checkpoint | None) -> Prepared:
    """Look up what a run needs besides its processes.

    Args:
        scene: What to run.
        options: How to run it.
        resumed: From which to go on.

    Raises:
        InputError: Bad input.
    """
    planned = plan(scene, options, run_name(scene, secrets.token_hex(4)))
    live = options.realtime is not None or options.replay is not None
    cautions = cautions_of(scene)
    if options.registers is not None:
        cautions += cautions_of_registers(scene)
    reporter = _reporter(scene, planned.partition.lattice, options.protocol_report)
    replayed, script = None, ()
    if options.replay is not None:
        from deploy.live.script import script_of
        from deploy.recordings.replay import load

        replayed = load(options.replay)
        if options.output is not None and options.output.resolve() == replayed.path.parent.resolve():
            raise InputError(
                f"--replay {options.replay}: would be overwritten by --output {options.output}: name another folder"
            )
        script = script_of(replayed, scene)
    return Prepared(
        scene,
        options,
        planned,
        resumed,
        lasting(scene),
        live if resumed is None else resumed.options["live"],
        cautions,
        reporter,
        replayed,
        script,
    )


def _reporter(scene: Scene, lattice: Lattice, every: int | None) -> Reporter | None:
    if every is None:
        return None
    from deploy.protocol_report.reporter import Reporter

    return Reporter(scene, lattice, every)
