"""Whatever happens to the processes of a run, it ends as stated, leaves nothing, and can be repeated.

``python tests/benchmarks/deploy/process_faults.py`` does the same with as many schedules as one likes, and pytest with
200 where it is given ``--nightly``.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.system.schedules import Schedule, carry_out

QUICK, SLOW, NIGHTLY = 1, 12, 200
"""Schedules of each tier, the quicker tiers' included."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Draw as many schedules as the tiers have."""
    if "seed" in metafunc.fixturenames:
        seeds = range(NIGHTLY if metafunc.config.getoption("nightly") else SLOW)
        slow = pytest.mark.slow
        metafunc.parametrize(
            "seed", [seed if seed < QUICK else pytest.param(seed, marks=slow) for seed in seeds]
        )


@pytest.mark.timeout(120)
def test_a_random_schedule_of_kills_and_stops_ends_as_stated(seed: int, tmp_path: Path) -> None:
    assert carry_out(Schedule.drawn(seed), tmp_path).wrong == ()


def test_schedules_are_of_every_kind() -> None:
    drawn = [Schedule.drawn(seed) for seed in range(SLOW)]
    assert {schedule.policy for schedule in drawn} >= {"coast", "brake", "hold"}
    assert {blow.action for schedule in drawn for blow in schedule.blows} == {
        "kill",
        "stop",
        "stop the plant",
    }
    assert any(schedule.respawn for schedule in drawn)
    assert Schedule.drawn(7) == Schedule.drawn(7)
