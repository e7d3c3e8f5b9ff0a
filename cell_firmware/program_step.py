"""Result of a program's step, and the search for the cells that fail where the step of many failed in one call."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from cell_firmware.errors import FirmwareFailed, NeverReturned
from cell_firmware.firmware import Bools, Cells, Floats, Inputs, Outbox, State


@final
@dataclass(frozen=True, slots=True)
class ProgramStep:
    """Validated result of a program's step.

    Attributes:
        state: The program's.
        speed_m_s: ``(n, 2)``, finite.
        outbox: Messages of the program; None if there are none at all.
        failures: Failures by index of the cell.
        served: ``(n,)``, whether the program served its watchdog; None: all did.
    """

    state: State
    speed_m_s: Floats
    outbox: Outbox | None
    failures: dict[int, FirmwareFailed]
    served: Bools | None = None


def step_one_by_one(
    step: Callable[[int, Cells, State, Inputs], ProgramStep],
    message: np.dtype[Any] | None,
    tick: int,
    cells: Cells,
    before: State,
    inputs: Inputs,
    together: ProgramStep,
    *,
    hung: bool,
) -> ProgramStep:
    """Step every cell alone, to find the cells that fail.

    The deadline of the tick ends the search, unless it was the deadline by which all cells failed together.

    Args:
        step: Steps the program of some cells in one call.
        message: Type of the program's messages.
        tick: Of the failures.
        cells: The cells.
        before: Their programs' state.
        inputs: Their inputs.
        together: Result of all cells at once, in which each failed with the error of the call.
        hung: Whether the call was interrupted at the deadline.

    Returns:
        The step, with the cells' own failures. Where the search ends early, or no cell fails alone, none can be
        trusted: all others fail as together.
    """
    n = len(cells)
    states: list[State] = []
    speed = np.zeros((n, 2))
    outbox = None if message is None else Outbox.empty(n, message)
    failures: dict[int, FirmwareFailed] = {}
    served = np.ones(n, dtype=np.bool_)
    try:
        for i in range(n):
            row = np.array([i])
            alone = {name: array[row] for name, array in before.items()}
            done = step(tick, cells.select(row), alone, inputs.select(row))
            if done.failures and not hung and _was_interrupted(done.failures[0]):
                break
            states.append(done.state)
            speed[i] = done.speed_m_s[0]
            if outbox is not None and done.outbox is not None:
                outbox.sent[i] = done.outbox.sent[0]
                outbox.message[i] = done.outbox.message[0]
            if done.failures:
                failures[i] = done.failures[0]
            if done.served is not None:
                served[i] = done.served[0]
    except NeverReturned:  # between the steps of two cells
        if hung:
            raise
    if not failures or len(states) < n:
        return replace(
            together, failures={i: _of_all(one, n) for i, one in together.failures.items()} | failures
        )
    joined = {name: np.concatenate([state[name] for state in states]) for name in before}
    return ProgramStep(joined, speed, outbox, failures, served)


def _of_all(failure: FirmwareFailed, n: int) -> FirmwareFailed:
    problem = f"{failure.problem} (all {n} cells at once)"
    return FirmwareFailed(failure.cell, failure.tick, problem, failure.trace)


def _was_interrupted(failure: FirmwareFailed) -> bool:
    return failure.problem.partition(":")[0].endswith(NeverReturned.__name__)
