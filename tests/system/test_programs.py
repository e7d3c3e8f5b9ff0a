"""Programs with one planted fault each: exit status and message of ``mdms run``."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.system.planted import KINDS, Planted, carry_out

SEEDS = [seed for seed in range(22) if KINDS[seed % len(KINDS)] != "long sleep"]
"""Of programs that cost no time: ``tests/benchmarks/deploy/planted_faults.py`` has the others too."""


@pytest.mark.parametrize("seed", SEEDS)
def test_a_program_with_a_fault_ends_the_run_with_the_right_status_and_message(
    seed: int, tmp_path: Path
) -> None:
    planted = Planted.drawn(seed)
    assert carry_out(planted, tmp_path) == [], planted


def test_the_programs_are_of_both_forms_and_run_in_one_process_and_in_several() -> None:
    drawn = [Planted.drawn(seed) for seed in SEEDS]
    assert {one.form for one in drawn} == {"cell", "array"}
    assert {one.isolated for one in drawn} == {True, False}
    assert {one.way[1] for one in drawn} > {"0", "2"}
