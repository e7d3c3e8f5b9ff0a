"""Hook for events of cells whose wheels share one limit, which the implicit solver alone knows."""

from __future__ import annotations

from plant.kernels.common.hooks import implements


def cone_changes(work, surface, parcel, order, step, end, count):
    """Find when the slip of a cell ends or nearly does, as ``branches.branch_changes`` does. Returns (count, end)."""


@implements(cone_changes, "law", own=False)
def _none(_work, _surface, _parcel, _order, _step, end, count):
    return count, end
