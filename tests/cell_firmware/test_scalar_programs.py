"""Bundled programs in scalar form against the same programs in NumPy, bit for bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.firmware import Inbox, Inputs, State
from cell_firmware.loader import load
from cell_firmware.scalar import ScalarFirmware
from cell_firmware.specs import CellsSpec
from cell_firmware.toolkit.hold import age_ttl, hold_last
from tests.cell_firmware.conftest import cells_of

SENSORS = 2
Step = Callable[[Any, State, Inputs], tuple[dict[str, NDArray[Any]], NDArray[np.float64], NDArray[Any]]]
"""From parameters, state and inputs: what changes of the state, the speeds and the messages' fields, ``(n, f)``."""


def heat_diffusion(parameters: Any, state: State, inputs: Inputs) -> Any:
    """One explicit step of heat conduction, on arrays."""
    inbox = inputs.inbox
    assert inbox is not None
    own = state["speed_m_s"]
    counts = age_ttl(inbox.received, state["counts"], parameters.ttl_periods)
    theirs = np.stack((inbox.message["vx_m_s"], inbox.message["vy_m_s"]), axis=2)
    neighbour = hold_last(inbox.received, counts, theirs, state["neighbour_m_s"])
    flow = np.where(counts[:, :, None] > 0, neighbour - own[:, None, :], 0.0)
    gain = flow[:, 0] + flow[:, 1] + flow[:, 2] + flow[:, 3]
    speed = np.where(state["held"], own, own + parameters.diffusion_number * gain)
    return {"speed_m_s": speed, "neighbour_m_s": neighbour, "counts": counts}, speed, speed


def presence_field(parameters: Any, state: State, inputs: Inputs) -> Any:
    """Levels around cells that sense a parcel, on arrays."""
    inbox = inputs.inbox
    assert inbox is not None
    counts = age_ttl(inbox.received, state["counts"], parameters.ttl_periods)
    neighbour = hold_last(inbox.received, counts, inbox.message["level"], state["neighbour"])
    level = np.where(
        inputs.presence.any(axis=1),
        parameters.reach + 1,
        np.maximum(neighbour.max(axis=1), 1).astype(int) - 1,
    )
    speed = np.where(level[:, None] > 0, state["speed_m_s"], 0.0)
    return {"neighbour": neighbour, "counts": counts}, speed, level[:, None]


FIELD = {"kind": "vortex", "rate_rad_s": 1.0, "centre_m": [0.1, 0.1]}
PROGRAMS: dict[str, tuple[Step, dict[str, Any]]] = {
    "heat_diffusion": (
        heat_diffusion,
        {
            "initial": [{"cell": [0, 0], "speed_m_s": [0.4, -0.2]}],
            "held": [{"cell": [2, 3], "speed_m_s": [-0.1, 0.3]}],
            "ttl_periods": 3,
        },
    ),
    "presence_field": (presence_field, {"field": FIELD, "reach": 2, "ttl_periods": 2}),
}


@pytest.mark.parametrize("name", list(PROGRAMS))
def test_a_program_in_scalar_form_has_the_bits_of_the_same_program_on_arrays(name: str) -> None:
    reference, parameters = PROGRAMS[name]
    firmware = load(CellsSpec(firmware=name, parameters=parameters))
    assert isinstance(firmware, ScalarFirmware)
    assert firmware.message is not None
    cells = cells_of(Lattice((r, c) for r in range(3) for c in range(4)), SENSORS)
    n, draw = len(cells), np.random.default_rng(1)
    state: State = firmware.init(cells)
    for tick in range(200):
        message = np.zeros((n, 4), dtype=firmware.message)
        received = draw.random((n, 4)) < 0.6
        for field in firmware.message.names or ():
            drawn = (
                draw.normal(size=(n, 4)) if message[field].dtype.kind == "f" else draw.integers(0, 4, (n, 4))
            )
            message[field] = np.where(received, drawn, 0)
        inputs = Inputs(draw.random((n, SENSORS)) < 0.1, None, Inbox(received, message))
        changed, speed, said = reference(firmware.parameters, state, inputs)
        after, outputs = firmware.step(state, inputs)
        assert after.keys() == state.keys()
        for part, values in after.items():
            expected = np.asarray(changed.get(part, state[part]))
            assert values.dtype == state[part].dtype
            assert values.tobytes() == expected.astype(values.dtype).tobytes(), (tick, part)
        assert outputs.speed_m_s.tobytes() == speed.tobytes()
        assert outputs.outbox is not None
        assert outputs.outbox.sent.all()
        for k, field in enumerate(firmware.message.names or ()):
            assert (outputs.outbox.message[field] == said[:, k, None]).all(), (tick, field)
        state = after


@pytest.mark.parametrize("name", [*PROGRAMS, "velocity_field"])
def test_the_records_of_a_program_have_the_fields_of_its_state_parameters_and_messages(name: str) -> None:
    parameters = {"field": FIELD} if name == "velocity_field" else PROGRAMS[name][1]
    firmware = load(CellsSpec(firmware=name, parameters=parameters))
    assert isinstance(firmware, ScalarFirmware)
    kernels = firmware.scalar_kernels()
    state = firmware.init(cells_of(Lattice([(0, 0), (0, 1)]), SENSORS))
    assert set(kernels.STATE.names or ()) == state.keys()
    for field, values in state.items():
        kind = np.dtype(np.uint8) if values.dtype == np.bool_ else values.dtype
        assert kernels.STATE[field].base == kind
        assert kernels.STATE[field].shape == values.shape[1:]
    assert firmware.constants().keys() <= set(kernels.PARAMETERS.names or ())
    assert firmware.message is None or firmware.message == kernels.MESSAGE
