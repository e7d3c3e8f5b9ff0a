"""Sampled schedules for worlds that are too large to search: drawn and shrunk by Hypothesis."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast, final

from cell_firmware.array_view import Violation
from deploy.errors import InputError
from deploy.studies.adversary.spec import Act, Adversary, Schedule
from deploy.studies.adversary.world import World


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SampleResult:
    """Coverage of sampled schedules, and the violation found.

    Attributes:
        schedules: Number of schedules that were followed, those of shrinking included.
        ticks: Most ticks of a schedule's run.
        transitions: Number of transitions of single cells that were computed.
        limit: The limit that was reached; empty without one.
        schedule: The shrunk schedule that breaks a condition; None where none was found.
        violation: The condition that the schedule breaks.
        wall_s: Wall time, s.
    """

    schedules: int
    ticks: int
    transitions: int
    limit: str = ""
    schedule: Schedule | None = None
    violation: Violation | None = None
    wall_s: float = 0.0

    def as_json(self) -> dict[str, Any]:
        """Return the result in JSON's types."""
        return {
            "schedules": self.schedules,
            "ticks": self.ticks,
            "transitions": self.transitions,
            "limit": self.limit or None,
            "violation": self.violation and self.violation.as_json(),
            "wall_s": self.wall_s,
        }


class _Broken(Exception):
    """A schedule that breaks a condition."""

    def __init__(self, schedule: Schedule, violation: Violation) -> None:
        super().__init__(violation.rule)
        self.schedule = schedule
        self.violation = violation


def sample(world: World, schedules: int, *, seed: int = 0, limit_s: float = 120.0) -> SampleResult:
    """Follow random schedules of at most ``adversary.faults`` faults, and shrink one that breaks a condition.

    The same seed draws the same schedules.

    Args:
        world: The world.
        schedules: Number of schedules to draw.
        seed: Seed of the draws.
        limit_s: Most wall time, s.

    Raises:
        InputError: Hypothesis is not installed.
    """
    try:
        import hypothesis
        from hypothesis import strategies
    except ModuleNotFoundError:
        raise InputError("--sample: needs Hypothesis: pip install 'mdms-emulator[check]'") from None

    begun, adversary = time.monotonic(), world.adversary
    acts = possible_acts(world)
    one = strategies.tuples(strategies.integers(0, adversary.depth - 1), strategies.sampled_from(acts))
    runs, longest, late = 0, 0, False

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=schedules,
        deadline=None,
        database=None,
        suppress_health_check=cast("Any", list(hypothesis.HealthCheck)),
        phases=(hypothesis.Phase.generate, hypothesis.Phase.shrink),
        report_multiple_bugs=False,
    )
    @hypothesis.given(strategies.lists(one, max_size=adversary.faults))
    def attempt(drawn: list[tuple[int, Act]]) -> None:
        nonlocal runs, longest, late
        late = late or time.monotonic() - begun > limit_s
        if late:
            return
        runs += 1
        schedule, ticks, violation = follow(world, drawn)
        longest = max(longest, ticks)
        if violation is not None:
            raise _Broken(schedule, violation)

    schedule: Schedule | None = None
    violation: Violation | None = None
    try:
        attempt()
    except _Broken as found:
        schedule, violation = found.schedule, found.violation
    return SampleResult(
        schedules=runs,
        ticks=longest,
        transitions=world.transitions.computed,
        limit="the time limit" if late else "",
        schedule=schedule,
        violation=violation,
        wall_s=time.monotonic() - begun,
    )


def possible_acts(world: World) -> list[Act]:
    """Return the faults of an adversary on all cells and links."""
    adversary: Adversary = world.adversary
    acts: list[Act] = []
    for kind in adversary.kinds:
        places = range(len(world.lattice)) if kind in ("death", "repair") else world.links
        lengths = {"delay": adversary.delays, "outage": adversary.outages}.get(kind, (0,))
        acts += [Act(kind, place, ticks) for place in places for ticks in lengths]
    return acts


def follow(world: World, drawn: Sequence[tuple[int, Act]]) -> tuple[Schedule, int, Violation | None]:
    """Run a world under a schedule, until a condition is broken or every condition is due.

    Args:
        world: The world.
        drawn: Faults by tick, in any order; faults that make no difference are left out.

    Returns:
        The faults that made a difference; the number of ticks; the violation, or None.
    """
    adversary = world.adversary
    node, schedule, tick = world.start(), list[tuple[int, Act]](), 0
    slow = max(*adversary.outages, *adversary.delays, 1)
    while tick < adversary.depth or (world.eventual and tick <= adversary.depth + slow + world.longest):
        acts: tuple[Act, ...] = ()
        wanted = {act for at, act in drawn if at == tick}
        if wanted:
            able = [act for act in world.possible(node) if act in wanted]
            acts = max(adversary.combinations(able, node.spent), key=len)
        node, broken = world.step(node, acts, tick)
        schedule += [(tick, act) for act in acts]
        tick += 1
        if broken:
            return tuple(schedule), tick, replace(broken[0], tick=tick - 1)
    return tuple(schedule), tick, None
