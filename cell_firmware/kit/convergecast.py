"""Piece *convergecast*: sums over a tree, up to the root and back to all."""

from __future__ import annotations

from typing import Any

from cell_firmware.scalar_program import scalar_function


@scalar_function
def subtotal(own: Any, child: Any, totals: Any, most: Any) -> Any:
    """Return the sum over the cell and all below it in the tree.

    Source: A. Segall, "Distributed network protocols", IEEE Trans. Information Theory 29 (1983), PIF.

    Args:
        own: What the cell itself adds, at least 0.
        child: For each side, whether the neighbour is a child.
        totals: For each side, the neighbour's last subtotal.
        most: Greatest sum: while a tree forms, cells may be counted again and again.
    """
    total = own
    for side in range(4):
        if child[side]:
            total = min(total + max(totals[side], 0), most)
    return total


@scalar_function
def broadcast(parent: Any, total: Any, results: Any) -> Any:
    """Return the root's total as the cell knows it: the parent's result, its own total at the root.

    Args:
        parent: Side of the parent; none for a root: 4.
        total: The cell's subtotal.
        results: For each side, the neighbour's last result.
    """
    if parent < 4:
        return results[parent]
    return total
