"""Piece *tree*: who is a child, in the spanning tree that an election leaves."""

from __future__ import annotations

from typing import Any

from cell_firmware.scalar_program import scalar_function


@scalar_function
def is_child(
    side: Any, root: Any, distance: Any, their_root: Any, their_distance: Any, their_parent: Any
) -> Any:
    """Return whether the neighbour on a side is a child of the cell.

    A child follows the same root, one hop farther away, and has chosen this cell as its parent. Then children are
    farther from the root than their parents, so that no cell is its own ancestor.

    Args:
        side: The side, 0 to 3.
        root: Key of the cell's root.
        distance: The cell's distance from the root, hops.
        their_root: The same of the neighbour.
        their_distance: The same of the neighbour.
        their_parent: Side on which the neighbour has its parent.
    """
    return their_parent == (side + 2) % 4 and their_root == root and their_distance == distance + 1
