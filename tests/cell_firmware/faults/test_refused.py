"""What faults of links and sensors refuse, of themselves, of the array, and of the cells."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from bus.fault import FaultInstance
from bus.lattice import Lattice
from cell_firmware.effects.base import ShardContext
from cell_firmware.faults.kinds.link_down import LinkDownFault
from cell_firmware.faults.kinds.link_loss import LinkLossFault
from cell_firmware.faults.kinds.partition import PartitionFault
from cell_firmware.faults.kinds.sensor_stuck import SensorStuckFault
from cell_firmware.specs import CellsSpec

Grid = Callable[..., Lattice]


@pytest.mark.parametrize("line", [{}, {"row": 0, "column": 0}])
def test_a_partition_has_one_line(line: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match="give row or column, one of the two"):
        PartitionFault.model_validate(line)


def test_a_partition_is_north_of_its_row_or_east_of_its_column(grid: Grid) -> None:
    lattice = grid(2, 3)
    row, column = PartitionFault(row=0), PartitionFault(column=1)
    assert row.affected_links(lattice, 0, 0).tolist() == [[0, 0], [1, 0], [2, 0], [3, 2], [4, 2], [5, 2]]
    assert row.affected_cells(lattice, 0, 0).tolist() == list(range(6))
    assert column.affected_links(lattice, 0, 0).tolist() == [[1, 1], [2, 3], [4, 1], [5, 3]]
    assert [*row.problems(lattice), *column.problems(lattice)] == []


@pytest.mark.parametrize(("line", "value"), [("row", 1), ("column", 2), ("row", 9)])
def test_a_line_that_no_link_crosses_is_misplaced(line: str, value: int, grid: Grid) -> None:
    ((path, found, rule),) = PartitionFault.model_validate({line: value}).problems(grid(2, 3))
    assert (path, found) == ((line,), value)
    assert rule == f"no two cells are neighbours across the line behind this {line}"


def test_bursts_may_be_as_short_as_a_good_link_can_turn_bad_at_once() -> None:
    fault = LinkLossFault(probability=0.75, burst_ticks=3.0, cell=(0, 0))
    assert fault.turns_bad == 1.0
    assert LinkLossFault(probability=1.0, cell=(0, 0)).burst_ticks is None


@pytest.mark.parametrize(("sensor", "refused"), [(None, False), (1, False), (2, True)])
def test_a_sensor_is_one_of_the_cell_s(sensor: int | None, refused: bool) -> None:
    fault = SensorStuckFault(value=1, cell=(0, 0), sensor=sensor)
    found = list(fault.fit_problems(CellsSpec(firmware="heat_diffusion"), 2))
    assert found == ([(("sensor",), sensor, "each cell has sensors 0..1")] if refused else [])


def test_counters_of_a_fault_are_reported_where_nothing_happened(grid: Grid) -> None:
    lattice, fault = grid(1, 2), LinkDownFault(cell=(0, 0))
    site = ShardContext(np.arange(2), 1, np.dtype([("u", "<f8")]), 0)
    (stage,) = fault.input_filters(site, lattice, FaultInstance(0, fault, np.array([0]), 0))
    assert stage.counters == {"link_down.lost": 0}
