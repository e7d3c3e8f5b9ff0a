"""Pieces of neighbour protocols for programs of cells; ``docs/protocols/kit.md`` has the theorem of each.

::

    from mdms.kit import aged, elect, is_child, subtotal
"""

from __future__ import annotations

from cell_firmware.kit.convergecast import broadcast, subtotal
from cell_firmware.kit.election import elect
from cell_firmware.kit.gossip import MODULUS, UNIT, arrived, pushed, share_of
from cell_firmware.kit.gradient import NOBODY, descend
from cell_firmware.kit.silence import aged
from cell_firmware.kit.slots import MOST_AROUND, UNKNOWN, free_slot, has_to_move, yields
from cell_firmware.kit.synchroniser import PULSES, lead, next_pulse, value_at
from cell_firmware.kit.tree import is_child

__all__ = [
    "MODULUS",
    "MOST_AROUND",
    "NOBODY",
    "PULSES",
    "UNIT",
    "UNKNOWN",
    "aged",
    "arrived",
    "broadcast",
    "descend",
    "elect",
    "free_slot",
    "has_to_move",
    "is_child",
    "lead",
    "next_pulse",
    "pushed",
    "share_of",
    "subtotal",
    "value_at",
    "yields",
]
