"""A protocol's report from a recording that has its registers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import ValidationError

from bus.lockstep.registers import RegisterSnapshot
from deploy.errors import InputError
from deploy.protocol_report.reporter import Reporter, deaths_of
from deploy.scenes.scene import Scene

if TYPE_CHECKING:
    from deploy.protocol_report.report import ProtocolReport
    from deploy.recordings.recording import Recording


def report_from_recording(run: Recording) -> tuple[Reporter, ProtocolReport]:
    """Build the protocol report of a recorded run, without message statistics.

    Raises:
        InputError: The recording has no registers of the protocol's field, or this version can't read its scene.
    """
    try:
        scene = Scene.model_validate(run.header["scene"]).named(run.header["scene_name"])
    except ValidationError as error:
        raise InputError(f"{run.path}: this version can't read the scene of the run: {error}") from None
    every = int(np.diff(run.register_tick).min()) if len(run.register_tick) > 1 else 1
    reporter = Reporter(scene, scene.lattice(), every)
    dead = deaths_of(run.faults)
    if reporter.wanted and reporter.register not in run.registers:
        raise InputError(
            f"{run.path} has no registers of {reporter.observed}: record them with mdms run --registers"
        )
    until = np.array([dead.get(cell, np.iinfo(np.int64).max) for cell in scene.lattice().cells])
    if reporter.wanted:
        for row, tick in enumerate(run.register_tick.tolist()):
            registers = {name: array[row] for name, array in run.registers.items()}
            reporter.take(RegisterSnapshot(tick, until > tick, registers))
    else:
        for row, tick in enumerate(run.tick[:-1].tolist()):
            reporter.take_drive(tick, run.held_drives.at(row), until > tick)
    return reporter, reporter.report(int(run.tick[-1]) if len(run.tick) else 0, dead, None)
