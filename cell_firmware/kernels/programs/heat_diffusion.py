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
    own_x, own_y = state.speed_m_s[0], state.speed_m_s[1]
    for side in range(4):
        state.counts[side] = aged(inputs.received[side] != 0, state.counts[side], parameters.ttl_periods)
        if inputs.received[side]:
            state.neighbour_m_s[side, 0] = inputs.message[side].vx_m_s
            state.neighbour_m_s[side, 1] = inputs.message[side].vy_m_s
        elif state.counts[side] == 0:
            state.neighbour_m_s[side, 0] = 0.0
            state.neighbour_m_s[side, 1] = 0.0
        flow_x, flow_y = 0.0, 0.0
        if state.counts[side] > 0:
            flow_x, flow_y = state.neighbour_m_s[side, 0] - own_x, state.neighbour_m_s[side, 1] - own_y
        gain_x = flow_x if side == 0 else gain_x + flow_x
        gain_y = flow_y if side == 0 else gain_y + flow_y
    if not state.held[0]:
        state.speed_m_s[0] = own_x + parameters.diffusion_number * gain_x
        state.speed_m_s[1] = own_y + parameters.diffusion_number * gain_y
    for side in range(4):
        outputs.sent[side] = 1
        outputs.message[side].vx_m_s = state.speed_m_s[0]
        outputs.message[side].vy_m_s = state.speed_m_s[1]
    outputs.speed_m_s[0], outputs.speed_m_s[1] = state.speed_m_s[0], state.speed_m_s[1]


tick, rows = compiled_program(__name__, step, PARAMETERS, STATE, MESSAGE)
