"""Piece *silence*: how long a neighbour's last message stays valid."""

from __future__ import annotations

from typing import Any

from cell_firmware.scalar_program import scalar_function


@scalar_function
def aged(received: Any, count: Any, ttl_periods: Any) -> Any:
    """Return for how many periods, the current one included, a neighbour's last message is valid.

    A corrupted count is valid for ``ttl_periods`` periods at most, and so is what was held with it.

    Args:
        received: Whether a message has arrived in this period.
        count: Result of the previous period; 0 before the first message.
        ttl_periods: Validity of a message, periods.
    """
    if received:
        return ttl_periods
    return min(max(count, 1) - 1, ttl_periods)
