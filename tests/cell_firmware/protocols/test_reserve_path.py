from collections.abc import Callable
from functools import cache
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bus.partition import Partition
from cell_firmware.effects.link_delay import LinkDelaySpec
from cell_firmware.effects.link_loss import LinkLossSpec
from cell_firmware.effects.registry import CellEffects
from cell_firmware.protocols.reserve_path import ReservePath
from cell_firmware.protocols.route import Route
from cell_firmware.tiles.firmware import TileFirmware
from cell_firmware.tiles.tiling import Tile
from tests.cell_firmware.protocols.tile_world import PITCH_M, World

BAD_LINKS = CellEffects(
    link_loss=LinkLossSpec(probability=0.2),
    link_delay=LinkDelaySpec(between_ticks=(0, 2), ordered=False),
)


def firmware_of(kind: type[TileFirmware], lanes: list[str], exits: list[Tile], **others: Any) -> Any:
    tiles = [{"tile": tile, "side": "east"} for tile in exits]
    return kind(kind.Parameters.model_validate({"lanes": lanes, "exits": tiles, **others}))


def sorter(rows: int, turns: str, **others: Any) -> Route:
    """Entries in the west, a column of tiles for each letter of ``turns``, an exit in each row in the east."""
    lanes = [
        " ".join(
            [
                "e",
                *(f"{turn}e" if 0 <= row + (turn == "n") - (turn == "s") < rows else "e" for turn in turns),
                ".",
            ]
        )
        for row in reversed(range(rows))
    ]
    return firmware_of(Route, lanes, [(row, len(turns) + 1) for row in range(rows)], **others)


def reachable(firmware: TileFirmware, entry: Tile) -> list[int]:
    """Numbers of the exits to which lanes lead from a tile, by NetworkX."""
    tiling = firmware.tiling
    graph: Any = nx.DiGraph((tile, to) for tile in tiling.tiles() for to in tiling.onward(tile))
    return sorted(
        int(tiling.exit[tile]) for tile in {entry, *nx.descendants(graph, entry)} if tiling.exit[tile]
    )


@pytest.mark.slow
@settings(max_examples=4, deadline=None)
@given(data=st.data())
def test_on_any_lanes_without_a_ring_all_parcels_come_to_their_exits_and_none_meet(
    data: st.DataObject,
) -> None:
    """Liveness and safety, whatever the lanes, the tiles' size, who comes where and what links do."""
    rows = data.draw(st.just(2), label="rows")
    turns = data.draw(st.text("ns", min_size=1, max_size=2), label="turns")
    firmware = sorter(rows, turns)
    queues = {
        (row, 0): data.draw(
            st.lists(st.sampled_from(reachable(firmware, (row, 0))), min_size=1, max_size=3),
            label=f"entry {row}",
        )
        for row in range(rows)
    }
    all_of_them = sorted(exit_ for queue in queues.values() for exit_ in queue)
    effects = data.draw(st.sampled_from([CellEffects(), BAD_LINKS]), label="links")
    world = World(firmware, queues, effects, seed=data.draw(st.integers(0, 99), label="seed")).run(4000)
    assert world.met == 0
    assert sorted(own for _, own in world.left) == all_of_them
    assert all(exit_ == own for exit_, own in world.left)


def test_parcels_that_are_for_any_exit_take_the_nearest() -> None:
    firmware = firmware_of(ReservePath, ["e e es .", "- - . -"], [(1, 3), (0, 2)])
    world = World(firmware, {(1, 0): [1, 1]}).run(2000)
    assert [exit_ for exit_, _ in world.left] in ([1, 1], [1, 2], [2, 1], [2, 2])
    assert world.met == 0


WRAP = 1 << 16


def near_the_wrap(world: World, versions: bool, rounds: bool) -> World:
    """Tiles' versions or their leaders' rounds as after days: each tile's a few short of 65,536.

    It is done in the tick in which leaders take over: nothing else has been sent by then.
    """
    while not (world.shard.registers()[1]["firmware.pulse"] > 0).any():
        world.run(1)
    side, columns = world.firmware.tiling.side, world.firmware.tiling.shape[1]
    tile = world.lattice.rows // side * columns + world.lattice.columns // side

    def later(values: NDArray[Any], bits: int, tiles: NDArray[np.int64]) -> NDArray[Any]:
        all_bits = values.astype(np.int64)
        number = all_bits >> bits & WRAP - 1
        new = (number + WRAP - 20 - tiles % 12) % WRAP
        moved = all_bits & ~((WRAP - 1) << bits) | new << bits
        return np.where(values > 0, moved, values).astype(values.dtype)

    memory, sent = world.shard._memory, world.shard._outboxes[-1][1]
    program = dict(memory["firmware"])
    if versions:
        program |= {name: later(program[name], 40, tile) for name in ("own", "last")}
        sent["own"] = later(sent["own"], 40, np.repeat(tile, 4))
    if rounds:
        program["pulse"] = later(program["pulse"], 8, tile)
        sent["pulse"] = later(sent["pulse"], 8, np.repeat(tile, 4))
    world.shard._memory = {**memory, "firmware": program}
    return world


@cache
def sorted_near_the_wrap(numbers: str) -> World:
    """Messages get lost and overtake each other, and a leader dies: its heir's first version is 16 ahead."""
    world = World(sorter(2, "n"), {(0, 0): [2, 1], (1, 0): [2]}, BAD_LINKS, seed=4)
    near_the_wrap(world, numbers == "versions", numbers == "rounds")
    world.run(160)
    world.kill([(1, 5)])  # the first in rank of tile [0, 1]
    return world.run(1500)


@pytest.mark.parametrize(("numbers", "register", "bits"), [("versions", "own", 40), ("rounds", "pulse", 8)])
def test_tiles_do_the_same_to_the_last_bit_where_versions_and_rounds_wrap(
    numbers: str, register: str, bits: int
) -> None:
    usual, wrapped = sorted_near_the_wrap("neither"), sorted_near_the_wrap(numbers)
    assert len(usual.left) == 3
    assert wrapped.left == usual.left
    assert np.array_equal(np.array(wrapped.seen), np.array(usual.seen))
    here, there = (
        run.shard.registers()[1][f"firmware.{register}"].astype(np.int64) for run in (usual, wrapped)
    )
    assert np.array_equal(here & (1 << bits) - 1, there & (1 << bits) - 1)
    assert ((there >> bits & WRAP - 1) < 1000).any(), "no number has wrapped"


def test_parcels_are_centred_for_the_requested_time_however_long_that_is() -> None:
    """65,536 ticks and more: the leader's count of them ends where it is long enough, not before."""
    firmware = firmware_of(ReservePath, ["e ."], [(0, 1)], settle_s=66_000 * 0.016)
    world = World(firmware, {(0, 0): [1]})
    world.run(300)
    assert world.riding
    memory = world.shard._memory
    program = dict(memory["firmware"])
    assert program["held"].max() > 0
    program["held"] = np.where(program["held"] > 0, 65_990, 0)
    world.shard._memory = {**memory, "firmware": program}
    world.run(300)
    assert len(world.left) == 1


@pytest.mark.slow
def test_cells_are_the_same_to_the_last_bit_however_the_array_is_cut(run: Callable[..., Any]) -> None:
    firmware = firmware_of(ReservePath, ["e ."], [(0, 1)], tile_cells=3)
    world = World(firmware, {(0, 0): [1, 1]})
    world.run(260)
    presence = np.array(world.seen)
    whole, alone = (
        run(firmware, partition, len(presence), presence=presence, effects=BAD_LINKS).drives
        for partition in (Partition.even(world.lattice, 1), Partition.each(world.lattice))
    )
    assert whole.any()
    assert whole.tobytes() == alone.tobytes()


def test_distances_run_along_the_lanes_and_theory_knows_them() -> None:
    firmware = sorter(3, "ns")
    world = World(firmware, {(0, 0): [], (1, 0): []})
    world.riding = []
    world.queues = {(9, 9): [1]}  # nobody is fed, and the world goes on
    theory = firmware.theory(world.lattice)
    for _ in range(200):
        world.shard.step(world.tick, np.zeros((len(world.lattice), 1), dtype=np.bool_))
        world.tick += 1
    found = world.shard.registers()[1]["firmware.distance"]
    assert np.array_equal(found, theory.limit)
    assert (found[world.lattice.columns < 4] < 250).all()  # every exit can be reached from every entry
    assert (found[(world.lattice.columns >= 12) & (world.lattice.rows < 4), 1] == 250).all()


def test_paths_are_rerouted_around_a_tile_of_which_too_many_cells_die() -> None:
    """Both ways to the northern exit are open at first; the nearer one's tile dies with a parcel on its way."""
    firmware = sorter(2, "nn")
    world = World(firmware, {(0, 0): [2, 2, 2, 1]})
    world.run(60)
    world.kill((4 + row, 4 + column) for row in range(4) for column in range(2))  # half of tile [1, 1]
    world.run(3000)
    assert world.met == 0
    assert sorted(world.left) == [(1, 1), (2, 2), (2, 2), (2, 2)]


def test_a_tile_outlives_its_leader_and_keeps_its_parcel_s_exit() -> None:
    firmware = sorter(2, "n")
    world = World(firmware, {(0, 0): [2]})
    while not any(abs(parcel.centre_m[0] - 0.6) < 0.1 for parcel in world.riding):
        world.run(1)
    world.kill([(1, 5)])  # the first in rank of tile [0, 1]
    world.run(2000)
    assert world.left == [(2, 2)]


def test_a_tile_whose_leader_dies_while_it_pushes_takes_the_next_parcel_for_itself_and_not_for_the_last() -> (
    None
):
    firmware = sorter(2, "n")
    world = World(firmware, {(0, 0): [2, 1]})
    world.run(50)
    while not (world.riding and world.riding[0].centre_m[0] > 0.42):
        world.run(1)
    world.kill([(1, 1)])  # the first in rank of tile [0, 0]; the next parcel is fed before another one leads
    world.run(2000)
    assert world.met == 0
    assert sorted(world.left) == [(1, 1), (2, 2)]


def test_a_tile_that_pushed_into_one_that_died_takes_nothing_back_that_has_gone() -> None:
    """Its own dead cell makes its rounds late, so it has yet to find out that it is empty when the other dies."""
    firmware = sorter(2, "n")
    world = World(firmware, {(0, 0): [1, 2]})
    world.run(50)
    while not (world.riding and world.riding[0].centre_m[0] > 0.3):
        world.run(1)
    world.kill([(0, 0), (1, 5)])  # the second is the first in rank of tile [0, 1]
    world.run(2000)
    assert world.met == 0
    assert sorted(world.left) == [(1, 1), (2, 2)]


def test_a_parcel_without_a_path_is_held_and_others_go_round_it() -> None:
    """Tile [1, 1] has the only lane to exit 2: once it is dead the parcel for it waits, and takes up one tile."""
    firmware = sorter(2, "n")
    world = World(firmware, {(0, 0): [2], (1, 0): [2]})
    world.kill((4 + row, 4 + column) for row in range(4) for column in range(4))
    world.run(800)
    assert world.left == []
    assert len(world.riding) == 2
    assert all(
        np.abs(parcel.centre_m - world.middle_m((row, 0))).max() < PITCH_M
        for row, parcel in enumerate(world.riding)
    )


def test_a_message_says_what_a_tile_does_in_fifty_odd_bytes() -> None:
    assert firmware_of(ReservePath, ["e ."], [(0, 1)]).message.itemsize == 52
    assert sorter(3, "ns").message.itemsize == 56


@pytest.mark.parametrize("closed", [4, 5])
def test_a_tile_is_open_as_long_as_enough_of_its_cells_live(closed: int) -> None:
    firmware = firmware_of(ReservePath, ["e ."], [(0, 1)])
    world = World(firmware, {(0, 0): []})
    dead = [(3, column) for column in range(4)] + [(0, 0)]
    world.kill(dead[:closed])
    for _ in range(200):
        world.shard.step(world.tick, np.zeros((len(world.lattice), 1), dtype=np.bool_))
        world.tick += 1
    assert (world.tiles("own") >> 26 & 63).tolist() == ([1, 1] if closed == 4 else [0, 1])
