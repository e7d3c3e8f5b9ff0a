"""When scheduled faults act."""

from __future__ import annotations

from typing import Any

import pytest

from deploy.errors import InputError
from deploy.faults.schedule import deaths
from deploy.overrides import Override
from deploy.scene import Scene
from deploy.scene_files import load_scene


def _scene(*crashes: tuple[float, tuple[int, int]]) -> Scene:
    faults: list[dict[str, Any]] = [
        {"kind": "crash", "at_s": at_s, "cell": list(cell)} for at_s, cell in crashes
    ]
    return load_scene("motors", [Override(("faults",), faults, "")])


def test_a_crash_acts_at_the_first_tick_that_does_not_begin_before_it() -> None:
    period_s = 0.004096
    scene = _scene((0.0, (0, 0)), (period_s, (0, 1)), (period_s + 1e-9, (0, 3)), (1e-9, (1, 0)))
    assert deaths(scene) == {0: (0,), 1: (1, 3), 2: (2,)}


def test_a_cell_that_is_to_crash_twice_dies_the_first_time() -> None:
    assert deaths(_scene((2.0, (0, 0)), (1.0, (0, 0)), (3.0, (0, 0)))) == {245: (0,)}


def test_a_scene_without_faults_schedules_nothing() -> None:
    assert deaths(load_scene("motors")) == {}


def test_a_fault_of_an_unknown_kind_is_bad_input() -> None:
    with pytest.raises(InputError, match=r"faults\[0\]\.kind"):
        load_scene("motors", [Override(("faults",), [{"kind": "melt", "at_s": 0, "cell": [0, 0]}], "")])
