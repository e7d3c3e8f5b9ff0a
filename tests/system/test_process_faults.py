"""Whatever happens to the processes of a run, it ends as stated, leaves nothing, and can be repeated.

``python tests/benchmarks/deploy/process_faults.py`` does the same with as many schedules as one likes.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.system.schedules import Schedule, carry_out


@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    "seed", [seed if seed < 4 else pytest.param(seed, marks=pytest.mark.slow) for seed in range(20)]
)
def test_a_random_schedule_of_kills_and_stops_ends_as_stated(seed: int, tmp_path: Path) -> None:
    assert carry_out(Schedule.drawn(seed), tmp_path).wrong == ()


def test_schedules_are_of_every_kind() -> None:
    drawn = [Schedule.drawn(seed) for seed in range(20)]
    assert {schedule.policy for schedule in drawn} >= {"coast", "brake", "hold"}
    assert {blow.action for schedule in drawn for blow in schedule.blows} == {
        "kill",
        "stop",
        "stop the plant",
    }
    assert any(schedule.respawn for schedule in drawn)
    assert Schedule.drawn(7) == Schedule.drawn(7)
