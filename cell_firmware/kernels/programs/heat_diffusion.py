"""``HeatDiffusion`` in scalar form."""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import inlined
from cell_firmware.kernels.programs.hold import aged
from cell_firmware.kernels.shard import compiled_program

PARAMETERS = np.dtype([("diffusion_number", "<f8"), ("ttl_periods", "<i8")])
MESSAGE = np.dtype([("vx_m_s", "<f8"), ("vy_m_s", "<f8")])
STATE = np.dtype(
    [
        ("speed_m_s", "<f8", (2,)),
        ("neighbour_m_s", "<f8", (4, 2)),  # the neighbours' last, zero where that is not valid any more
        ("counts", "<i2", (4,)),  # for how many periods these are valid
        ("held", "u1", (1,)),  # whether the speed is constant
    ],
    align=True,
)


@inlined
def step(parameters, state, inputs, outputs):
    """One explicit step of a cell; sides are added in the order north, east, south, west."""
    gain_x, gain_y = 0.0, 0.0
    x, y = state.speed_m_s[0], state.speed_m_s[1]
    for side in range(4):
        if inputs.received[side]:
            count = parameters.ttl_periods
            theirs_x, theirs_y = inputs.message[side].vx_m_s, inputs.message[side].vy_m_s
        else:
            count = aged(False, state.counts[side], parameters.ttl_periods)
            theirs_x, theirs_y = 0.0, 0.0
            if count > 0:
                theirs_x, theirs_y = state.neighbour_m_s[side, 0], state.neighbour_m_s[side, 1]
        flow_x, flow_y = 0.0, 0.0
        if count > 0:
            flow_x, flow_y = theirs_x - x, theirs_y - y
        gain_x = flow_x if side == 0 else gain_x + flow_x
        gain_y = flow_y if side == 0 else gain_y + flow_y
        state.counts[side] = count
        state.neighbour_m_s[side, 0], state.neighbour_m_s[side, 1] = theirs_x, theirs_y
    if not state.held[0]:
        x, y = x + parameters.diffusion_number * gain_x, y + parameters.diffusion_number * gain_y
        state.speed_m_s[0], state.speed_m_s[1] = x, y
    for side in range(4):
        outputs.sent[side] = 1
        outputs.message[side].vx_m_s = x
        outputs.message[side].vy_m_s = y
    outputs.speed_m_s[0], outputs.speed_m_s[1] = x, y


tick, rows = compiled_program(__name__, step, PARAMETERS, STATE, MESSAGE)
