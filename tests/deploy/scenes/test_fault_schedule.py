"""When scheduled faults act."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from bus.fault import FaultInstance
from cell_firmware.faults.base import ExecutionFaults
from cell_firmware.faults.kinds.reboot import RebootFault
from deploy.errors import InputError
from deploy.faults.crash import CrashFault
from deploy.faults.modules import AbsentModuleFault, AddFault, RemoveFault
from deploy.scenes.fault_schedule import (
    active,
    cell_only_faults,
    crash_wheel_policies,
    in_run_faults,
    instances,
    is_permanent_crash,
    of_cells,
    of_plant,
    permanent_crashes,
)
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from plant.faults.base import WheelFaults


def _scene(*crashes: tuple[float, tuple[int, int]]) -> Scene:
    faults: list[dict[str, Any]] = [
        {"kind": "crash", "at_s": at_s, "cell": list(cell)} for at_s, cell in crashes
    ]
    return _with(*faults)


def _with(*faults: dict[str, Any]) -> Scene:
    return load_scene("motors", [Override(("faults",), list(faults), "")])


def test_a_crash_acts_at_the_first_tick_that_does_not_begin_before_it() -> None:
    period_s = 0.004096
    scene = _scene((0.0, (0, 0)), (period_s, (0, 1)), (period_s + 1e-9, (0, 3)), (1e-9, (1, 0)))
    assert permanent_crashes(scene) == {0: (0,), 1: (1, 3), 2: (2,)}


def test_a_cell_that_is_to_crash_twice_dies_the_first_time() -> None:
    assert permanent_crashes(_scene((2.0, (0, 0)), (1.0, (0, 0)), (3.0, (0, 0)))) == {245: (0,)}


def test_a_scene_without_faults_schedules_nothing() -> None:
    assert permanent_crashes(load_scene("motors")) == {}


def test_a_fault_of_an_unknown_kind_is_bad_input() -> None:
    with pytest.raises(InputError, match=r"faults\[0\]\.kind"):
        load_scene("motors", [Override(("faults",), [{"kind": "melt", "at_s": 0, "cell": [0, 0]}], "")])


MIXED: tuple[dict[str, Any], ...] = (
    {"at_s": 2.0, "cell": [0, 1], "wheels": "hold"},
    {"kind": "hang", "at_s": 1.0, "cell": [0, 0]},
    {"at_s": 1.0, "cells": [[0, 1], [0, 0]], "wheels": "brake"},
    {"at_s": 0.5, "until_s": 0.6, "cell": [1, 0], "wheels": "hold"},
    {"kind": "wheel_stuck", "at_s": 1.0, "cell": [0, 0]},
    {"at_s": 0.1, "cell": [1, 1]},
)


def test_only_crashes_that_are_scheduled_and_not_repaired_are_deaths() -> None:
    scene = _with(*MIXED)
    assert permanent_crashes(scene) == {25: (4,), 245: (0, 1)}
    assert [one.number for one in in_run_faults(scene)] == [1, 3, 4]
    assert is_permanent_crash(FaultInstance(0, CrashFault(cell=(0, 0)), np.array([0]), 5))
    assert not is_permanent_crash(FaultInstance(0, CrashFault(cell=(0, 0)), np.array([0]), 5, 9))
    assert not is_permanent_crash(
        FaultInstance(0, CrashFault(cell=(0, 0)), np.array([0]), 5, injected_at_runtime=True)
    )


def test_cells_die_in_the_order_of_their_ticks_and_of_the_array() -> None:
    scene = _scene((2.0, (0, 0)), (1.0, (1, 0)), (1.0, (0, 1)))
    assert list(permanent_crashes(scene).items()) == [(245, (1, 3)), (489, (0,))]


def test_wheels_of_the_dead_do_what_the_fault_says_that_killed_them() -> None:
    assert crash_wheel_policies(_with(*MIXED)) == {0: "brake", 1: "brake"}
    both = [{"at_s": 1.0, "cell": [0, 0], "wheels": wheels} for wheels in ("hold", "brake")]
    assert crash_wheel_policies(_with(*both)) == {0: "hold"}


def test_each_side_carries_out_its_own() -> None:
    lasts = in_run_faults(_with(*MIXED))
    assert [one.number for one in of_cells(lasts)] == [1, 3]
    assert [one.number for one in of_plant(lasts)] == [3, 4]
    assert cell_only_faults(_with(*MIXED)) == ["faults[1] (hang)"]


def test_a_plant_without_wheel_faults_has_no_fault_schedule() -> None:
    scene = _with(*MIXED[:3])
    assert active(scene) is None
    faults = active(_with(*MIXED))
    assert faults is not None
    assert faults.transitions == [123, 147, 245]
    assert active(_with(*MIXED), in_run_faults(scene)) is None


def test_what_is_added_is_away_from_the_first_tick_to_its_own() -> None:
    (one,) = instances(_with({"kind": "add", "at_s": 1.0, "cell": [0, 1]}))
    assert (one.start_tick, one.end_tick, one.cells.tolist()) == (0, 245, [1])


def test_a_reboot_lasts_as_its_decimals_say() -> None:
    (one,) = instances(_with({"kind": "reboot", "at_s": 0.1, "delay_s": 0.2, "cell": [0, 1]}))
    assert (one.start_tick, one.end_tick) == (25, 74)
    fault = RebootFault(at_s=0.1, delay_s=0.2, cell=(0, 1))
    assert fault.tick_range(lambda at_s: math.ceil(Fraction(repr(at_s)) * 1_000)) == (100, 300)


ABSENT = [RemoveFault(kind="remove", cell=(0, 1)), AddFault(kind="add", at_s=1.0, cell=(0, 1))]


@pytest.mark.parametrize("fault", [CrashFault(cell=(0, 1)), *ABSENT], ids=lambda fault: fault.kind_name)
def test_programs_of_removed_cells_halt_and_restart_when_the_cells_return(
    fault: CrashFault | AbsentModuleFault,
) -> None:
    one = FaultInstance(0, fault, np.array([1]), 5, 7)
    seen: list[tuple[list[bool], ...]] = []
    for tick in (4, 5, 6, 7, 8):
        pause = ExecutionFaults.none(3)
        fault.execution(tick, one, pause)
        assert not pause.outputs_held.any()
        assert not pause.watchdog_unserved.any()
        seen.append((pause.halted.tolist(), pause.reset.tolist()))
    none, affected = [False] * 3, [False, True, False]
    assert seen == [(none, none), (affected, none), (affected, none), (none, affected), (none, none)]
    pause = ExecutionFaults.none(3)
    pause.reset[:] = True
    fault.execution(4, one, pause)
    assert pause.reset.all()


def test_who_is_pulled_is_gone_and_who_crashed_is_dead() -> None:
    for fault in ABSENT:
        wheel_faults = WheelFaults.healthy(3)
        fault.apply(np.array([1]), wheel_faults)
        assert (wheel_faults.gone.tolist(), wheel_faults.dead.any()) == ([False, True, False], False)
    wheel_faults = WheelFaults.healthy(3)
    CrashFault(cell=(0, 1)).apply(np.array([1]), wheel_faults)
    CrashFault(cell=(0, 2), wheels="hold").apply(np.array([2]), wheel_faults)
    assert (wheel_faults.dead.tolist(), wheel_faults.gone.any()) == ([False, True, True], False)
    assert wheel_faults.wheel_policies == {2: "hold"}
