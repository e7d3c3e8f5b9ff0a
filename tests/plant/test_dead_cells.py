"""Whose wheels nobody drives, on a plant that only keeps books."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from plant.dead_cells import DeadCells
from plant.faults.base import WheelFaults
from plant.wheels import Floats, LossPolicy

DRIVES = np.arange(1.0, 9.0).reshape(4, 2)


@dataclass
class BookPlant:
    """Notes the calls that it receives."""

    log: list[Any] = field(default_factory=list)

    def release_wheels(self, cells: Sequence[int], policy: LossPolicy) -> None:
        self.log.append((policy, tuple(cells)))

    def engage_wheels(self, cells: Sequence[int]) -> None:
        self.log.append(("engage_wheels", tuple(cells)))

    def apply_faults(self, wheel_faults: WheelFaults, drives: Floats) -> None:
        self.log.append(("apply_faults", drives[:, 0].tolist()))


def faults_of(*dead: int, gone: Sequence[int] = (), **rests: LossPolicy) -> WheelFaults:
    made = WheelFaults.healthy(4)
    made.dead[list(dead)] = True
    made.gone[list(gone)] = True
    made.wheel_policies = {int(cell[1:]): policy for cell, policy in rests.items()}
    return made


@pytest.fixture
def plant() -> BookPlant:
    return BookPlant()


def given(undriven: DeadCells) -> list[float]:
    """Drives along x where all cells drive 9."""
    return undriven.override_drives(np.full((4, 2), 9.0))[:, 0].tolist()


def test_drives_are_the_cells_own_where_nobody_ever_went(plant: BookPlant) -> None:
    undriven = DeadCells(plant, 4, "hold")
    assert undriven.override_drives(DRIVES) is DRIVES


def test_a_fault_s_own_word_on_dead_wheels_goes_before_the_policy(plant: BookPlant) -> None:
    undriven = DeadCells(plant, 4, "coast", {2: "hold"})
    undriven.on_transition(faults_of(0, 1, c1="brake"), DRIVES)
    assert undriven.mark_dead([2, 3], DRIVES) == (2, 3)
    assert [entry for entry in plant.log if entry[0] != "apply_faults"] == [
        ("brake", (1,)), ("coast", (0,)), ("coast", (3,)), ("hold", (2,)),
    ]  # fmt: skip
    assert given(undriven) == [0.0, 0.0, 5.0, 0.0]


def test_a_cell_with_two_faults_follows_the_remaining_one(plant: BookPlant) -> None:
    undriven = DeadCells(plant, 4, "coast")
    undriven.on_transition(faults_of(1, c1="hold"), DRIVES)
    assert given(undriven) == [9.0, 3.0, 9.0, 9.0]
    undriven.on_transition(faults_of(1, c1="brake"), DRIVES)
    assert given(undriven) == [9.0, 0.0, 9.0, 9.0]
    undriven.on_transition(faults_of(), DRIVES)
    assert given(undriven) == [9.0] * 4
    assert [entry for entry in plant.log if entry[0] != "apply_faults"] == [
        ("hold", (1,)), ("engage_wheels", (1,)), ("brake", (1,)), ("engage_wheels", (1,)),
    ]  # fmt: skip


def test_cells_that_are_gone_get_no_drive_and_are_not_dead(plant: BookPlant) -> None:
    undriven = DeadCells(plant, 4, "hold")
    assert undriven.on_transition(faults_of(gone=[0, 3]), DRIVES)
    assert not undriven.on_transition(faults_of(gone=[0, 3]), DRIVES)
    assert given(undriven) == [0.0, 9.0, 9.0, 0.0]
    assert not undriven.lost.any()
    assert undriven.on_transition(faults_of(), DRIVES)
    assert given(undriven) == [9.0] * 4
    assert {entry[0] for entry in plant.log} == {"apply_faults"}


def test_a_held_wheel_forgets_its_drive_when_its_cell_is_pulled(plant: BookPlant) -> None:
    undriven = DeadCells(plant, 4, "hold")
    undriven.on_transition(faults_of(2), DRIVES)
    undriven.on_transition(faults_of(2, gone=[2]), DRIVES)
    undriven.on_transition(faults_of(2), DRIVES)
    assert given(undriven) == [9.0, 9.0, 0.0, 9.0]
    assert [entry[1] for entry in plant.log if entry[0] == "apply_faults"] == [
        [1.0, 3.0, 5.0, 7.0], [1.0, 3.0, 0.0, 7.0], [1.0, 3.0, 0.0, 7.0],
    ]  # fmt: skip


def test_the_dead_for_good_stay_dead_whatever_faults_end(plant: BookPlant) -> None:
    undriven = DeadCells(plant, 4, "brake")
    undriven.on_transition(faults_of(0), DRIVES)
    undriven.mark_dead([0], DRIVES)
    assert undriven.about_to_die(faults_of(0, 1)) == [1]
    undriven.on_transition(faults_of(), DRIVES)
    assert given(undriven)[0] == 0.0
    assert ("engage_wheels", (0,)) not in plant.log


def test_a_cell_that_comes_back_is_driven_again_unless_a_fault_kills_it(plant: BookPlant) -> None:
    undriven = DeadCells(plant, 4, "hold")
    undriven.mark_dead([0, 1], DRIVES)
    undriven.on_transition(faults_of(1, gone=[2]), DRIVES)
    undriven.revive([0, 1])
    assert not undriven.lost.any()
    assert given(undriven) == [9.0, 3.0, 0.0, 9.0]
    assert plant.log[-1] == ("engage_wheels", (0,))
    undriven.on_transition(faults_of(), DRIVES)
    assert given(undriven) == [9.0] * 4


def test_who_is_dead_already_does_not_die_again(plant: BookPlant) -> None:
    undriven = DeadCells(plant, 4, "coast", {0: "hold"})
    assert undriven.mark_dead([], DRIVES) == ()
    assert undriven.mask is None
    assert undriven.mark_dead([0], DRIVES) == (0,)
    assert undriven.mark_dead([0], DRIVES * 2.0) == ()
    assert undriven.about_to_die(faults_of(0, 2)) == [2]
    undriven.on_transition(faults_of(0, 1), DRIVES)
    assert undriven.about_to_die(faults_of(0, 1, 2)) == [2]
    assert [entry for entry in plant.log if entry[0] != "apply_faults"] == [("hold", (0,)), ("coast", (1,))]
    assert given(undriven) == [1.0, 0.0, 9.0, 9.0]


def test_a_cell_that_came_back_and_dies_again_holds_nothing_of_its_first_death(plant: BookPlant) -> None:
    undriven = DeadCells(plant, 4, "coast", {0: "hold"})
    undriven.mark_dead([0], DRIVES)
    undriven.revive([0])
    undriven.on_transition(faults_of(0), DRIVES)
    assert given(undriven)[0] == 0.0


def test_a_cell_whose_fault_goes_on_knows_nothing_of_those_that_turn(plant: BookPlant) -> None:
    undriven = DeadCells(plant, 4, "hold")
    undriven.on_transition(faults_of(0), DRIVES)
    undriven.on_transition(faults_of(0, 1), DRIVES * 2.0)
    assert given(undriven) == [1.0, 6.0, 9.0, 9.0]
    assert [entry for entry in plant.log if entry[0] != "apply_faults"] == [("hold", (0,)), ("hold", (1,))]
