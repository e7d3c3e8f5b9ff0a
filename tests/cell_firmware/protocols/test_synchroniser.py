"""Synchronous rounds: the bits of heat conduction, pace, silences, restarts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cell_firmware.protocols.synchroniser import Synchroniser, SynchroniserParameters
from cell_firmware.scalar_program import PYTHON
from mdms import Lab


@pytest.fixture(autouse=True)
def _in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON, "1")


VALUES: dict[str, Any] = {"values": [{"cell": [0, 0], "value": 7.0}, {"cell": [1, 2], "value": -1.0}]}
INITIAL = {
    "initial": [{"cell": one["cell"], "speed_m_s": [one["value"], 0.0]} for one in VALUES["values"]],
}


def test_on_perfect_links_it_is_heat_conduction_bit_for_bit_a_round_a_tick() -> None:
    heat, lab = (
        Lab("heat_diffusion", (2, 3), parameters=INITIAL),
        Lab("synchroniser", (2, 3), parameters=VALUES),
    )
    for tick in range(30):
        speed = heat.step().registers["speed_m_s"][:, 0]
        assert lab.step().registers["pulse"].tolist() == [tick] * 6
        assert lab.registers["value"].tobytes() == speed.tobytes()
    theory = Synchroniser(SynchroniserParameters.model_validate(VALUES)).theory(lab.lattice)
    assert theory.factor == pytest.approx(0.8)  # 1 - 0.2, the slowest mode of three cells in a row
    assert theory.limit is not None
    np.testing.assert_allclose(theory.limit, 1.0)


@pytest.mark.parametrize("delay", [1, 3])
def test_a_round_takes_as_many_ticks_as_a_message(delay: int) -> None:
    fault = {"kind": "link_delay", "ticks": delay, "share": 1.0}
    lab = Lab("synchroniser", (2, 3), parameters=VALUES, faults=[fault], check=None).step(60)
    assert set(lab.registers["pulse"].tolist()) == {59 // (1 + delay)}


def test_a_silent_neighbour_is_waited_for_as_long_as_its_messages_are_valid_and_joined_again() -> None:
    lab = Lab("synchroniser", (1, 3), parameters={**VALUES, "values": [], "ttl_periods": 5}).step(10)
    lab.kill((0, 2))
    lab.step(5)
    assert lab.registers["pulse"][:2].tolist() == [11, 10]  # the last word of the dead is of pulse 9
    lab.step(10)
    assert lab.registers["pulse"][:2].min() > 14
    lab.repair((0, 2))
    lab.step(20)
    pulse = lab.registers["pulse"]
    assert np.ptp(pulse) <= 1
    assert pulse.min() > 30


def test_pulses_wrap() -> None:
    lab = Lab(
        "synchroniser", (1, 2), parameters=VALUES | {"values": []}, initial_registers={"pulse": 2**32 - 3}
    )
    assert lab.step(6).registers["pulse"].tolist() == [2, 2]


def test_a_diffusion_number_beyond_its_limit_is_warned_of_and_widens_the_ranges_of_messages() -> None:
    program = Synchroniser(SynchroniserParameters.model_validate({**VALUES, "diffusion_number": 0.6}))
    (warning,) = program.warnings(Lab("max_consensus", (4, 4)).lattice)
    assert warning.startswith("diffusion_number 0.6 is above 1/4")
    assert program.value_ranges()["value"] == (-70.0, 70.0)
    assert Synchroniser(SynchroniserParameters.model_validate(VALUES)).value_ranges()["previous"] == (
        -1.0,
        7.0,
    )
