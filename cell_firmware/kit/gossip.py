"""Piece *gossip*: push-sum by running sums, which loses no mass where messages get lost."""

from __future__ import annotations

from typing import Any

from cell_firmware.scalar_program import scalar_function

UNIT = 1 << 32
"""Mass of the number 1: masses are whole numbers, so that sums are exact."""
MODULUS = 1 << 56
"""Wrap of running sums. What is under way on a link must be less than half of it."""


@scalar_function
def share_of(mass: Any, neighbours: Any) -> Any:
    """Return the share of its mass that a cell pushes to each of its neighbours: as much as it keeps, rounded down.

    Source: D. Kempe, A. Dobra and J. Gehrke, "Gossip-based computation of aggregate information", FOCS 2003.

    Args:
        mass: Mass of the cell, units.
        neighbours: Number of neighbours to push to.
    """
    return mass // (neighbours + 1)


@scalar_function
def pushed(total: Any, share: Any) -> Any:
    """Return the running sum of all that was pushed to a neighbour, after a share more."""
    return (total + share) % MODULUS


@scalar_function
def arrived(total: Any, seen: Any) -> Any:
    """Return the mass that a neighbour has pushed since the last message that came, lost messages included.

    Source: C. Hadjicostis, N. Vaidya and A. Dominguez-Garcia, "Robust distributed average consensus via exchange of
    running sums", IEEE Trans. Automatic Control 61 (2016).

    Args:
        total: Running sum of the neighbour, as received.
        seen: Running sum in the last message that came.

    Returns:
        Units; of the weight, which is never negative, a negative number tells that the message is older than the last.
    """
    mass = (total - seen) % MODULUS
    if 2 * mass >= MODULUS:
        mass -= MODULUS
    return mass
