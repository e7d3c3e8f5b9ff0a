"""The kit's protocols compiled and as Python: the same registers, through faults."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cell_firmware.scalar_program import PYTHON
from mdms import Lab

PROTOCOLS: dict[str, dict[str, Any]] = {
    "spanning_tree": {"limit": 14, "ttl_periods": 2, "speed_m_s": 0.1},
    "push_sum": {"values": [{"cell": [1, 1], "value": -5.5}], "velocity_m_s": [0.1, 0.2]},
    "distance2_slots": {},
    "distance2_slots at random": {"choice": "random"},
    "synchroniser": {
        "values": [{"cell": [1, 1], "value": -5.5}],
        "ttl_periods": 4,
        "velocity_m_s": [0.1, 0.2],
    },
}
FAULTS = [
    {"kind": "link_loss", "at_tick": 3, "until_tick": 30, "probability": 0.3, "share": 1.0},
    {
        "kind": "link_delay",
        "at_tick": 5,
        "until_tick": 25,
        "between_ticks": [0, 3],
        "ordered": False,
        "share": 0.5,
    },
    {"kind": "crash", "at_tick": 8, "until_tick": 20, "cell": [0, 0]},
]


@pytest.mark.slow
@pytest.mark.timeout(240)
@pytest.mark.parametrize("name", PROTOCOLS)
def test_compiled_and_python_have_the_same_registers(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def course() -> dict[str, Any]:
        parameters = PROTOCOLS[name]
        lab = Lab(name.partition(" ")[0], (3, 4), parameters=parameters, faults=FAULTS, seed=5, check=None)
        lab.cover((1, 2), (2, 2))
        found: dict[str, Any] = {register: [] for register in ("drives", *lab.registers)}
        for _ in range(45):
            lab.step()
            for register, values in found.items():
                values.append(lab.drives.copy() if register == "drives" else lab.registers[register])
        return found

    compiled = course()
    monkeypatch.setenv(PYTHON, "1")
    plain = course()
    assert compiled.keys() == plain.keys()
    for register, values in plain.items():
        np.testing.assert_array_equal(compiled[register], values, register)
