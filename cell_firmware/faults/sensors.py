"""What faults of presence sensors have in common: which sensors, and how they are found in a shard."""

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
    """A fault of the struck cells' presence sensors: of one of each, or of all.

    It concerns what cells are told last, after all effects: the bit, and where sensors are analogue the level too.
    """

    sensor: Annotated[int, Field(ge=0)] | None = None
    """Its number among the cell's sensors; None: all of them."""

    def fit_problems(self, cells: CellsSpec, sensors: int) -> Iterator[Problem]:
        """A sensor that cells don't have."""
        del cells
        if self.sensor is not None and self.sensor >= sensors:
            yield ("sensor",), self.sensor, f"each cell has sensors 0..{sensors - 1}"

    def input_filters(
        self, site: ShardContext, lattice: Lattice, injected: FaultInstance[CellFault]
    ) -> Iterator[FaultFilter]:
        """One, where the shard has a cell that is struck."""
        del lattice
        rows = np.flatnonzero(np.isin(site.cells, injected.cells))
        if len(rows):
            which = np.arange(site.sensors) if self.sensor is None else np.array([self.sensor])
            yield self.make_filter(AffectedSensors(site, rows, which), injected)

    @abstractmethod
    def make_filter(self, struck: AffectedSensors, injected: FaultInstance[CellFault]) -> FaultFilter:
        """The stage, for sensors of a shard that are struck."""


@final
class AffectedSensors:
    """Sensors of a shard's cells.

    Args:
        site: The shard.
        rows: ``(m,)``, its cells that are struck.
        which: ``(k,)``, those of each cell's sensors.
    """

    def __init__(self, site: ShardContext, rows: NDArray[np.int64], which: NDArray[np.int64]) -> None:
        self.at = np.ix_(rows, which)
        self.shape = (len(rows), len(which))
        self._site = site
        self._place = stream_ids(site.cells[rows], site.sensors).reshape(len(rows), -1)[:, which].ravel()

    def draws(self, injected: FaultInstance[CellFault]) -> CounterStream:
        """A number for each of these sensors and every tick."""
        return CounterStream(self._site.seed, stream_name(injected), self._place)

    def copied(self, inputs: Inputs) -> Inputs:
        """The inputs with copies of what sensors say, to be written to."""
        level = None if inputs.level is None else inputs.level.copy()
        return replace(inputs, presence=inputs.presence.copy(), level=level)


class SensorFilter(FaultFilter):
    """A stage that changes what the struck sensors say, and counts which of their bits it did.

    Args:
        struck: The sensors.
        injected: The fault.
    """

    def __init__(self, struck: AffectedSensors, injected: FaultInstance[CellFault]) -> None:
        super().__init__(injected, "wrong")
        self._struck = struck

    def apply_active(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """What these sensors say instead."""
        told, at = self._struck.copied(inputs), self._struck.at
        level = None if told.level is None else told.level[at]
        bit, level = self.override(tick, told.presence[at], level)
        told.presence[at] = bit
        if told.level is not None and level is not None:
            told.level[at] = level
        self.count("wrong", told.presence ^ inputs.presence, alive)
        return told

    @abstractmethod
    def override(
        self, tick: int, bit: NDArray[np.bool_], level: Floats | None
    ) -> tuple[NDArray[np.bool_] | bool, Floats | float | None]:
        """What ``(m, k)`` sensors say instead of this bit and level; a level of None where there are none."""
