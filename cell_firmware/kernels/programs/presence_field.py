"""``PresenceField`` compiled."""

from __future__ import annotations

from cell_firmware.kernels.jit import INTEGER, entry, read, written
from cell_firmware.kernels.programs.hold import aged


@entry(
    INTEGER, INTEGER, read("?", 2), read("?", 2), read("u1", 2), read("f8", 2), read("u1", 2), read("i2", 2),
    written("f8", 2), written("u1", 2), written("i2", 2), written("u1", 2),
)  # fmt: skip
def step(
    reach,
    ttl_periods,
    presence,
    received,
    message,
    awake,
    neighbour,
    counts,
    speed,
    neighbour_next,
    counts_next,
    outbox,
):
    """Wake or sleep, and send the own level.

    Args:
        reach: Largest distance of a running cell from one that senses a parcel.
        ttl_periods: Validity of a message.
        presence: ``(n, sensors)``.
        received: ``(n, 4)``, whether a message arrived.
        message: ``(n, 4)`` uint8, levels.
        awake: ``(n, 2)``, speed of a cell that runs, m/s.
        neighbour: ``(n, 4)`` uint8, the neighbours' last levels.
        counts: ``(n, 4)``, for how many periods these are valid.
        speed: ``(n, 2)``, the speed driven; is filled.
        neighbour_next: The state after the step; is filled, ...
        counts_next: ... and so is this.
        outbox: ``(n, 4)`` uint8; is filled.
    """
    for i in range(len(awake)):
        highest = 0
        for side in range(4):
            counts_next[i, side] = aged(received[i, side], counts[i, side], ttl_periods)
            theirs = 0
            if received[i, side]:
                theirs = int(message[i, side])
            elif counts_next[i, side] > 0:
                theirs = int(neighbour[i, side])
            neighbour_next[i, side] = theirs
            highest = max(highest, theirs)
        here = False
        for sensor in range(presence.shape[1]):
            here = here or presence[i, sensor]
        level = reach + 1 if here else max(highest, 1) - 1
        for axis in range(2):
            speed[i, axis] = awake[i, axis] if level > 0 else 0.0
        for side in range(4):
            outbox[i, side] = level
