"""``HeatDiffusion`` compiled."""

from __future__ import annotations

from cell_firmware.kernels.jit import INTEGER, REAL, entry, read, written
from cell_firmware.kernels.programs.hold import aged


@entry(
    REAL, INTEGER, read("?", 2), read("f8", 3), read("f8", 2), read("?", 2), read("f8", 3), read("i2", 2),
    written("f8", 2), written("f8", 3), written("i2", 2), written("f8", 3),
)  # fmt: skip
def step(
    number,
    ttl_periods,
    received,
    message,
    speed,
    held,
    neighbour,
    counts,
    speed_next,
    neighbour_next,
    counts_next,
    outbox,
):
    """One explicit step of every cell; sides are added in the order north, east, south, west.

    Args:
        number: Of diffusion.
        ttl_periods: Validity of a message.
        received: ``(n, 4)``, whether a message arrived.
        message: ``(n, 4, 2)``, speeds, m/s.
        speed: ``(n, 2)``, the cells' own.
        held: ``(n, 1)``, whether it is constant.
        neighbour: ``(n, 4, 2)``, the neighbours' last.
        counts: ``(n, 4)``, for how many periods these are valid.
        speed_next: The state after the step; is filled, ...
        neighbour_next: ... and so is this, ...
        counts_next: ... and this.
        outbox: ``(n, 4, 2)``; is filled.
    """
    for i in range(len(speed)):
        for side in range(4):
            counts_next[i, side] = aged(received[i, side], counts[i, side], ttl_periods)
        for axis in range(2):
            own, gain = speed[i, axis], 0.0
            for side in range(4):
                theirs = 0.0
                if received[i, side]:
                    theirs = message[i, side, axis]
                elif counts_next[i, side] > 0:
                    theirs = neighbour[i, side, axis]
                neighbour_next[i, side, axis] = theirs
                flow = theirs - own if counts_next[i, side] > 0 else 0.0
                gain = flow if side == 0 else gain + flow
            speed_next[i, axis] = own if held[i, 0] else own + number * gain
            for side in range(4):
                outbox[i, side, axis] = speed_next[i, axis]
