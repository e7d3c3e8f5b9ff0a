"""Piece *slots*: a slot of a frame for each cell, which no cell within two hops has."""

from __future__ import annotations

from typing import Any

from cell_firmware.scalar_program import scalar_function

UNKNOWN = 255
"""Slot of a cell that isn't there, or hasn't been heard."""
MOST_AROUND = 12
"""Most cells within two hops of a cell: a frame of more slots has a free one for every cell."""


@scalar_function
def yields(side: Any, other: Any) -> Any:
    """Return whether a cell yields to the cell over one side, or over two: to the north first, then to the east.

    Args:
        side: The first step, 0 to 3.
        other: The second step; 4: none.
    """
    north = (side == 0) - (side == 2) + (other == 0) - (other == 2)
    east = (side == 1) - (side == 3) + (other == 1) - (other == 3)
    return north > 0 or (north == 0 and east > 0)


@scalar_function
def has_to_move(slot: Any, valid: Any, near: Any, beyond: Any) -> Any:
    """Return whether a cell that this one yields to, within two hops, has the same slot.

    Args:
        slot: The cell's own slot.
        valid: For each side, whether the neighbour's last message is valid.
        near: For each side, the neighbour's slot.
        beyond: For each side, the slots of the neighbour's four neighbours, as it knows them.
    """
    for side in range(4):
        if not valid[side]:
            continue
        if near[side] == slot and yields(side, 4):
            return True
        for other in range(4):
            if other != (side + 2) % 4 and beyond[side][other] == slot and yields(side, other):
                return True
    return False


@scalar_function
def free_slot(valid: Any, near: Any, beyond: Any, slots: Any, draw: Any) -> Any:
    """Return a slot that no known cell within two hops has.

    Args:
        valid: As for ``has_to_move``.
        near: As for ``has_to_move``.
        beyond: As for ``has_to_move``.
        slots: Slots of a frame, more than ``MOST_AROUND`` and at most 62.
        draw: Which of the free slots: 0 for the first, a random number in [0, 1) for any.
    """
    used = 0
    for side in range(4):
        if not valid[side]:
            continue
        if 0 <= near[side] < slots:
            used |= 1 << near[side]
        for other in range(4):
            if other != (side + 2) % 4 and 0 <= beyond[side][other] < slots:
                used |= 1 << beyond[side][other]
    free = 0
    for slot in range(slots):
        free += 1 - ((used >> slot) & 1)
    left = int(draw * free)
    for slot in range(slots):
        if not (used >> slot) & 1:
            if left == 0:
                return slot
            left -= 1
    return 0
