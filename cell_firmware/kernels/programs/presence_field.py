"""``PresenceField`` in scalar form."""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import inlined
from cell_firmware.kernels.programs.hold import aged
from cell_firmware.kernels.shard import compiled_program

PARAMETERS = np.dtype([("reach", "<i8"), ("ttl_periods", "<i8")])
MESSAGE = np.dtype([("level", "u1")])
STATE = np.dtype(
    [
        ("speed_m_s", "<f8", (2,)),  # of a cell that runs
        ("counts", "<i2", (4,)),  # for how many periods the neighbours' levels are valid
        ("neighbour", "u1", (4,)),  # these levels, 0 where they are not valid any more
    ],
    align=True,
)


@inlined
def step(parameters, state, inputs, outputs):
    """Wake or sleep, and send the own level."""
    highest = 0
    for side in range(4):
        state.counts[side] = aged(inputs.received[side] != 0, state.counts[side], parameters.ttl_periods)
        if inputs.received[side]:
            state.neighbour[side] = inputs.message[side].level
        elif state.counts[side] == 0:
            state.neighbour[side] = 0
        highest = max(highest, state.neighbour[side])
    here = False
    for sensor in range(inputs.sensors):
        here = here or inputs.presence[sensor] != 0
    level = parameters.reach + 1 if here else max(highest, 1) - 1
    for axis in range(2):
        outputs.speed_m_s[axis] = state.speed_m_s[axis] if level > 0 else 0.0
    for side in range(4):
        outputs.sent[side] = 1
        outputs.message[side].level = level


tick, rows = compiled_program(__name__, step, PARAMETERS, STATE, MESSAGE)
