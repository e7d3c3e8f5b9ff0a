"""Registry of the wire formats by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from bus.wire.format import CoordinatorCodec, ParticipantCodec, RunSchema
from bus.wire.keys import WireFormat
from bus.wire.packed import PackedCoordinator, PackedParticipant
from bus.wire.per_cell import PerCellCoordinator, PerCellParticipant
from bus.wire.relayed import RelayedCoordinator, RelayedParticipant

__all__ = ["FORMATS", "FormatCodecs", "WireFormat"]


class FormatCodecs(NamedTuple):
    """Both sides of a wire format."""

    coordinator: Callable[[RunSchema], CoordinatorCodec]
    participant: Callable[[RunSchema, int], ParticipantCodec]


FORMATS: Final[dict[WireFormat, FormatCodecs]] = {
    "packed": FormatCodecs(PackedCoordinator, PackedParticipant),
    "per_cell": FormatCodecs(PerCellCoordinator, PerCellParticipant),
    "relayed": FormatCodecs(RelayedCoordinator, RelayedParticipant),
}
