"""Exhaustive search of a small world: breadth first, each state once."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

from cell_firmware.array_view import Violation
from deploy.studies.adversary.spec import Act, Schedule
from deploy.studies.adversary.symmetry import Symmetry, is_group, symmetries_of
from deploy.studies.adversary.world import Draft, Node, World

_BATCH: Final = 8_192
"""Ticks of the world whose missing transitions are computed in one call."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SearchResult:
    """Coverage of a search, and the violation found.

    Attributes:
        states: Number of different states, with the faults that led there; symmetric ones count once.
        ticks: Depth reached: ticks that were followed from the start.
        tail_ticks: Further ticks without new faults, in which eventual conditions come due.
        transitions: Number of transitions of single cells that were computed.
        symmetries: Turns and reflections whose states were merged, the identity included.
        unexplored: Number of states that were not followed further, since a limit was reached; 0: nothing was cut off.
        limit: The limit that was reached; empty without one.
        schedule: Faults that lead to the violation; None where none was found.
        violation: The first violation, of the least depth.
        wall_s: Wall time, s.
    """

    states: int
    ticks: int
    tail_ticks: int
    transitions: int
    symmetries: int
    unexplored: int = 0
    limit: str = ""
    schedule: Schedule | None = None
    violation: Violation | None = None
    wall_s: float = 0.0

    def as_json(self) -> dict[str, Any]:
        """Return the result in JSON's types."""
        return {
            "states": self.states,
            "ticks": self.ticks,
            "tail_ticks": self.tail_ticks,
            "transitions": self.transitions,
            "symmetries": self.symmetries,
            "unexplored": self.unexplored,
            "limit": self.limit or None,
            "violation": self.violation and self.violation.as_json(),
            "wall_s": self.wall_s,
        }


def search(
    world: World,
    covered: Sequence[int] = (),
    *,
    symmetric: bool = True,
    most_states: int = 2_000_000,
    limit_s: float = 120.0,
    poll: Callable[[], None] = lambda: None,
) -> SearchResult:
    """Search all states that an adversary's faults lead to.

    Args:
        world: The world.
        covered: Cells that are covered, by index.
        symmetric: Whether symmetric states are merged, as far as the program is symmetric; never with an environment.
        most_states: Most states.
        limit_s: Most wall time, s.
        poll: Called many times; may raise.
    """
    begun = time.monotonic()
    symmetric = symmetric and world.environment is None
    symmetries = symmetries_of(world.lattice, world.transitions, covered) if symmetric else []
    while True:
        one = _Search(world, symmetries, most_states, begun + limit_s, poll)
        found = one.run()
        if found is not None:
            return found(time.monotonic() - begun)
        symmetries = one.symmetries  # the program isn't as symmetric as its lattice: from the start again


@final
class _Search:
    def __init__(
        self,
        world: World,
        symmetries: list[Symmetry],
        most_states: int,
        until_s: float,
        poll: Callable[[], None],
    ) -> None:
        self._world = world
        self.symmetries = list(symmetries)
        self._most = most_states
        self._until_s = until_s
        self._poll = poll
        self._parents: dict[Node, tuple[Node | None, tuple[Act, ...], int]] = {}
        self._verified: set[Any] = set()
        self._limit = ""

    def run(self) -> Callable[[float], SearchResult] | None:
        """Search; None if a symmetry turned out not to hold, and was dropped."""
        world, depth = self._world, self._world.adversary.depth
        start = self._canonical(world.start())
        self._parents[start] = None, (), -1
        frontier, tick = [start], 0
        found: tuple[Node, tuple[Act, ...], Violation] | None = None
        slow = max(*world.adversary.outages, *world.adversary.delays, 1)
        while frontier and (
            tick < depth + world.adversary.tail_ticks
            or (world.eventual and tick <= depth + slow + world.longest)
        ):
            after: list[Node] = []
            left = len(frontier)
            for drafts, nodes in self._batches(frontier, faults=world.adversary.first_tick <= tick < depth):
                left -= nodes
                if not self._prepare(drafts):
                    return None
                found = self._finish(drafts, tick, after) or found
                if self._over():
                    break
            if found is not None or self._limit:
                return self._result(tick + 1, 0 if found is not None else left + len(after), found)
            frontier, tick = after, tick + 1
        return self._result(tick, 0, None)

    def _batches(self, nodes: Iterable[Node], *, faults: bool) -> Iterator[tuple[list[Draft], int]]:
        """Yield the next ticks of states, a bounded number at a time, and how many states they complete."""
        world = self._world
        drafts: list[Draft] = []
        done = 0
        for node in nodes:
            choices: Iterable[tuple[Act, ...]] = ((),)
            if faults:
                left = world.adversary.left(node.spent)
                if max(left, default=0) > 0:
                    choices = world.adversary.combinations(world.possible(node), node.spent)
            for acts in choices:
                drafts.append(world.begin(node, acts))
                if len(drafts) == _BATCH:
                    yield drafts, done
                    drafts, done = [], 0
            done += 1
        yield drafts, done

    def _prepare(self, drafts: list[Draft]) -> bool:
        """Compute missing transitions; False if a symmetry does not hold for one of them."""
        keys = {key for draft in drafts for key in draft.keys if key is not None} - self._verified
        self._world.transitions.steps(keys)
        if self.symmetries:
            listed = sorted(keys)
            kept = [one for one in self.symmetries if one.agrees(listed)]
            if len(kept) < len(self.symmetries):
                self.symmetries = kept if is_group(kept) else []
                return False
        self._verified |= keys
        return True

    def _finish(
        self, drafts: list[Draft], tick: int, after: list[Node]
    ) -> tuple[Node, tuple[Act, ...], Violation] | None:
        """Finish ticks; returns the violation with the fewest faults, if there is one."""
        worst: tuple[Node, tuple[Act, ...], Violation] | None = None
        for draft in drafts:
            node, broken = self._world.finish(draft, tick)
            if not broken and self.symmetries:
                broken = self._broken_images(node, tick)
            if broken:
                if worst is None or sum(node.spent) < sum(worst[0].spent):
                    worst = node, draft.acts, replace(broken[0], tick=tick)
                    self._culprit = draft.before
                continue
            whole = self._canonical(node)
            if whole not in self._parents:
                self._parents[whole] = draft.before, draft.acts, tick
                after.append(whole)
        return worst

    def _broken_images(self, node: Node, tick: int) -> list[Violation]:
        """Evaluate the conditions on symmetric states, since a program's conditions may name a cell."""
        for one in self.symmetries:
            broken = self._world.always(one.image(node).states, tick)
            if broken:
                return list(broken)
        return []

    def _canonical(self, node: Node) -> Node:
        return min([node, *(one.image(node) for one in self.symmetries)]) if self.symmetries else node

    def _over(self) -> bool:
        self._poll()
        if len(self._parents) >= self._most:
            self._limit = f"{self._most:,} states"
        elif time.monotonic() >= self._until_s:
            self._limit = "the time limit"
        return bool(self._limit)

    def _result(
        self, ticks: int, unexplored: int, found: tuple[Node, tuple[Act, ...], Violation] | None
    ) -> Callable[[float], SearchResult]:
        depth = self._world.adversary.depth
        schedule: Schedule | None = None
        if found is not None:
            schedule = self._schedule_to(self._culprit, found[1], ticks - 1)

        def result(wall_s: float) -> SearchResult:
            return SearchResult(
                states=len(self._parents),
                ticks=min(ticks, depth),
                tail_ticks=max(ticks - depth, 0),
                transitions=self._world.transitions.computed,
                symmetries=1 + len(self.symmetries),
                unexplored=unexplored,
                limit=self._limit,
                schedule=schedule,
                violation=None if found is None else found[2],
                wall_s=wall_s,
            )

        return result

    def _schedule_to(self, node: Node, acts: tuple[Act, ...], tick: int) -> Schedule:
        """Return the faults that lead to a state and then begin in ``tick``.

        With symmetric states merged, the faults are those of images of the states; they are mapped back by running
        forward: of each step the images that lead on are followed.
        """
        steps: list[tuple[Node, tuple[Act, ...]]] = []
        last: tuple[Node, tuple[Act, ...]] | None = (node, acts)
        while last is not None:
            steps.append(last)
            before, how, _ = self._parents[last[0]]
            last = None if before is None else (before, how)
        steps.reverse()
        first = tick + 1 - len(steps)
        assert first == 0, "this is a bug: a path that doesn't begin at tick 0"
        if not self.symmetries:
            return tuple((k, act) for k, (_, acts) in enumerate(steps) for act in acts)
        return self._unfolded(steps)

    def _unfolded(self, steps: list[tuple[Node, tuple[Act, ...]]]) -> Schedule:
        """Return the faults of a run through states symmetric to the given ones."""
        world = self._world
        node, schedule = world.start(), list[tuple[int, Act]]()
        for tick, (canonical, acts) in enumerate(steps):
            for one in (None, *self.symmetries):
                if (canonical if one is None else one.image(canonical)) == node:
                    acts = acts if one is None else tuple(one.image_of_act(act) for act in acts)  # noqa: PLW2901
                    break
            else:
                raise AssertionError("this is a bug: a state that isn't symmetric to its representative")
            schedule += [(tick, act) for act in acts]
            node, _ = world.step(node, acts, tick)
        return self._breaking(tuple(schedule), len(steps))

    def _breaking(self, schedule: Schedule, ticks: int) -> Schedule:
        """Return the image of a schedule whose last tick breaks a condition: a condition may name a cell."""
        for one in (None, *self.symmetries):
            image = schedule if one is None else tuple((k, one.image_of_act(act)) for k, act in schedule)
            node, broken = self._world.start(), list[Violation]()
            for tick in range(ticks):
                acts = tuple(act for k, act in image if k == tick)
                node, broken = self._world.step(node, acts, tick)
            if broken:
                return image
        raise AssertionError("this is a bug: a violation that no run of the world has")
