from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.effects.registry import CellEffects
from cell_firmware.errors import ParametersError
from cell_firmware.protocols.max_consensus import MaxConsensus, MaxConsensusParameters


def election(**parameters: Any) -> MaxConsensus:
    return MaxConsensus(MaxConsensusParameters.model_validate(parameters))


def agreed(leader: np.ndarray, cell: tuple[int, int]) -> np.ndarray:
    """``(ticks,)``: do all cells name this one?"""
    return (leader == np.array(cell)).all(axis=(1, 2))


def walk(lattice: Lattice, cell: tuple[int, int]) -> list[int]:
    """Steps from a cell to every other, by a queue."""
    steps = {lattice.index(cell): 0}
    waiting = list(steps)
    for i in waiting:
        for j in lattice.neighbours[i].tolist():
            if j >= 0 and j not in steps:
                steps[j] = steps[i] + 1
                waiting.append(j)
    return [steps[i] for i in range(len(lattice))]


def test_a_cell_knows_the_leader_after_as_many_ticks_as_it_is_steps_away(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(5, 7, missing=[(0, 3), (1, 3), (2, 3), (3, 3)])
    firmware = election(ranks=[{"cell": [0, 2], "rank": 7}, {"rows": [4, 4], "rank": -2}])
    leader = watch(firmware, lattice, 20)
    knows = (leader == [0, 2]).all(axis=2)
    steps = np.array(walk(lattice, (0, 2)))
    assert (knows == (np.arange(20)[:, None] >= steps)).all()
    theory = firmware.theory(lattice)
    assert theory.ticks == steps.max() == 12
    assert (theory.limit == [0, 2]).all()


def test_among_equals_the_last_in_the_arrays_order_leads_in_every_part(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice = grid(3, 7, missing=[(r, 3) for r in range(3)])
    leader = watch(election(), lattice, 12)[-1]
    assert (leader == np.where(lattice.columns[:, None] < 3, [2, 2], [2, 6])).all()
    assert (election().theory(lattice).limit == leader).all()


@pytest.mark.parametrize(("delay", "slower"), [(0, 1), (2, 3)])
def test_a_leader_that_dies_is_forgotten_and_the_next_one_is_known_within_the_stated_time(
    delay: int, slower: int, grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice, lifetime, dies = grid(4, 6), 30, 60
    effects = CellEffects.model_validate({"link_delay": {"ticks": delay}})
    leader = watch(election(lifetime=lifetime), lattice, 300, dead={dies: [(3, 5)]}, effects=effects)
    living = np.arange(24) != 23
    found = agreed(leader[:, living], (3, 4))
    bound = dies + slower * (lifetime + 1 + max(walk(lattice, (3, 4))))
    assert found[bound:].all()
    assert not found[dies + lifetime // 2]
    assert agreed(leader, (3, 5))[dies - 1]


def test_a_leader_remains_where_messages_get_lost(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    effects = CellEffects.model_validate({"link_loss": {"probability": 0.4}})
    leader = watch(election(lifetime=60), grid(4, 6), 400, effects=effects, seed=2)
    known = agreed(leader, (3, 5))
    assert known[40:].all()
    assert not known[7]


def test_a_lifetime_shorter_than_the_path_is_warned_of_and_the_far_cells_follow_others(
    grid: Callable[..., Lattice], watch: Callable[..., Any]
) -> None:
    lattice, firmware = grid(1, 9), election(lifetime=5, ranks=[{"cell": [0, 0], "rank": 1}])
    (warning,) = firmware.warnings(lattice)
    assert (
        "the propagation of the leader's key, 8 ticks: 3 cells that are farther away lose the key" in warning
    )
    leader = watch(firmware, lattice, 40)[-1, :, 1]
    assert (leader[:6] == 0).all()
    assert (leader[6:] != 0).all()
    assert election(lifetime=8).warnings(lattice) == ()


def test_the_word_of_a_leader_that_is_gone_dies_out_at_the_greatest_age_that_there_is(
    grid: Callable[..., Lattice], lockstep: type[Any]
) -> None:
    """Cells begin with a leader that none of them is, near an age of 65,535: it doesn't begin again at 0."""
    steps = lockstep(election(lifetime=65_534), Partition.even(grid(2, 3), 1))
    steps.step()
    shard = steps.shards[0]
    program = dict(shard._memory["firmware"])
    phantom = {
        "key": np.full(6, 9 << 32),
        "age": np.full(6, 65_530),
        "leader": np.zeros((6, 2), dtype=np.int64),
    }
    shard._memory = {"firmware": {**program, **phantom}}
    found = []
    for _ in range(10):
        steps.step()
        found.append(shard.registers()[1]["firmware.leader"].tolist())
    assert found[3] == [[0, 0]] * 6
    assert found[-1] == [[1, 2]] * 6


def test_the_leaders_wheels_run_and_no_others_however_the_array_is_cut(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice, firmware = grid(3, 4), election(speed_m_s=[0.1, 0.2])
    drives = run(firmware, Partition.even(lattice, 1), 8).drives
    assert drives[-1].tolist() == [[0.0, 0.0]] * 11 + [[0.1, 0.2]]
    assert run(firmware, Partition.each(lattice), 8).drives.tobytes() == drives.tobytes()


def test_places_that_do_not_exist_are_reported(grid: Callable[..., Lattice]) -> None:
    with pytest.raises(ParametersError, match=r"ranks\[0\]\.cell: the array has no cell \[5, 5\]"):
        election(ranks=[{"cell": [5, 5], "rank": 1}]).check(grid(2, 2))
