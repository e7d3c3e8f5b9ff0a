"""When the plant lets cells with clocks of their own read and act."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, final

import numpy as np

from bus.memory import Remembers
from cell_firmware.clocks import NEVER
from plant.timing import Timing

if TYPE_CHECKING:
    from cell_firmware.clocks import Clocks, Ints
    from deploy.scene import Scene


@final
class CellTimes:
    """The plant's side of ``cell_firmware.clocked``, by the same clocks.

    In tick k cells read at their instants r in window k. They are told in tick k + 1, and what they answer acts
    at r + W, in that tick.

    Args:
        clocks: Of all cells.
    """

    remembers: ClassVar[Remembers] = Remembers("_tick", "_count", "_read_ns")

    def __init__(self, clocks: Clocks) -> None:
        self._clocks = clocks
        self._tick = 0
        self._count: Ints = np.zeros(len(clocks), dtype=np.int64)
        self._read_ns: Ints = np.full(len(clocks), NEVER)

    def __call__(self, tick: int) -> Timing:
        """When drives act and cells read in a tick, which is one more than the last that was asked for."""
        assert tick == self._tick, "this is a bug: clocks are followed tick by tick"
        read_ns, clocks = self._read_ns, self._clocks
        acts_ns = np.where(read_ns == NEVER, NEVER, read_ns + clocks.window_ns)
        self._read_ns = clocks.due(tick, self._count)
        self._count = self._count + (self._read_ns != NEVER)
        self._tick += 1
        return Timing(acts_ns, self._read_ns)


def cell_times(scene: Scene) -> CellTimes | None:
    """Those of a scene; None where its cells step at once."""
    clocks = scene.clocks()
    return None if clocks is None else CellTimes(clocks.all)
