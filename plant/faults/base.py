"""Base classes of faults in the plant, and the state of faulty wheels."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, Self, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import CellTarget, FaultSpec, Problem
from plant.wheels import Floats, LossPolicy

if TYPE_CHECKING:
    from plant.effects.motors import MotorsSpec
    from plant.effects.registry import PlantEffects


Bools = NDArray[np.bool_]


@final
@dataclass(slots=True)
class WheelFaults:
    """Combined effect of active faults on the plant, from one tick on; each active fault adds its own.

    Attributes:
        dead: Whether the cell's wheels get no drive, ``(n,)``. Wheels of dead cells follow ``wheel_policies``, else the
            stall policy.
        gone: Whether the cell's module is removed from the array, ``(n,)``.
        stuck: Whether the wheel is jammed, ``(n, 2)``.
        factor: Factor on drives, ``(n, 2)``.
        most_m_s: Largest speed that a drive commands in either direction, ``(n, 2)``, m/s; infinite: no limit.
        runs_m_s: Speed that replaces the drive, ``(n, 2)``, m/s; infinite for the full supply, NaN where drives are
            followed.
        wheel_policies: Policies of dead cells' wheels that differ from the stall policy, by cell.
    """

    dead: Bools
    gone: Bools
    stuck: Bools
    factor: Floats
    most_m_s: Floats
    runs_m_s: Floats
    wheel_policies: dict[int, LossPolicy] = field(default_factory=dict[int, LossPolicy])

    @staticmethod
    def healthy(cells: int) -> WheelFaults:
        """Return the state without faults."""
        return WheelFaults(
            dead=np.zeros(cells, dtype=np.bool_),
            gone=np.zeros(cells, dtype=np.bool_),
            stuck=np.zeros((cells, 2), dtype=np.bool_),
            factor=np.ones((cells, 2)),
            most_m_s=np.full((cells, 2), np.inf),
            runs_m_s=np.full((cells, 2), np.nan),
        )


class PlantFault(FaultSpec):
    """A fault of what lives in the plant."""

    def setting_problems(self, effects: PlantEffects) -> Iterator[Problem]:  # noqa: ARG002
        """Yield the fault's settings that are incompatible with a scene's effects."""
        yield from ()

    def on_ideal_wheels(self, motors: MotorsSpec) -> Self:  # noqa: ARG002
        """Return the equivalent fault for the scene without motors, whose wheels run at the commanded speed."""
        return self

    @abstractmethod
    def apply(self, cells: NDArray[np.int64], wheel_faults: WheelFaults) -> None:
        """Add the effect of this fault, while it is active, to the combined fault state.

        Args:
            cells: Indices of affected cells.
            wheel_faults: Fault state, changed in place.
        """


class WheelFault(CellTarget, PlantFault):
    """A fault of wheels of cells."""

    wheel: Literal["x", "y", "both"] = "both"
    """Affected wheel of each cell: the wheel that moves parcels along x, the wheel along y, or both."""

    def wheels(self, cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], slice]:
        """Rows and columns of the affected wheels, in an array ``(n, 2)`` of all wheels."""
        return cells, {"x": slice(0, 1), "y": slice(1, 2), "both": slice(0, 2)}[self.wheel]
