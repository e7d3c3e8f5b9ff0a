"""Values of all cells over time, by which plots colour them: the wheels' speed, or a register."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Protocol, final

import numpy as np
from numpy.typing import NDArray

from deploy.errors import InputError
from deploy.plots.spacetime import chosen_register

if TYPE_CHECKING:
    from deploy.recordings.recording import Recording

Floats = NDArray[np.float64]


class CellValues(Protocol):
    """Values of all cells at the instants of a recording.

    Attributes:
        label: Name and unit.
    """

    label: str

    def at(self, row: int) -> Floats:
        """Return the values at an instant, ``(n,)``; NaN where a cell has none."""
        ...

    def limits(self, rows: NDArray[np.int64]) -> tuple[float, float]:
        """Return the least and the greatest value at these instants, apart."""
        ...


def fastest_m_s(speeds: Iterable[Floats]) -> float:
    """Return the greatest finite speed of any cell; 0 if there is none.

    Args:
        speeds: ``(n, 2)`` m/s, at one instant after another.
    """
    fastest = 0.0
    for one in speeds:
        size = np.hypot(one[:, 0], one[:, 1])
        fastest = max(fastest, float(size[np.isfinite(size)].max(initial=0.0)))
    return fastest


@final
class WheelSpeedValues:
    """Magnitude of the wheels' velocity at each cell, m/s."""

    label = "wheel speed (m/s)"

    def __init__(self, recording: Recording) -> None:
        self._held = recording.held_wheel_speeds

    def at(self, row: int) -> Floats:
        """Return the values at an instant; see ``CellValues``."""
        velocity = self._held.at(row)
        return np.hypot(velocity[:, 0], velocity[:, 1])

    def limits(self, rows: NDArray[np.int64]) -> tuple[float, float]:
        """Return 0 and the greatest value; see ``CellValues``."""
        return 0.0, fastest_m_s(self._held.each(rows)) or 1.0


@final
class RegisterValues:
    """A register at each cell: a number, the magnitude of a pair, or the first component.

    Args:
        recording: Of a run with ``--registers``.
        register: Name of the register; None: one of the program's.

    Raises:
        InputError: The recording has no registers, or no such register.
    """

    def __init__(self, recording: Recording, register: str | None) -> None:
        name = chosen_register(recording, register)
        values = recording.registers[name].astype(np.float64)
        values = values.reshape(*values.shape[:2], -1)
        parts = values.shape[2]
        self.label = name if parts == 1 else f"|{name}|" if parts == 2 else f"{name}[0]"
        self._values = np.hypot(values[..., 0], values[..., 1]) if parts == 2 else values[..., 0]
        if not len(self._values):
            raise InputError(f"{recording.path}: has no registers; record them with mdms run --registers")
        shown = np.searchsorted(recording.register_tick, recording.tick, side="right") - 1
        self._row = np.maximum(shown, 0)

    def at(self, row: int) -> Floats:
        """Return the values recorded last before an instant; see ``CellValues``."""
        return self._values[self._row[row]]

    def limits(self, rows: NDArray[np.int64]) -> tuple[float, float]:
        """Return the least and the greatest value; see ``CellValues``."""
        seen = self._values[np.unique(self._row[rows])]
        seen = seen[np.isfinite(seen)]
        low, high = float(seen.min(initial=np.inf)), float(seen.max(initial=-np.inf))
        return (low, high) if low < high else (min(low, 0.0), max(high, 1.0)) if low == high else (0.0, 1.0)
