"""One step of a cell's program again: the recorded run is repeated in this process up to it."""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from cell_firmware.cell import PerCellAdapter, cell_inputs
from cell_firmware.scalar_program import PYTHON
from cell_firmware.stepping import NOW
from deploy.control.replay import FOUND, REPLAYED
from deploy.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from deploy.recordings.recording import Recording
    from deploy.scenes.scene import Scene


@final
@dataclass(frozen=True, slots=True)
class HeldStep:
    """A step of a cell's program.

    Attributes:
        step: The program's own ``step``.
        state: State before the step: any object in plain Python, arrays of one row otherwise.
        inputs: Inputs of the step.
    """

    step: Callable[..., Any]
    state: Any
    inputs: Any


def held_step(recording: Recording, cell: tuple[int, int], tick: int) -> HeldStep:
    """Repeat a recorded run up to a tick, and return the step of a cell in it.

    The drives of every tick before it are compared with the recorded ones, so that the step is the recorded one.

    Args:
        recording: The recording.
        cell: Row and column of the cell.
        tick: The tick.

    Raises:
        InputError: The recording has no such cell or tick, or the run can't be repeated.
    """
    _check(recording, cell, tick)
    scene = _scene(recording)
    window = tick - 1 if scene.effects.clock is not None else tick
    found: list[HeldStep] = []

    def observe(now: int, row: Any, column: Any, firmware: Any, state: Any, inputs: Any) -> None:
        if now != window or found:
            return
        for i in np.flatnonzero((row == cell[0]) & (column == cell[1])).tolist():
            rows = np.array([i])
            one = {name: copy.deepcopy(array[rows]) for name, array in state.items()}
            if isinstance(firmware, PerCellAdapter):
                given = cell_inputs(inputs, i)
                found.append(HeldStep(firmware.firmware.step, one["cell"][0], copy.deepcopy(given)))
            else:
                found.append(HeldStep(firmware.step, one, copy.deepcopy(inputs.select(rows))))

    with _observing(observe):
        _repeat(recording, scene, tick)
    if not found:
        raise InputError(
            f"cell {cell[0]},{cell[1]} has no step in tick {tick}: it is dead, its clock has no instant there, or its "
            "program is compiled, and there is no Python to step"
        )
    return found[0]


def _check(recording: Recording, cell: tuple[int, int], tick: int) -> None:
    if list(cell) not in [list(one) for one in recording.header["cells"]]:
        raise InputError(f"--cell {cell[0]},{cell[1]}: the recording has no such cell")
    last = int(recording.tick[-1]) - recording.complete if len(recording.tick) else -1
    if not 0 <= tick <= last + (recording.status == "failed"):
        raise InputError(f"--tick {tick}: the recording has ticks 0 to {last}")
    kinds = {record["kind"] for record in recording.control if record["kind"] in REPLAYED}
    kinds |= {record["kind"] for record in recording.faults if record["kind"] in FOUND}
    if kinds:
        raise InputError(
            f"{recording.path}: {', '.join(sorted(kinds))} came while the run went on, and a step can't repeat that; "
            "record it once more by `mdms run --replay`, with a breakpoint() in the program"
        )


def _scene(recording: Recording) -> Scene:
    from pydantic import ValidationError

    from deploy.scenes.errors import problems_of
    from deploy.scenes.scene import Scene

    try:
        return Scene.model_validate_json(json.dumps(recording.header["scene"])).named(
            recording.header["scene_name"]
        )
    except ValidationError as error:
        why = "; ".join(map(str, problems_of(error, recording.header["scene"], Scene)))
        raise InputError(f"{recording.path}: its scene can't be run: {why}") from None


def _repeat(recording: Recording, scene: Scene, tick: int) -> None:
    """Run the scene through ``tick``, and compare the drives with the recorded ones.

    Raises:
        InputError: The drives differ.
    """
    from deploy.runs.simulation import Simulation

    with Simulation.open(scene) as simulation:
        for k in range(tick + 1):
            record = simulation.step(warns=False)
            if record is None:
                return  # a program failed: the tick has no drives
            if k < len(recording.tick) and not np.array_equal(record.drives, recording.held_drives.at(k)):
                raise InputError(_changed(recording, k, record.drives))


def _changed(recording: Recording, tick: int, drives: NDArray[np.float64]) -> str:
    """Return the first drive of a tick that is not the recorded one, in words."""
    then = recording.held_drives.at(tick)
    row = int(np.flatnonzero((drives != then).any(axis=1))[0])
    where = ",".join(map(str, recording.header["cells"][row]))
    return (
        f"{recording.path}: tick {tick}, cell {where}: the drive is {drives[row].tolist()} now, and was "
        f"{then[row].tolist()}: the program or a library has changed since"
    )


@contextmanager
def _observing(observe: Callable[..., None]) -> Generator[None]:
    """Have steps observed, and programs in scalar form run as Python."""
    before = os.environ.get(PYTHON)
    os.environ[PYTHON] = "1"
    NOW.observe = observe
    try:
        yield
    finally:
        NOW.observe = None
        if before is None:
            del os.environ[PYTHON]
        else:
            os.environ[PYTHON] = before
