"""What ``pytest --nightly`` has more than the other tiers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.fuzz.conftest import counted
from tests.plant.test_effects_absent import COMPARED, SOLVERS
from tests.system.test_process_faults import NIGHTLY, QUICK, SLOW

ROOT = Path(__file__).resolve().parents[1]


def collected(*arguments: str) -> list[str]:
    """Tests that pytest would run."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "--collect-only", "-q", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        env={**os.environ, "PYTEST_ADDOPTS": "-p no:cacheprovider"},  # whose options decide what is printed
    )
    return [line for line in done.stdout.splitlines() if "::" in line]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "schedules", "policies", "compared"),
    [
        ((), QUICK, 0, []),
        (("-m", "slow"), SLOW - QUICK, 3, ["-".join(COMPARED)]),
        (("--nightly",), NIGHTLY, 3, ["-".join(SOLVERS)]),
        (("--nightly", "-m", "slow"), NIGHTLY - QUICK, 3, ["-".join(SOLVERS)]),
    ],
)
def test_each_tier_has_its_schedules_policies_and_solvers(
    arguments: tuple[str, ...], schedules: int, policies: int, compared: list[str]
) -> None:
    files = ("system/test_process_faults.py", "system/test_same_digest.py", "plant/test_effects_absent.py")
    found = collected(*arguments, *(f"tests/{file}" for file in files))
    assert sum("test_a_random_schedule" in name for name in found) == schedules
    assert sum("test_scheduled_crashes_act_alike" in name for name in found) == policies
    kernels = [name for name in found if "test_kernels_without_effects" in name]
    assert [name.partition("[")[2].rstrip("]") for name in kernels] == compared


@pytest.mark.parametrize(("seconds", "number"), [(0.0, 3), (2.0, 4), (10.0, 12)])
def test_a_fuzzer_goes_on_until_its_rounds_and_its_time_are_over(seconds: float, number: int) -> None:
    now = iter(range(100))
    assert len(list(counted(3, seconds, lambda: float(next(now))))) == number
