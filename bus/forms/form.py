"""What the lockstep asks of a wire form: frames to keys and payloads, and back.

A form cuts the cells into *units*, each with its own keys: a shard in the packed form, a cell in the other.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from bus.keys import check_run
from bus.partition import Index, Partition
from bus.wire import DriveFrame, LinkFrame, SenseFrame, check_message

Place = int | slice | Index
"""What selects a unit's rows in an array of cells, or a part's in an array of links."""


@final
@dataclass(frozen=True, slots=True)
class Wiring:
    """What both sides of a run must agree on.

    Args:
        run: Name of the run, second chunk of every key.
        partition: How the cells are cut into shards.
        sensors: Presence sensors a cell.
        encoders: Whether there are encoders to read.
        message: The protocol's message type, None where cells send each other nothing.

    Raises:
        RunNameError: The name can't stand in a key.
        WireError: The message type can't go over the wire.
    """

    run: str
    partition: Partition
    sensors: int
    encoders: bool
    message: np.dtype[Any] | None

    def __post_init__(self) -> None:
        check_run(self.run)
        if self.message is not None:
            object.__setattr__(self, "message", check_message(self.message))


class HostForm(ABC):
    """The plant's side of a form.

    Attributes:
        unit_cells: Indices of each unit's cells.
        unit_rows: What selects each unit's rows in an array of all cells.
        sense_keys: Key of each unit's sense.
        drive_units, alive_units, ready_units: Unit of each such key.
        drive_expr, alive_expr, ready_expr: What to subscribe to and to watch.
    """

    unit_cells: tuple[Index, ...]
    unit_rows: tuple[Place, ...]
    sense_keys: tuple[str, ...]
    drive_units: dict[str, int]
    alive_units: dict[str, int]
    ready_units: dict[str, int]
    drive_expr: str
    alive_expr: str
    ready_expr: str

    @abstractmethod
    def sense_payloads(self, frame: SenseFrame) -> list[bytes]:
        """A payload a unit, in their order."""

    @abstractmethod
    def decode_drive(self, unit: int, payload: bytes) -> tuple[int, Any]:
        """Tick and values, to be put in the unit's rows.

        Raises:
            WireError: Not a drive of this unit.
        """


class MemberForm(ABC):
    """A shard's side of a form. *Rows* are places in the shard, *links* stretches of its border links.

    Attributes:
        alive_keys, ready_keys, drive_keys: The shard's own keys, one a unit.
        unit_cells: Indices (in the lattice) of each unit's cells.
        unit_rows: Rows of each unit.
        sense_units: Unit of each sense key.
        in_parts: Part of each key on which the shard hears its neighbours.
        in_links: Stretch of the incoming links that each part covers.
        in_sources: Cells of the unit that sends each part.
        out_keys, out_links: Key and stretch of each part that the shard sends.
        out_sources, out_targets: Cells of the units that send and hear each part.
    """

    alive_keys: tuple[str, ...]
    ready_keys: tuple[str, ...]
    drive_keys: tuple[str, ...]
    unit_cells: tuple[Index, ...]
    unit_rows: tuple[Place, ...]
    sense_units: dict[str, int]
    in_parts: dict[str, int]
    in_links: tuple[Place, ...]
    in_sources: tuple[Index, ...]
    out_keys: tuple[str, ...]
    out_links: tuple[Place, ...]
    out_sources: tuple[Index, ...]
    out_targets: tuple[Index, ...]

    @abstractmethod
    def decode_sense(self, unit: int, payload: bytes) -> tuple[int, Any, Any]:
        """Tick, presence and encoder travel (or None), to be put in the unit's rows.

        Raises:
            WireError: Not a sense of this unit.
        """

    @abstractmethod
    def decode_link(self, part: int, payload: bytes) -> tuple[int, Any, Any]:
        """Tick, mask and messages, to be put in the part's stretch of the incoming links.

        Raises:
            WireError: Not a link frame of this part.
        """

    @abstractmethod
    def drive_payloads(self, frame: DriveFrame) -> list[bytes]:
        """A payload a unit, in their order."""

    @abstractmethod
    def link_payloads(self, frame: LinkFrame) -> list[bytes]:
        """A payload a part that the shard sends, in their order."""


def stretch(index: Index) -> Place:
    """The same selection as a slice where it is one: NumPy then copies instead of gathering."""
    if len(index) and int(index[-1]) - int(index[0]) == len(index) - 1:
        return slice(int(index[0]), int(index[-1]) + 1)
    return index
