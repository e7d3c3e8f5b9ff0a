"""Updates of the speed loop by the HC11's program and by ``FixedPointLoop``, from the same numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cell_firmware.build import MotorFacts, wheels_of
from cell_firmware.effects.registry import CellEffects
from cell_firmware.specs import CellsSpec
from cell_firmware.speed_loop.fixed_point import FixedPointLoop, whole_levels
from cell_firmware.speed_loop.sensing import FRACTION_BITS
from tests.cell_firmware.speed_loop.hc11 import run
from tests.cell_firmware.speed_loop.hc11_loop import LoopProgram

Ints = NDArray[np.int64]
EFFECTS = {"encoder": {"counts_per_revolution": 1920}, "pwm": {"levels": 2000}, "fixed_point": {}}


class Compared(NamedTuple):
    """m updates: integrals and duties ``(m, 2)`` of both, cycles ``(m,)``, how many wheels saturated ``(m,)``."""

    integral: Ints
    duty: Ints
    expected_integral: Ints
    expected_duty: Ints
    cycles: Ints
    saturated: Ints


def one_by_one(table: Ints, memory: Ints) -> Ints:
    """Cycles of each update."""
    rows = table.tolist()
    return np.array([run(_Rows(rows), page) for page in memory])  # pyright: ignore[reportArgumentType]


class _Rows:
    """A table whose numbers are Python's own: faster to interpret."""

    def __init__(self, rows: list[list[int]]) -> None:
        self._rows = rows

    def __getitem__(self, at: tuple[int, int]) -> int:
        return self._rows[at[0]][at[1]]


def compared(
    updates: int, *, near: bool, seed: int, each: Callable[[Any, Any], Ints] = one_by_one
) -> Compared:
    """Updates from random numbers.

    Args:
        updates: How many.
        near: Draw counts within two of the reference, as in a closed loop; else all from their whole range.
        seed: Of the draws.
        each: Runs a program's table on page zeros ``(m, 256)``.
    """
    loop = wheels_of(CellsSpec(), CellEffects.model_validate(EFFECTS), MotorFacts(12.0, 1.2))
    assert isinstance(loop, FixedPointLoop)
    limit, chance = loop.scaling.output_limit, np.random.default_rng(seed)
    shape = (updates, 2)
    if near:
        integral = chance.integers(-limit // 2, limit // 2, shape)
        reference = chance.integers(-1200, 1201, shape)
        difference = np.clip((reference >> FRACTION_BITS) + chance.integers(-2, 3, shape), -128, 127)
    else:
        integral = chance.integers(-limit, limit + 1, shape)
        reference = chance.integers(-loop.scaling.reference_limit, loop.scaling.reference_limit + 1, shape)
        difference = chance.integers(-128, 128, shape)
    last = chance.integers(0, 256, shape)
    after, output = loop.act(
        integral.astype(np.int32), reference.astype(np.int32), (difference << FRACTION_BITS).astype(np.int32)
    )
    program, memory = LoopProgram(loop.scaling), np.zeros((updates, 256), dtype=np.int64)
    for name, value in (
        ("integral", integral),
        ("reference", reference),
        ("last", last),
        ("count", (last + difference) % 256),
    ):
        program.put(memory, name, value)
    cycles = each(program.table, memory)
    saturated = (np.abs(output) == limit).sum(axis=1)
    return Compared(
        program.get(memory, "integral"),
        program.get(memory, "duty"),
        after.astype(np.int64),
        whole_levels(output).astype(np.int64),
        cycles,
        saturated,
    )
