from collections.abc import Callable, Iterable
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from pydantic import ValidationError

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.effects.link_delay import LinkDelaySpec
from cell_firmware.effects.link_loss import LinkLossSpec
from cell_firmware.effects.registry import CellEffects
from cell_firmware.errors import ParametersError
from cell_firmware.protocols.hop_gradient import HopGradient, HopGradientParameters

SPEED_M_S = 0.2


def hops(goals: Iterable[tuple[int, int]], **parameters: Any) -> HopGradient:
    parameters["goals"] = [{"cell": goal} for goal in goals]
    return HopGradient(HopGradientParameters.model_validate(parameters))


def shortest(
    lattice: Lattice, goals: Iterable[tuple[int, int]], limit: int, dead: Iterable[tuple[int, int]] = ()
) -> NDArray[np.int64]:
    """NetworkX's shortest paths among the living; ``limit`` where there is none."""
    graph: Any = nx.Graph()
    graph.add_nodes_from(lattice.cells)
    ends = zip(*np.nonzero(lattice.neighbours >= 0), strict=True)
    graph.add_edges_from((lattice.cells[i], lattice.cells[lattice.neighbours[i, s]]) for i, s in ends)
    graph.remove_nodes_from(dead)
    left = {goal for goal in goals if goal in graph}
    found: Any = nx.multi_source_dijkstra_path_length(graph, left) if left else {}
    return np.array([min(found.get(cell, limit), limit) for cell in lattice.cells])


def distances(steps: Any) -> NDArray[np.int64]:
    """Of all cells in the lattice's order; -1 where one is dead."""
    found = np.full(len(steps.lattice), -1)
    for shard in steps.shards:
        names, registers = shard.registers()
        found[[steps.lattice.index(tuple(name)) for name in names.tolist()]] = registers["firmware.distance"]
    return found


def settle(steps: Any, ticks: int) -> NDArray[np.int64]:
    for _ in range(ticks):
        steps.step()
    return distances(steps)


def test_distances_are_the_shortest_paths_from_the_tick_that_theory_names(
    grid: Callable[..., Lattice], lockstep: type[Any]
) -> None:
    lattice = grid(7, 9, missing=[(3, 1), (3, 2), (3, 3), (2, 3), (1, 3), (5, 5)])
    places = [{"cell": [1, 2]}, {"rows": [5, 6], "columns": [7, 8]}]
    firmware = HopGradient(HopGradientParameters.model_validate({"goals": places}))
    goals = [(1, 2), (5, 7), (5, 8), (6, 7), (6, 8)]
    theory = firmware.theory(lattice)
    expected = shortest(lattice, goals, 255)
    assert theory.limit is not None
    assert theory.ticks == expected.max()
    assert np.array_equal(theory.limit, expected)
    steps = lockstep(firmware, Partition.even(lattice, 3))
    assert not np.array_equal(settle(steps, theory.ticks), expected)  # ticks 0 to theory.ticks - 1
    assert np.array_equal(settle(steps, 1), expected)


@settings(max_examples=40, deadline=None)
@given(data=st.data(), ttl_periods=st.integers(1, 3))
def test_distances_heal_after_a_tenth_of_the_cells_die_within_the_bound_that_the_page_states(
    data: st.DataObject, ttl_periods: int, grid: Callable[..., Lattice], lockstep: type[Any]
) -> None:
    """In tick T + ttl_periods - 1 + D: T is the first of the dead, D the longest way left, ``limit`` where none is."""
    lattice, limit = grid(8, 8), 70
    goals = data.draw(st.lists(st.sampled_from(lattice.cells), min_size=1, max_size=3, unique=True))
    dead = data.draw(st.lists(st.sampled_from(lattice.cells), min_size=6, max_size=6, unique=True))
    firmware = hops(goals=goals, limit=limit, ttl_periods=ttl_periods)
    steps = lockstep(firmware, Partition.even(lattice, 1))
    settle(steps, 20)
    steps.retire(dead)
    expected = shortest(lattice, goals, limit, dead)
    living = np.array([cell not in dead for cell in lattice.cells])
    last = ttl_periods - 1 + int(expected[living].max(initial=0))
    assert np.array_equal(settle(steps, last + 1)[living], expected[living])


def test_a_count_to_infinity_takes_no_longer_than_the_limit(
    grid: Callable[..., Lattice], lockstep: type[Any]
) -> None:
    """Cells that nothing joins to a goal any more count up together, one a tick, and then say so."""
    lattice, limit = grid(1, 8), 30
    steps = lockstep(hops(goals=[(0, 0)], limit=limit), Partition.even(lattice, 1))
    settle(steps, 10)
    steps.retire([(0, 3)])
    seen = [settle(steps, 1)[4:].min() for _ in range(limit + 1)]
    assert all(later > sooner for sooner, later in zip(seen[:20:2], seen[2:20:2], strict=False))
    assert seen[limit] == limit
    assert np.array_equal(distances(steps)[4:], [limit] * 4)


def test_wheels_drive_towards_the_nearest_neighbour_and_stand_at_goals_and_without_a_path(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice = grid(3, 4, missing=[(0, 1), (1, 1), (2, 1)])  # the left column is cut off
    drive = run(hops(goals=[(2, 3)]), Partition.even(lattice, 1), 8).drives[-1]
    assert drive[lattice.index((0, 2))].tolist() == [0.0, SPEED_M_S]  # north comes before east
    assert drive[lattice.index((0, 3))].tolist() == [0.0, SPEED_M_S]
    assert drive[lattice.index((2, 2))].tolist() == [SPEED_M_S, 0.0]
    assert drive[lattice.index((2, 3))].tolist() == [0.0, 0.0]
    assert not drive[[lattice.index((row, 0)) for row in range(3)]].any()


def test_hops_are_the_same_to_the_last_bit_however_the_array_is_cut(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice = grid(5, 6, missing=[(1, 1)])
    effects = CellEffects(link_loss=LinkLossSpec(probability=0.3))
    dead = {9: [(2, 2), (2, 3)]}
    whole, alone = (
        run(hops(goals=[(0, 0)], ttl_periods=3), partition, 30, dead=dead, effects=effects).drives
        for partition in (Partition.even(lattice, 1), Partition.each(lattice))
    )
    assert whole.tobytes() == alone.tobytes()


def test_over_bad_links_no_distance_is_too_small_once_old_words_are_gone(
    grid: Callable[..., Lattice], lockstep: type[Any]
) -> None:
    """Loss only hides ways, so it makes distances too large, and ttl_periods makes that rare."""
    lattice, ttl_periods, delay = grid(6, 6), 6, 2
    effects = CellEffects(
        link_loss=LinkLossSpec(probability=0.3),
        link_delay=LinkDelaySpec(between_ticks=(0, delay), ordered=False),
    )
    steps = lockstep(hops(goals=[(0, 0)], ttl_periods=ttl_periods), Partition.even(lattice, 1), None, effects)
    settle(steps, 60)
    dead = [(0, 1), (2, 2), (3, 2)]
    steps.retire(dead)
    true = shortest(lattice, [(0, 0)], 255, dead)
    living = np.array([cell not in dead for cell in lattice.cells])
    settle(steps, (ttl_periods + delay) * (int(true[living].max()) + 1))
    wrong = 0
    for _ in range(200):
        found = settle(steps, 1)[living]
        assert (found >= true[living]).all()
        wrong += int((found != true[living]).sum())
    assert wrong < 0.02 * 200 * living.sum()


def test_a_limit_that_is_too_small_is_warned_of_and_what_is_said_happens(
    grid: Callable[..., Lattice], lockstep: type[Any]
) -> None:
    lattice = grid(1, 8)
    firmware = hops(goals=[(0, 0)], limit=5)
    (warning,) = firmware.warnings(lattice)
    assert warning.startswith(
        "limit is 5, and the farthest cell is 7 links from a goal: 3 cells will find no route"
    )
    steps = lockstep(firmware, Partition.even(lattice, 1))
    assert settle(steps, 20).tolist() == [0, 1, 2, 3, 4, 5, 5, 5]
    assert not steps.step()[5:].any()
    assert hops(goals=[(0, 0)], limit=8).warnings(lattice) == ()


def test_counting_up_ends_at_the_greatest_limit_and_does_not_begin_again_at_0(
    grid: Callable[..., Lattice], lockstep: type[Any]
) -> None:
    """Cells that are cut off count up, here from near 65,535, which is all that a distance has room for."""
    steps = lockstep(hops(goals=[(0, 0)], limit=65_535), Partition.even(grid(1, 6), 1))
    settle(steps, 10)
    shard = steps.shards[0]
    program = dict(shard._memory["firmware"])
    for name in ("neighbour", "distance"):
        program[name] = np.full_like(program[name], 65_528)
    shard._memory = {"firmware": program}
    shard._outboxes[-1][1]["distance"] = 65_528
    steps.retire([(0, 0), (0, 1)])
    seen = np.array([settle(steps, 1) for _ in range(20)])[:, 2:]  # the others are dead
    assert seen[0].tolist() == [65_529] * 4
    assert (np.diff(seen, axis=0) >= 0).all()
    assert seen[-1].tolist() == [65_535] * 4


def test_goals_that_do_not_exist_are_all_named(grid: Callable[..., Lattice]) -> None:
    firmware = hops(goals=[(0, 9), (1, 1)])
    with pytest.raises(ParametersError) as caught:
        firmware.check(grid(5, 6, missing=[(1, 1)]))
    assert [str(problem) for problem in caught.value.problems] == [
        "goals[0].cell: the array has no cell [0, 9]",
        "goals[1].cell: the array has no cell [1, 1]",
    ]
    with pytest.raises(ValidationError, match="at least 1 item"):
        hops(goals=[])
