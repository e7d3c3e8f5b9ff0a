"""What faults of the plant's parts are made of."""

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
    """What faults do to the plant's parts from one tick on; each fault adds its own.

    Attributes:
        dead: ``(n,)``: do the cell's wheels get no drive any more? They do what ``rests`` or the stall policy says.
        gone: ``(n,)``: is the cell not in the array?
        stuck: ``(n, 2)``: is the wheel jammed?
        factor: ``(n, 2)``: times which drives act.
        most_m_s: ``(n, 2)``: the speed that a drive asks for at most, either way; infinite: no limit.
        runs_m_s: ``(n, 2)``: the speed that takes the drive's place, infinite for all that the supply gives; NaN where
            drives are heeded.
        rests: What the wheels of dead cells do, where it isn't what the stall policy says.
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
        """All is well."""
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
        """What of it does not go with a scene's effects."""
        yield from ()

    def on_ideal_wheels(self, motors: MotorsSpec) -> Self:  # noqa: ARG002
        """The same fault where a scene's motors are left out, and its wheels run at the speed they are driven at."""
        return self

    @abstractmethod
    def apply(self, cells: NDArray[np.int64], harm: WheelFaults) -> None:
        """Say what is the matter while it acts.

        Args:
            cells: Those that it strikes, by index.
            harm: To be changed.
        """


class WheelFault(CellTarget, PlantFault):
    """A fault of wheels of cells."""

    wheel: Literal["x", "y", "both"] = "both"
    """The one that moves parcels along x, the one along y, or both."""

    def wheels(self, cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], slice]:
        """Rows and columns of those that it strikes, in an array ``(n, 2)`` of all wheels."""
        return cells, {"x": slice(0, 1), "y": slice(1, 2), "both": slice(0, 2)}[self.wheel]
