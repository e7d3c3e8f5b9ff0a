"""Base classes of sensor faults: affected sensors of a shard, and filters of readings."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.fault import CellTarget, FaultInstance, Problem
from bus.lattice import Lattice
from bus.random_streams import CounterStream
from cell_firmware.effects.base import ShardContext, stream_ids
from cell_firmware.faults.base import CellFault, FaultFilter, stream_name
from cell_firmware.firmware import Floats, Inputs
from cell_firmware.specs import CellsSpec


class SensorFault(CellTarget, CellFault):
    """A fault of presence sensors of the affected cells: one sensor of each, or all.

    It acts after all effects, on the bit, and where sensors are analogue on the level too.
    """

    sensor: Annotated[int, Field(ge=0)] | None = None
    """Number of the affected sensor in each cell, from 0; None: all sensors."""

    def fit_problems(self, cells: CellsSpec, sensors: int) -> Iterator[Problem]:
        """Yield a sensor that cells don't have."""
        del cells
        if self.sensor is not None and self.sensor >= sensors:
            yield ("sensor",), self.sensor, f"each cell has sensors 0..{sensors - 1}"

    def input_filters(
        self, site: ShardContext, lattice: Lattice, injected: FaultInstance[CellFault]
    ) -> Iterator[FaultFilter]:
        """Yield one filter, where the shard has an affected cell."""
        del lattice
        rows = np.flatnonzero(np.isin(site.cells, injected.cells))
        if len(rows):
            which = np.arange(site.sensors) if self.sensor is None else np.array([self.sensor])
            yield self.make_filter(AffectedSensors(site, rows, which), injected)

    @abstractmethod
    def make_filter(self, affected: AffectedSensors, injected: FaultInstance[CellFault]) -> FaultFilter:
        """Return the filter of a shard's affected sensors."""


@final
class AffectedSensors:
    """Sensors of a shard's cells.

    Args:
        site: The shard.
        rows: ``(m,)``, rows of affected cells.
        which: ``(k,)``, affected sensors of each cell.
    """

    def __init__(self, site: ShardContext, rows: NDArray[np.int64], which: NDArray[np.int64]) -> None:
        self.at = np.ix_(rows, which)
        self.shape = (len(rows), len(which))
        self._site = site
        self._place = stream_ids(site.cells[rows], site.sensors).reshape(len(rows), -1)[:, which].ravel()

    def draws(self, injected: FaultInstance[CellFault]) -> CounterStream:
        """Return the random stream of these sensors: a number for each sensor and tick."""
        return CounterStream(self._site.seed, stream_name(injected), self._place)

    def copied(self, inputs: Inputs) -> Inputs:
        """Return the inputs with writable copies of the readings."""
        level = None if inputs.level is None else inputs.level.copy()
        return replace(inputs, presence=inputs.presence.copy(), level=level)


class SensorFilter(FaultFilter):
    """A filter that changes readings of the affected sensors, and counts wrong bits.

    Args:
        affected: The sensors.
        injected: The fault.
    """

    def __init__(self, affected: AffectedSensors, injected: FaultInstance[CellFault]) -> None:
        super().__init__(injected, "wrong")
        self._affected = affected

    def apply_active(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Replace the readings of the affected sensors."""
        changed, at = self._affected.copied(inputs), self._affected.at
        level = None if changed.level is None else changed.level[at]
        bit, level = self.override(tick, changed.presence[at], level)
        changed.presence[at] = bit
        if changed.level is not None and level is not None:
            changed.level[at] = level
        self.count("wrong", changed.presence ^ inputs.presence, alive)
        return changed

    @abstractmethod
    def override(
        self, tick: int, bit: NDArray[np.bool_], level: Floats | None
    ) -> tuple[NDArray[np.bool_] | bool, Floats | float | None]:
        """Return replacements of the bits and levels of ``(m, k)`` sensors; level is None for binary sensors."""
