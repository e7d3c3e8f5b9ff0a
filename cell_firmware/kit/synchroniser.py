"""Piece *synchroniser*: pulses that neighbours count together, whatever links lose and delay."""

from __future__ import annotations

from typing import Any

from cell_firmware.scalar_program import scalar_function

PULSES = 1 << 32
"""Wrap of pulses, which are compared as serial numbers (RFC 1982)."""


@scalar_function
def lead(pulse: Any, other: Any) -> Any:
    """Return by how many pulses ``pulse`` is ahead of ``other``; negative: behind it."""
    ahead = (pulse - other) % PULSES
    if 2 * ahead >= PULSES:
        ahead -= PULSES
    return ahead


@scalar_function
def next_pulse(pulse: Any, valid: Any, heard: Any) -> Any:
    """Return the cell's next pulse: one more as soon as every neighbour has been heard at this one, or ahead.

    A cell that is more than one pulse behind a neighbour, as after a restart, joins the neighbour that is farthest.

    Source: B. Awerbuch, "Complexity of network synchronization", J. ACM 32 (1985), synchroniser alpha; joining as in
    A. Arora, S. Dolev and M. Gouda, "Maintaining digital clocks in step", Parallel Processing Letters 1 (1991).

    Args:
        pulse: The cell's pulse.
        valid: For each side, whether a neighbour is there to be waited for.
        heard: For each side, the neighbour's last pulse.
    """
    ready, farthest = True, 0
    for side in range(4):
        if valid[side]:
            ahead = lead(heard[side], pulse)
            ready = ready and ahead >= 0
            farthest = max(farthest, ahead)
    if farthest > 1:
        return (pulse + farthest) % PULSES
    if ready:
        return (pulse + 1) % PULSES
    return pulse


@scalar_function
def value_at(pulse: Any, heard: Any, value: Any, previous: Any) -> Any:
    """Return a neighbour's value of a pulse, from a message with the values of its pulse and of the one before.

    Args:
        pulse: The pulse.
        heard: The neighbour's pulse in the message: this one, or the next.
        value: The neighbour's value at its pulse.
        previous: The neighbour's value at the pulse before.
    """
    if heard == pulse:
        return value
    return previous
