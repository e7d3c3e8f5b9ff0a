"""Quantities that colour cells: one entry each, evaluated at an instant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from deploy.faults.fault_state import ALIVE

if TYPE_CHECKING:
    from deploy.view.source import Floats, Instant, RunSource

REGISTER: Final = "register:"
"""Prefix of the quantities that are registers; ``register:NAME`` or ``register:NAME[i]``."""


@final
@dataclass(frozen=True, slots=True)
class Values:
    """Values of a quantity.

    Attributes:
        numbers: ``(n,)``; NaN: no value. Of categories their index.
        categories: Names of the categories; empty for numbers.
    """

    numbers: Floats
    categories: Sequence[str] = ()


@final
@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity of every cell.

    Attributes:
        name: Identifier.
        label: Name for people.
        unit: Unit; empty: a number or a category.
        values: Evaluates the quantity at an instant, given with its index.
    """

    name: str
    label: str
    unit: str
    values: Callable[[RunSource, int, Instant], Values]


def _speed(source: RunSource, index: int, instant: Instant) -> Values:
    del source, index
    return Values(np.hypot(instant.wheel_speeds[:, 0], instant.wheel_speeds[:, 1]).astype(np.float64))


def _sensor(source: RunSource, index: int, instant: Instant) -> Values:
    del source, index
    sensors = instant.presence.shape[1]
    count = instant.presence.sum(axis=1).astype(np.float64)
    names = ("clear", "covered") if sensors == 1 else tuple(f"{k} of {sensors}" for k in range(sensors + 1))
    return Values(count, names)


def _health(source: RunSource, index: int, instant: Instant) -> Values:
    del source, index
    return Values(instant.health.astype(np.float64), ("alive", "faulty", "dead or lost"))


def _fault(source: RunSource, index: int, instant: Instant) -> Values:
    del index
    numbers = np.zeros(len(instant.health))
    names: list[str] = ["none"]
    for kind, cells in source.fault_state.active(instant.time_s).values():
        if kind not in names:
            names.append(kind)
        numbers[cells] = names.index(kind)
    unexplained = (instant.health != ALIVE) & (numbers == 0)
    if unexplained.any():
        names.append("dead or lost")
        numbers[unexplained] = len(names) - 1
    return Values(numbers, tuple(names))


QUANTITIES: Final = (
    Quantity("speed", "wheel speed", "m/s", _speed),
    Quantity("sensor", "sensor", "", _sensor),
    Quantity("health", "health", "", _health),
    Quantity("fault", "fault", "", _fault),
)


def register_quantity(name: str) -> Quantity:
    """Return the quantity of a register, ``NAME`` or ``NAME[i]`` for one of several numbers."""
    register, _, part = name.partition("[")
    column = int(part.rstrip("]")) if part else None

    def values(source: RunSource, index: int, instant: Instant) -> Values:
        _, found = source.registers(index)
        return Values(_column(found.get(register), column, len(instant.health)))

    return Quantity(REGISTER + name, name, "", values)


def _column(values: NDArray[Any] | None, column: int | None, cells: int) -> Floats:
    """Return a number for each cell: a column, or of several numbers the length of the vector."""
    if values is None:
        return np.full(cells, np.nan)
    rows = values.reshape(cells, -1).astype(np.float64)
    if column is not None:
        return rows[:, column] if column < rows.shape[1] else np.full(cells, np.nan)
    return rows[:, 0] if rows.shape[1] == 1 else np.sqrt((rows**2).sum(axis=1))


def quantity_of(name: str, known: Sequence[Quantity]) -> Quantity:
    """Return a quantity by its identifier; the first known one if there is none of that name."""
    if name.startswith(REGISTER):
        return register_quantity(name.removeprefix(REGISTER))
    return next((one for one in known if one.name == name), known[0])
