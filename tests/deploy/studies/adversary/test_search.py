"""Exhaustive search for schedules of faults: what it covers, what it finds, and that a run does the same."""

from __future__ import annotations

import itertools
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.errors import InputError
from deploy.lab.faults import in_seconds
from deploy.lab.lab import Lab
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.studies.adversary.check import (
    Counterexample,
    check_by_sampling,
    check_exhaustively,
    world_of,
    world_scene,
)
from deploy.studies.adversary.spec import KINDS, Act, Adversary, tables_of
from deploy.studies.adversary.world import DEAD
from deploy.workers.plan import RunOptions
from mdms import SIDES, Cell, CellFirmware, CellInputs, CellOutputs, Lattice
from tests.deploy.lab.programs import Gossip
from tests.deploy.studies.adversary.mutants import (
    Averaging,
    AveragingWithoutFlows,
    Corner,
    HandOver,
    HandOverUnacknowledged,
    NearTree,
    PlainWords,
    SerialWords,
    Tree,
    TreeOfTheDead,
    Wave,
)

NEAR_WRAP: dict[str, Any] = {"initial_registers": {"version": 65_534}}
UNEQUAL: dict[str, Any] = {"parameters": {"values": [{"cell": [0, 0], "value": 1.0}]}}
CASES: dict[type, tuple[tuple[int, int], Adversary, dict[str, Any]]] = {
    PlainWords: ((1, 3), Adversary(1, 16, ("loss", "delay")), NEAR_WRAP),
    AveragingWithoutFlows: ((1, 3), Adversary(1, 12, ("outage",), outages=(3, 25)), UNEQUAL),
    HandOverUnacknowledged: ((1, 3), Adversary(1, 12, ("loss", "delay")), {}),
    TreeOfTheDead: ((2, 2), Adversary(1, 6, ("loss", "death")), {}),
}
RIGHT: dict[type, tuple[tuple[int, int], Adversary, dict[str, Any]]] = {
    SerialWords: ((1, 3), Adversary(2, 16, ("loss", "delay")), NEAR_WRAP),
    Averaging: ((1, 3), Adversary(1, 12, ("loss", "outage"), outages=(3, 25)), UNEQUAL),
    HandOver: ((1, 3), Adversary(2, 12, ("loss", "delay")), {}),
    Tree: ((2, 2), Adversary(2, 6, ("loss", "delay", "death", "repair")), {}),
}
RULES = {
    PlainWords: "all cells know the source's word",
    AveragingWithoutFlows: "the mean is that of the given values",
    HandOverUnacknowledged: "a cell has the reservation",
    TreeOfTheDead: "the root of each cell is alive",
}


def _found(firmware: type, **options: Any) -> tuple[Any, Counterexample | None]:
    world, adversary, given = {**CASES, **RIGHT}[firmware]
    scene = world_scene(firmware, world, **given)
    return check_exhaustively(scene, adversary, **options)


@pytest.mark.parametrize("mutant", CASES)
def test_a_mutant_is_found_and_a_run_stops_in_the_same_tick(mutant: type, tmp_path: Path) -> None:
    _, counterexample = _found(mutant)
    assert counterexample is not None
    assert counterexample.violation.rule == RULES[mutant]
    counterexample.write(tmp_path / "counterexample.toml")
    scene = load_scene(tmp_path / "counterexample.toml")
    options = RunOptions(0, "memory", output=tmp_path / "out", picture=False, check="stop")
    summary = run(scene, options, quiet=True).summary
    assert (summary.status, summary.reason) == ("failed", str(counterexample.violation))
    assert summary.ticks == counterexample.ticks


@pytest.mark.slow
@pytest.mark.system
def test_a_run_over_zenoh_with_a_process_a_cell_stops_in_the_same_tick(tmp_path: Path) -> None:
    _, counterexample = _found(HandOverUnacknowledged)
    assert counterexample is not None
    counterexample.write(tmp_path / "counterexample.toml")
    scene = load_scene(tmp_path / "counterexample.toml")
    options = RunOptions("each", output=tmp_path / "out", picture=False, check="stop")
    summary = run(scene, options, quiet=True).summary
    assert summary.check is not None
    assert (summary.reason, summary.ticks) == (str(counterexample.violation), counterexample.ticks)


@pytest.mark.parametrize("firmware", RIGHT)
def test_the_protocols_without_the_mistakes_hold(firmware: type) -> None:
    result, counterexample = _found(firmware)
    assert counterexample is None
    assert (result.unexplored, result.limit) == (0, "")


# --- against an independent search ------------------------------------------------------------------


SQUARE = Lattice((row, column) for row in range(2) for column in range(2))
PROGRAM: Any = NearTree(None)


def _cell(i: int) -> Cell:
    row, column = SQUARE.cells[i]
    sides = tuple(side for s, side in enumerate(SIDES) if SQUARE.neighbours[i, s] >= 0)
    return Cell(row, column, (0.0, 0.0), sides, 0.004, ((0.0, 0.0),), 0.1)


def _ticked(node: Any, lost: Any, dies: int | None) -> Any:
    """One tick by hand: states (None: dead), letters by receiver and side, losses and deaths so far."""
    states, mail, losses, deaths = node
    after, letters, sent = list(states), dict(mail), dict[Any, Any]()
    if dies is not None:
        after[dies] = None
    letters.pop(lost, None)
    for i in range(4):
        if after[i] is None:
            continue
        words = {side: letters.get((i, side)) for side in SIDES}
        inbox = {side: word and {"root": word[0], "distance": word[1]} for side, word in words.items()}
        after[i], outputs = PROGRAM.step(after[i], CellInputs((False,), None, inbox))
        for s, side in enumerate(SIDES):
            there = int(SQUARE.neighbours[i, s])
            word = outputs.outbox[side]
            if there >= 0:
                sent[there, SIDES[(s + 2) % 4]] = (word["root"], word["distance"])
    kept = sorted((link, word) for link, word in sent.items() if after[link[0]] is not None)
    return tuple(after), tuple(kept), losses + (lost is not None), deaths + (dies is not None)


def _states_by_hand(depth: int) -> int:
    """Breadth-first search of ``NearTree`` on 2 x 2 cells, at most one loss and one death, written by hand."""
    start = (tuple(PROGRAM.init(_cell(i)) for i in range(4)), (), 0, 0)
    seen, frontier = {start}, [start]
    for _ in range(depth):
        after: list[Any] = []
        for node in frontier:
            states, mail, losses, deaths = node
            dying = [None] if deaths else [None, *(i for i in range(4) if states[i] is not None)]
            losing = [None] if losses else [None, *(link for link, _ in mail if states[link[0]] is not None)]
            for dies, lost in itertools.product(dying, losing):
                found = _ticked(node, lost, dies)
                if found not in seen:
                    seen.add(found)
                    after.append(found)
        frontier = after
    return len(seen)


def test_states_of_two_by_two_cells_are_those_of_an_independent_search() -> None:
    adversary = Adversary(2, 12, ("loss", "death"), at_most={"loss": 1, "death": 1})
    result, _ = check_exhaustively(world_scene(NearTree, (2, 2)), adversary, symmetric=False)
    assert (result.ticks, result.unexplored) == (12, 0) or result.ticks < 12
    assert result.states == _states_by_hand(12)
    assert result.states > 100


# --- against the lab --------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(20))
def test_a_world_has_the_registers_of_a_lab_under_any_schedule(seed: int) -> None:
    chance = random.Random(seed)
    adversary = Adversary(12, 25, KINDS, delays=(1, 2, 3), outages=(2, 5))
    scene = world_scene(Wave, (2, 3)) if seed % 2 else Lab(Gossip, (2, 3), check=None).scene
    names = ("phase", "heard") if seed % 2 else ("most", "periods")
    world = world_of(scene, adversary)
    node, schedule, states = world.start(), list[tuple[int, Act]](), list[Any]()
    for tick in range(30):
        acts: tuple[Act, ...] = ()
        left = adversary.faults - len(schedule)
        if tick < adversary.depth and left:
            possible = [act for act in world.possible(node) if chance.random() < 0.05]
            acts = chance.choice(list(adversary.combinations(possible[: min(3, left)], node.spent)))
        node, _ = world.step(node, acts, tick)
        schedule += [(tick, act) for act in acts]
        states.append(node.states)
    tables = [in_seconds(one, scene.tick_ns) for one in tables_of(tuple(schedule), world.lattice)]
    data = scene.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    lab = Lab.of(load_scene({**data, "faults": tables}), check=None)
    for tick, numbers in enumerate(states):
        lab.step()
        alive = np.array([number != DEAD for number in numbers])
        registers = world.transitions.registers([max(number, 0) for number in numbers])
        for name in names:
            mine, theirs = registers[f"firmware.{name}"], lab.registers[name]
            assert np.array_equal(mine[alive], theirs[alive]), (tick, name, schedule)


# --- symmetry, limits, options ----------------------------------------------------------------------


def test_symmetric_states_are_merged_where_the_program_is_symmetric() -> None:
    adversary = Adversary(1, 8, ("loss", "death"))
    scene = world_scene(Wave, (2, 2))
    merged, _ = check_exhaustively(scene, adversary)
    whole, _ = check_exhaustively(scene, adversary, symmetric=False)
    assert (merged.symmetries, whole.symmetries) == (8, 1)
    assert whole.states / 8 < merged.states < whole.states / 2
    tree, _ = check_exhaustively(world_scene(Tree, (2, 2)), adversary)
    assert tree.symmetries == 1  # the cells' numbers differ


def test_a_condition_that_names_a_cell_is_found_broken_among_merged_states() -> None:
    adversary = Adversary(1, 4, ("loss",))
    found = [check_exhaustively(world_scene(Corner, (2, 2)), adversary, symmetric=s) for s in (True, False)]
    assert [result.symmetries for result, _ in found] == [8, 1]
    (_, merged), (_, whole) = found
    assert merged is not None
    assert whole is not None
    assert str(merged.violation) == str(whole.violation)


def test_what_was_cut_off_is_said() -> None:
    adversary = Adversary(2, 30, ("loss", "delay", "death", "repair"))
    result, _ = check_exhaustively(world_scene(Wave, (2, 2)), adversary, most_states=500, symmetric=False)
    assert result.limit == "500 states"
    assert result.unexplored > 0
    assert result.ticks < 30


def test_a_program_that_fails_is_a_violation() -> None:
    class Overflows(Wave):
        def step(self, state: Any, inputs: CellInputs) -> Any:
            if not inputs.inbox["east"] and state["heard"] == 3:
                raise ValueError("nobody there")
            return super().step(state, inputs)

    _, counterexample = check_exhaustively(world_scene(Overflows, (2, 3)), Adversary(1, 6, ("loss",)))
    assert counterexample is not None
    assert "ValueError: nobody there" in counterexample.violation.rule


class Drawing(CellFirmware):
    """Counts draws below a half."""

    random = ("go",)

    def init(self, cell: Any) -> int:
        del cell
        return 0

    def step(self, state: int, inputs: Any) -> tuple[int, CellOutputs]:
        return state + int(inputs.random["go"] < 0.5), CellOutputs((0.0, 0.0))

    def invariants(self, view: Any) -> Any:
        yield "few", view["state"] < 100


def test_a_program_that_draws_random_numbers_is_refused() -> None:
    with pytest.raises(InputError, match=r"draws random numbers \(go\)"):
        world_scene(Drawing, (1, 2))


def test_programs_without_conditions_and_wrong_powers_are_refused() -> None:
    with pytest.raises(InputError, match="has no conditions to check"):
        world_scene(Gossip, (1, 2))
    with pytest.raises(InputError, match="kind 'los': must be one of loss, delay, death, repair, outage"):
        Adversary(kinds=("los",))  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="depth 0: must be at least 1"):
        Adversary(depth=0)


# --- sampled schedules ------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_a_sampled_counterexample_is_shrunk_to_the_fault_that_matters(seed: int) -> None:
    scene = world_scene(HandOverUnacknowledged, (1, 8), seed=seed)
    adversary = Adversary(6, 30, ("loss", "delay", "outage"))
    result, counterexample = check_by_sampling(scene, adversary, 300)
    assert counterexample is not None
    assert counterexample.violation.rule == "a cell has the reservation"
    assert [fault["kind"] for fault in counterexample.faults] == ["link_down"]
    assert result.limit == ""


@pytest.mark.slow
@pytest.mark.system
def test_a_sampled_counterexample_stops_a_run_over_zenoh_in_the_same_tick(tmp_path: Path) -> None:
    scene = world_scene(HandOverUnacknowledged, (2, 6), seed=1)
    _, counterexample = check_by_sampling(scene, Adversary(6, 30, ("loss", "delay", "outage")), 300)
    assert counterexample is not None
    counterexample.write(tmp_path / "counterexample.toml")
    options = RunOptions("each", output=tmp_path / "out", picture=False, check="stop")
    summary = run(load_scene(tmp_path / "counterexample.toml"), options, quiet=True).summary
    assert (summary.reason, summary.ticks) == (str(counterexample.violation), counterexample.ticks)


def test_a_sampled_protocol_without_the_mistake_holds_and_draws_are_repeated() -> None:
    scene = world_scene(Tree, (2, 4), seed=5)
    adversary = Adversary(3, 10, ("loss", "delay", "death"))
    first, counterexample = check_by_sampling(scene, adversary, 60)
    again, _ = check_by_sampling(scene, adversary, 60)
    assert counterexample is None
    assert (first.schedules, first.transitions) == (again.schedules, again.transitions)
    assert first.schedules == 60
