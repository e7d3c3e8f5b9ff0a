"""A neighbour's last word, kept for as long as it counts: what firmware does about messages that do not come."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cell_firmware.firmware import Bools

Ttl = Annotated[int, Field(ge=1, le=1_000)]
"""For how many periods a neighbour's word counts: 1 for the period in which it comes alone."""
Counts = NDArray[np.int16]


def age_ttl(received: Bools, counts: Counts, ttl_periods: int) -> Counts:
    """For how many periods, this one among them, each side's word still counts; 0 where there is none.

    Args:
        received: ``(n, 4)``: did one come?
        counts: ``(n, 4)``, this function's answer of the period before.
        ttl_periods: For how many periods a word counts.
    """
    return np.where(received, ttl_periods, np.maximum(counts, 1) - 1).astype(np.int16)


def hold_last(
    received: Bools, counts: Counts, message: NDArray[Any], before: NDArray[Any], silence: int = 0
) -> NDArray[Any]:
    """What each side told last, ``(n, 4)`` or ``(n, 4, components)``.

    Args:
        received: ``(n, 4)``: did a word come?
        counts: ``(n, 4)``, what ``still_counts`` says.
        message: What came.
        before: This function's answer of the period before.
        silence: What a side counts as whose word no longer does.
    """
    shape = received.shape + (1,) * (message.ndim - 2)
    kept = np.where(counts.reshape(shape) > 0, before, np.array(silence, dtype=before.dtype))
    return np.where(received.reshape(shape), message, kept)
