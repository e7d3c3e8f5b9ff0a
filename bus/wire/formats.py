"""The two wire forms, one a file, and their names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal, NamedTuple

from bus.wire.format import CoordinatorCodec, ParticipantCodec, RunSchema
from bus.wire.packed import PackedCoordinator, PackedParticipant
from bus.wire.per_cell import PerCellCoordinator, PerCellParticipant

WireFormat = Literal["packed", "per_cell"]


class FormatCodecs(NamedTuple):
    """Both sides of a form."""

    coordinator: Callable[[RunSchema], CoordinatorCodec]
    participant: Callable[[RunSchema, int], ParticipantCodec]


FORMATS: Final[dict[WireFormat, FormatCodecs]] = {
    "packed": FormatCodecs(PackedCoordinator, PackedParticipant),
    "per_cell": FormatCodecs(PerCellCoordinator, PerCellParticipant),
}
