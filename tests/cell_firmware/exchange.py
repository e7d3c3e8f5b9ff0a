"""One exchange of a controller, as the shard steps it."""

from __future__ import annotations

from cell_firmware.controller import Controller, ControllerOutputs, ControllerState, StepTime
from cell_firmware.firmware import Inputs


def exchange(
    controller: Controller, now: StepTime, state: ControllerState, inputs: Inputs
) -> tuple[ControllerState, ControllerOutputs]:
    state, inputs = controller.receive(now, state, inputs)
    return controller.compute(now, state, inputs)
