"""``VelocityField`` in scalar form."""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import inlined
from cell_firmware.kernels.program import NO_MESSAGE as MESSAGE
from cell_firmware.kernels.shard import compiled_program

PARAMETERS = np.dtype([("none", "<i8")])
STATE = np.dtype([("speed_m_s", "<f8", (2,))])


@inlined
def step(parameters, state, inputs, outputs):  # noqa: ARG001 - as every program
    """Drive the constant velocity."""
    outputs.speed_m_s[0], outputs.speed_m_s[1] = state.speed_m_s[0], state.speed_m_s[1]


tick, rows = compiled_program(__name__, step, PARAMETERS, STATE, MESSAGE)
