"""What faults of wheels say of a cell, refuse, and become without motors; and when what is the matter changes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from bus.fault import FaultInstance
from bus.lattice import NO_TICK_LIMIT
from plant.effects.motors import MotorsSpec
from plant.effects.registry import PlantEffects
from plant.faults.base import PlantFault, WheelFaults
from plant.faults.kinds.wheel_reversed import WheelReversedFault
from plant.faults.kinds.wheel_runaway import WheelRunawayFault
from plant.faults.kinds.wheel_stuck import WheelStuckFault
from plant.faults.kinds.wheel_weak import WheelWeakFault
from plant.faults.schedule import FaultSchedule

CELL: dict[str, Any] = {"cell": (0, 0)}
IDEAL, DRIVEN = PlantEffects(), PlantEffects.model_validate({"motors": {}})
LOADED = PlantEffects.model_validate({"motors": {}, "wheel_load": {"inertia_kg": 1.0}})
STUCK = WheelStuckFault(kind="wheel_stuck", cell=(0, 0))


def runaway(speed_m_s: float | None = None) -> WheelRunawayFault:
    return WheelRunawayFault(kind="wheel_runaway", cell=(0, 0), speed_m_s=speed_m_s)


@pytest.mark.parametrize(
    ("wheel", "affected"), [("x", [True, False]), ("y", [False, True]), ("both", [True, True])]
)
def test_a_fault_affects_the_wheel_that_it_names(wheel: Any, affected: list[bool]) -> None:
    wheel_faults = WheelFaults.healthy(2)
    WheelStuckFault(kind="wheel_stuck", cell=(0, 0), wheel=wheel).apply(np.array([1]), wheel_faults)
    assert wheel_faults.stuck.tolist() == [[False, False], affected]


@pytest.mark.parametrize(
    ("fault", "effects", "expected"),
    [
        (runaway(), IDEAL, ["needs speed_m_s"]),
        (runaway(1.0), IDEAL, []),
        (runaway(), DRIVEN, []),
        (runaway(1.0), DRIVEN, ["is for ideal wheels"]),
        (STUCK, DRIVEN, []),
        (STUCK, LOADED, ["does not go with effects.wheel_load"]),
    ],
)
def test_a_fault_is_at_odds_with_effects_in_which_it_can_not_be(
    fault: PlantFault, effects: PlantEffects, expected: list[str]
) -> None:
    rules = [rule for _, _, rule in fault.setting_problems(effects)]
    assert len(rules) == len(expected)
    assert all(rule.startswith(word) for rule, word in zip(rules, expected, strict=True))


def test_a_wheel_is_weak_somehow() -> None:
    for given in ({"strength": 0.5}, {"most_m_s": 0.1}, {"strength": 0.0, "most_m_s": 0.0}):
        WheelWeakFault.model_validate({"kind": "wheel_weak", **CELL, **given})
    with pytest.raises(ValidationError, match="give strength, most_m_s, or both"):
        WheelWeakFault.model_validate({"kind": "wheel_weak", **CELL})


def test_without_motors_a_wheel_runs_away_at_what_the_supply_gives_without_load() -> None:
    motors = MotorsSpec(speed_per_volt_m_s=0.1, coulomb_v=2.0, supply_v=12.0)
    assert runaway().on_ideal_wheels(motors).speed_m_s == pytest.approx(1.0)
    stiff = MotorsSpec(coulomb_v=13.0, supply_v=12.0)
    assert runaway().on_ideal_wheels(stiff).speed_m_s == 0.0
    assert STUCK.on_ideal_wheels(motors) is STUCK


def test_the_scene_s_last_fault_says_where_a_wheel_runs() -> None:
    wheel_faults = WheelFaults.healthy(1)
    for fault in (runaway(1.0), runaway(2.0).model_copy(update={"way": "negative"})):
        fault.apply(np.array([0]), wheel_faults)
    assert wheel_faults.runs_m_s.tolist() == [[-2.0, -2.0]]


def test_something_changes_when_a_fault_begins_or_ends_and_at_no_other_tick() -> None:
    reversed_ = WheelReversedFault(kind="wheel_reversed", cell=(0, 0))
    active = FaultSchedule(
        2, [FaultInstance(0, STUCK, np.array([0]), 3, 7), FaultInstance(1, reversed_, np.array([1]), 0, 8)]
    )
    assert (active.transitions, active.next_transition) == ([0, 3, 7, 8], 0)
    assert active.at_transition(0).factor.tolist() == [[1.0, 1.0], [-1.0, -1.0]]
    live = FaultInstance(2, STUCK, np.array([1]), 2, NO_TICK_LIMIT, injected_at_runtime=True)
    active.add(live)
    active.plan(2)
    assert (active.transitions, active.next_transition) == ([2, 3, 7, 8], 2)
    assert active.at_transition(2).stuck.tolist() == [[False, False], [True, True]]
    assert active.at_transition(3).stuck.all()
    live.end_tick = 5
    active.plan(5)
    assert active.next_transition == 5
    assert active.at_transition(5).stuck.tolist() == [[True, True], [False, False]]
    assert not active.at_transition(7).stuck.any()
    assert active.next_transition == 8
    assert (active.at_transition(8).factor == 1.0).all()
    assert (active.transitions, active.next_transition) == ([], NO_TICK_LIMIT)
    assert active.state_at(6).stuck.tolist() == [[True, True], [False, False]]
