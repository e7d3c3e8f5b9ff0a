"""World of a protocol under an adversary: cells, messages under way, and faults, as tuples of numbers."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import Any, Final, NamedTuple, Protocol, final

import numpy as np

from bus.lattice import OPPOSITE, Lattice
from cell_firmware.array_view import ArrayView, Violation
from cell_firmware.firmware import Cells, Firmware
from cell_firmware.invariants import InvariantMonitor
from cell_firmware.program import Program
from deploy.studies.adversary.spec import Act, Adversary
from deploy.studies.adversary.transitions import NO_MESSAGE, Key, Step, Transitions

DEAD: Final = -1
"""State of a cell that is dead."""


class Environment(Protocol):
    """Surroundings of the cells, which cover them and are moved by their wheels: parcels without a plant.

    States are values that can be compared and hashed.
    """

    def start(self) -> Hashable:
        """Return the state before tick 0."""
        ...

    def covered(self, state: Any) -> Sequence[bool]:
        """Return whether each cell is covered."""
        ...

    def after(self, state: Any, speeds_m_s: Sequence[tuple[float, float] | None]) -> Hashable:
        """Return the state after a tick in which the cells drive at these speeds; None for dead cells."""
        ...


class Node(NamedTuple):
    """State of a world before a tick.

    Attributes:
        states: Number of each cell's state, or ``DEAD``.
        arriving: By link, number of the message that arrives in the tick; links are ``4 receiver + side``.
        late: Delayed messages: ticks until one arrives (0: in this tick), link, and message; sorted.
        down: Links that are cut: link, and for how many ticks from this one on; sorted.
        unrest: Ticks from this one on that count as disturbed.
        waiting: Eventual conditions that are false: rule, and for how many ticks; sorted.
        spent: Number of faults by kind so far.
        around: State of the environment; None without one.
    """

    states: tuple[int, ...]
    arriving: tuple[int, ...]
    late: tuple[tuple[int, int, int], ...] = ()
    down: tuple[tuple[int, int], ...] = ()
    unrest: int = 0
    waiting: tuple[tuple[str, int], ...] = ()
    spent: tuple[int, ...] = ()
    around: Any = None


class Draft(NamedTuple):
    """A tick that has begun: the faults have acted, and no cell has been stepped.

    Attributes:
        before: State before the tick.
        acts: Faults that began.
        states: States in which the cells begin the tick.
        keys: Transition of each live cell; None for dead cells.
        late: Delayed messages after the tick.
        down: Links that are cut after the tick.
    """

    before: Node
    acts: tuple[Act, ...]
    states: tuple[int, ...]
    keys: tuple[Key | None, ...]
    late: tuple[tuple[int, int, int], ...]
    down: tuple[tuple[int, int], ...]


@final
class World:
    """A program's cells on a lattice, with ideal links but for the adversary's faults.

    What a fault does is what the fault of a scene does that ``spec.tables_of`` names: messages that arrive in the tick
    of a loss are lost, a dead cell's last messages still arrive, a repaired cell starts as after power-on and hears
    nothing in its first tick, a late message is overtaken by one that arrives with it.

    Args:
        program: The program.
        name: Name of the program in errors.
        cells: The cells.
        lattice: Their lattice.
        adversary: What may happen.
        covered: Cells that are covered in all ticks, by index.
        environment: What covers cells from tick to tick, in place of ``covered``; None without one.

    Attributes:
        environment: As given.
        lattice: As given.
        adversary: As given.
        transitions: Transitions of single cells so far.
        links: Links that exist.
        longest: Most ticks of an eventual condition that was false so far.
        eventual: Whether the program has eventual conditions.
    """

    def __init__(
        self,
        program: Firmware,
        name: str,
        cells: Cells,
        lattice: Lattice,
        adversary: Adversary,
        covered: Iterable[int] = (),
        environment: Environment | None = None,
    ) -> None:
        self.environment = environment
        self.lattice = lattice
        self.adversary = adversary
        self.transitions = Transitions(program, cells, cells.sensors)
        self._monitor = InvariantMonitor(program, name)
        self._covered = [int(i in set(covered)) for i in range(len(lattice))]
        neighbours = lattice.neighbours.tolist()
        self.links = [
            4 * cell + side
            for cell in range(len(lattice))
            for side in range(4)
            if neighbours[cell][side] >= 0
        ]
        self._to = [
            [4 * there + OPPOSITE[side] if there >= 0 else -1 for side, there in enumerate(row)]
            for row in neighbours
        ]
        self._conditions: dict[
            tuple[int, ...], tuple[tuple[Violation, ...], tuple[tuple[Violation, int], ...]]
        ] = {}
        self.longest = 0
        self.eventual = type(program.author).eventually is not Program.eventually

    def start(self) -> Node:
        """Return the state before tick 0."""
        nothing = (NO_MESSAGE,) * (4 * len(self.lattice))
        around = None if self.environment is None else self.environment.start()
        return Node(self.transitions.initial, nothing, spent=(0,) * len(self.adversary.kinds), around=around)

    # --- faults ------------------------------------------------------------------------------------

    def possible(self, node: Node) -> list[Act]:
        """Return the faults that make a difference in the next tick."""
        acts: list[Act] = []
        heard = self._heard(node)
        cut = {link for link, _ in node.down}
        for kind in self.adversary.kinds:
            if kind == "death":
                acts += [Act(kind, i) for i, state in enumerate(node.states) if state != DEAD]
            elif kind == "repair":
                acts += [Act(kind, i) for i, state in enumerate(node.states) if state == DEAD]
            elif kind == "outage":
                acts += [
                    Act(kind, link, ticks)
                    for link in self.links
                    if link not in cut and node.states[link // 4] != DEAD
                    for ticks in self.adversary.outages
                ]
            else:
                audible = [
                    link
                    for link in self.links
                    if heard[link] and link not in cut and node.states[link // 4] != DEAD
                ]
                lengths = self.adversary.delays if kind == "delay" else (0,)
                acts += [Act(kind, link, ticks) for link in audible for ticks in lengths]
        return acts

    def _heard(self, node: Node) -> list[int]:
        """Return what arrives by link, late messages included, before faults of this tick."""
        heard = list(node.arriving)
        for left, link, message in node.late:
            if left == 0 and not heard[link]:
                heard[link] = message
        return heard

    def begin(self, node: Node, acts: tuple[Act, ...]) -> Draft:
        """Begin a tick in which faults begin."""
        heard, states = self._heard(node), list(node.states)
        late = [(left - 1, link, message) for left, link, message in node.late if left]
        down = dict(node.down)
        deaf: set[int] = set()
        for act in acts:
            if act.kind == "death":
                states[act.place] = DEAD
            elif act.kind == "repair":
                states[act.place] = self.transitions.initial[act.place]
                deaf.add(act.place)
            elif act.kind == "delay":
                late.append((act.ticks - 1, act.place, heard[act.place]))
                heard[act.place] = NO_MESSAGE
            elif act.kind == "loss":
                heard[act.place] = NO_MESSAGE
            else:
                down[act.place] = act.ticks
        for link in down:
            heard[link] = NO_MESSAGE
        covered: Sequence[int] = self._covered
        if self.environment is not None:
            covered = [int(one) for one in self.environment.covered(node.around)]
        keys: list[Key | None] = []
        for i, state in enumerate(states):
            if state == DEAD:
                keys.append(None)
                continue
            inbox = (NO_MESSAGE,) * 4 if i in deaf else heard[4 * i : 4 * i + 4]
            keys.append((i, state, covered[i], *inbox))  # pyright: ignore[reportArgumentType]
        return Draft(
            node,
            acts,
            tuple(states),
            tuple(keys),
            tuple(sorted(late)),
            tuple(sorted((link, left - 1) for link, left in down.items() if left > 1)),
        )

    def finish(self, draft: Draft, tick: int) -> tuple[Node, list[Violation]]:
        """Step the cells, whose transitions have been computed.

        Args:
            draft: The tick.
            tick: Its number.

        Returns:
            The next state; violations in the tick.
        """
        steps = self.transitions.known()
        states, arriving = list(draft.states), [NO_MESSAGE] * len(draft.before.arriving)
        failures: list[Violation] = []
        for i, key in enumerate(draft.keys):
            if key is None:
                continue
            step: Step = steps[key]
            states[i] = step.state
            if step.failure:
                cell = self.lattice.cells[i]
                failures.append(
                    Violation("always", f"the program does not fail ({step.failure})", tick, (cell,))
                )
            for link, message in zip(self._to[i], step.sent, strict=True):
                if message and draft.states[link // 4] != DEAD:
                    arriving[link] = message
        spent = self.adversary.add(draft.before.spent, draft.acts)
        around = None
        if self.environment is not None:
            speeds = [None if key is None else steps[key].speed_m_s for key in draft.keys]
            around = self.environment.after(draft.before.around, speeds)
        node = Node(tuple(states), tuple(arriving), draft.late, draft.down, 0, (), spent, around)
        if failures:
            return node, failures
        broken, awaited = self._evaluated(node.states, tick)
        if not self.eventual:
            return node, list(broken)
        return self._wait(node, draft, list(broken), awaited)

    def _wait(
        self, node: Node, draft: Draft, broken: list[Violation], awaited: Sequence[tuple[Violation, int]]
    ) -> tuple[Node, list[Violation]]:
        """Count the ticks for which eventual conditions have been false; see ``InvariantMonitor``."""
        before = draft.before
        changed = [state == DEAD for state in before.states] != [state == DEAD for state in node.states]
        unrest = max(before.unrest, 0)
        for act in draft.acts:
            unrest = max(unrest, {"loss": 2, "delay": 2, "outage": act.ticks + 1}.get(act.kind, 1))
        disturbed = changed or unrest > 0
        ages = dict(before.waiting)
        waiting: list[tuple[str, int]] = []
        for one, ticks in awaited:
            age = 0 if disturbed or one.rule not in ages else ages[one.rule] + 1
            if age >= ticks:
                broken.append(one)
            waiting.append((one.rule, age))
        return node._replace(unrest=max(unrest - 1, 0), waiting=tuple(sorted(waiting))), broken

    def _evaluated(
        self, states: tuple[int, ...], tick: int
    ) -> tuple[tuple[Violation, ...], tuple[tuple[Violation, int], ...]]:
        """Return broken and awaited conditions of cells in these states, evaluated once."""
        found = self._conditions.get(states)
        if found is None:
            alive = np.array([state != DEAD for state in states])
            numbers = [max(state, 0) for state in states]
            view = ArrayView(tick, self.lattice, alive, self.transitions.registers(numbers))
            broken, awaited = self._monitor.evaluate(view) if alive.any() else ([], [])
            found = self._conditions[states] = tuple(broken), tuple(awaited)
            self.longest = max([self.longest, *(ticks for _, ticks in awaited)])
        return found

    def always(self, states: tuple[int, ...], tick: int) -> tuple[Violation, ...]:
        """Return the broken invariants of cells in these states."""
        return self._evaluated(states, tick)[0]

    def step(self, node: Node, acts: tuple[Act, ...], tick: int) -> tuple[Node, list[Violation]]:
        """Run one tick from a state."""
        draft = self.begin(node, acts)
        self.transitions.steps(key for key in draft.keys if key is not None)
        return self.finish(draft, tick)
