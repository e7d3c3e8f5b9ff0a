"""Time to live of messages: a neighbour's last message is held while still valid."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cell_firmware.firmware import Bools

Ttl = Annotated[int, Field(ge=1, le=1_000)]
"""Validity of a neighbour's message, periods: 1 for the period of arrival alone."""
Counts = NDArray[np.int16]


def age_ttl(received: Bools, counts: Counts, ttl_periods: int) -> Counts:
    """Return for how many periods, the current one included, each side's message is valid; 0 without a message.

    Args:
        received: ``(n, 4)``, whether a message arrived.
        counts: ``(n, 4)``, result of the previous period.
        ttl_periods: Validity of a message, periods.
    """
    return np.where(received, ttl_periods, np.maximum(counts, 1) - 1).astype(np.int16)


def hold_last(
    received: Bools, counts: Counts, message: NDArray[Any], before: NDArray[Any], silence: int = 0
) -> NDArray[Any]:
    """Return each neighbour's last message, ``(n, 4)`` or ``(n, 4, components)``.

    Args:
        received: ``(n, 4)``, whether a message arrived.
        counts: ``(n, 4)``, result of ``age_ttl``.
        message: Received messages.
        before: Result of the previous period.
        silence: Substitute for a message that has expired.
    """
    shape = received.shape + (1,) * (message.ndim - 2)
    held = np.where(counts.reshape(shape) > 0, before, np.array(silence, dtype=before.dtype))
    return np.where(received.reshape(shape), message, held)
