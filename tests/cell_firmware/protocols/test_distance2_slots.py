"""Slots of a frame: apart at distance two, closed under losses, the longest chain, draws."""

from __future__ import annotations

from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
from pydantic import ValidationError

from bus.lattice import Lattice
from cell_firmware.protocols.distance2_slots import (
    Distance2Slots,
    Distance2SlotsParameters,
    clashes,
    longest_chain,
)
from cell_firmware.scalar_program import PYTHON
from deploy.errors import InputError
from deploy.studies.adversary.check import world_scene
from mdms import Lab
from tests.cell_firmware.kit.trials import Arrays, graph_of


@pytest.fixture(autouse=True)
def _in_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON, "1")


def test_clashes_and_the_longest_chain_are_those_of_the_square_of_the_graph() -> None:
    draw = np.random.default_rng(3)
    for cells in Arrays(range(20)).each:
        lattice, slot = Lattice(cells), draw.integers(0, 9, len(cells))
        square = nx.power(graph_of(cells), 2)
        expected = [
            any(slot[lattice.index(there)] == slot[i] for there in square[cell])
            for i, cell in enumerate(cells)
        ]
        assert clashes(slot, lattice.neighbours).tolist() == expected
        pointed = nx.DiGraph((min(pair), max(pair)) for pair in square.edges)
        chain = longest_chain(lattice)
        assert chain == nx.dag_longest_path_length(pointed)
        assert chain <= np.ptp(lattice.columns) + 2 * np.ptp(lattice.rows)
        assert Distance2Slots(Distance2SlotsParameters()).theory(lattice).ticks == 2 * (chain + 1) + 1


@pytest.mark.parametrize("choice", ["least", "random"])
def test_slots_once_apart_stay_whatever_gets_lost(choice: str) -> None:
    lab = Lab("distance2_slots", (3, 4), parameters={"choice": choice, "ttl_periods": 2}).step(40)
    slots, moves = lab.registers["slot"], lab.registers["moves"]
    assert moves.max() > 0
    lab.inject("link_loss", probability=0.7, share=1.0)
    lab.step(40)
    assert (lab.registers["slot"] == slots).all()
    assert (lab.registers["moves"] == moves).all()


def test_the_first_free_slots_make_a_short_frame_and_random_ones_depend_on_the_seed() -> None:
    def found(choice: str, seed: int) -> list[int]:
        return (
            Lab("distance2_slots", (3, 4), parameters={"choice": choice}, seed=seed)
            .step(25)
            .registers["slot"]
            .tolist()
        )

    assert max(found("least", 1)) < 8
    assert found("least", 1) == found("least", 2)
    assert found("random", 1) == found("random", 1)
    assert all(a != b for a, b in pairwise(found("random", seed) for seed in (1, 2, 3)))


def test_a_frame_must_have_a_slot_more_than_there_are_cells_around() -> None:
    with pytest.raises(ValidationError, match="greater than 12"):
        Distance2SlotsParameters(slots=12)
    lab = Lab("distance2_slots", (3, 5), parameters={"slots": 13, "choice": "random"})
    lab.step(35)  # conditions of the program are due by then


def test_a_search_takes_the_first_free_slots_alone() -> None:
    world_scene("distance2_slots", (1, 2))
    with pytest.raises(InputError, match=r"draws random numbers \(slot\)"):
        world_scene("distance2_slots", (1, 2), parameters={"choice": "random"})
