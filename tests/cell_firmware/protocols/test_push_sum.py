"""Push-sum: the matrix of theory tick by tick, outages, deaths, and values that running sums can't carry."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError
from cell_firmware.protocols.push_sum import PushSum, PushSumParameters
from cell_firmware.scalar_program import PYTHON
from mdms import Lab
from mdms.kit import MODULUS


@pytest.fixture(autouse=True)
def _in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON, "1")


VALUES = {"values": [{"cell": [0, 0], "value": 9.0}, {"columns": [2, 2], "value": -3.0}], "value": 1.0}


def push_sum(**parameters: Any) -> PushSum:
    return PushSum(PushSumParameters.model_validate(parameters))


def test_every_tick_is_the_power_of_the_matrix_of_equal_shares_and_the_factor_is_its_second_eigenvalue() -> (
    None
):
    lab = Lab("push_sum", (3, 3), parameters=VALUES)
    neighbours = lab.lattice.neighbours
    shares = np.eye(9)
    for cell, side in zip(*np.nonzero(neighbours >= 0), strict=True):
        shares[neighbours[cell, side], cell] = 1.0
    shares /= shares.sum(axis=0)
    value = np.array([9.0, 1, -3, 1, 1, -3, 1, 1, -3])
    mass, weight = value, np.ones(9)
    for _ in range(40):
        np.testing.assert_allclose(lab.step().registers["estimate"], mass / weight, atol=1e-8)
        mass, weight = shares @ mass, shares @ weight
    theory = push_sum(**VALUES).theory(lab.lattice)
    assert theory.factor == pytest.approx(np.sort(abs(np.linalg.eigvals(shares)))[-2], rel=1e-9)
    assert theory.limit is not None
    np.testing.assert_allclose(theory.limit, value.mean())


def test_after_an_outage_longer_than_the_validity_the_mean_is_still_that_of_all_values() -> None:
    lab = Lab("push_sum", (1, 3), parameters={**VALUES, "ttl_periods": 4}).step(3)
    lab.cut((0, 1), "east", 30)
    lab.step(29)
    assert abs(lab.registers["estimate"] - 7.0 / 3.0).max() > 1.0
    lab.step(60)
    np.testing.assert_allclose(lab.registers["estimate"], 7.0 / 3.0, atol=1e-6)


def test_after_a_death_the_others_agree_on_a_number_in_the_range_of_values() -> None:
    lab = Lab("push_sum", (2, 3), parameters=VALUES).step(2)
    lab.kill((0, 0))
    lab.step(150)  # conditions of the program are due by then
    estimate = lab.registers["estimate"][1:]
    assert np.ptp(estimate) < 1e-5
    assert -3.0 < estimate[0] < 9.0


def test_messages_that_are_late_out_of_order_doubled_and_lost_leave_the_mean_as_it_is() -> None:
    ends = {"at_tick": 1, "until_tick": 40, "share": 1.0}
    faults = [
        {"kind": "link_delay", "between_ticks": [0, 5], "ordered": False, **ends},
        {"kind": "link_duplicate", "probability": 0.4, **ends},
        {"kind": "link_loss", "probability": 0.2, **ends},
    ]
    lab = Lab("push_sum", (2, 3), parameters=VALUES, faults=faults)  # its ledger and range hold in every tick
    lab.step(40)
    assert abs(lab.registers["estimate"] - 1.0).max() > 1e-3
    lab.step(60)
    np.testing.assert_allclose(lab.registers["estimate"], 1.0, atol=1e-6)


def test_running_sums_wrap() -> None:
    names = ("pushed_mass", "pushed_weight", "seen_mass", "seen_weight")
    near = {name: [MODULUS - 2] * 4 for name in names}
    labs = [Lab("push_sum", (2, 3), parameters=VALUES, initial_registers=begun) for begun in ({}, near)]
    plain, wrapped = (lab.record("estimate", 30) for lab in labs)
    np.testing.assert_array_equal(plain, wrapped)
    assert (labs[1].registers["pushed_mass"].min(axis=1) < MODULUS - 2).any()


def test_wheels_run_at_the_estimate_within_the_range_of_values_whatever_messages_bring() -> None:
    lab = Lab("push_sum", (1, 2), parameters={"value": 2.0, "velocity_m_s": [0.1, -0.05]}, check=None).step(2)
    np.testing.assert_allclose(lab.drives, [[0.2, -0.1]] * 2)
    lab.inbox[(0, 0), "east"] = {"mass": 2**54, "weight": 2**34}
    lab.step()
    assert lab.registers["estimate", (0, 0)] > 1e5
    np.testing.assert_allclose(lab.drives, [[0.2, -0.1]] * 2)


def test_values_that_running_sums_can_not_carry_are_refused() -> None:
    lattice = Lattice([(0, 0), (0, 1)])
    push_sum(value=2.0**21).check(lattice)
    with pytest.raises(
        ParametersError, match="values: the amounts of all values must not sum to more than 4194304"
    ):
        push_sum(value=2.0**21 + 1).check(lattice)
