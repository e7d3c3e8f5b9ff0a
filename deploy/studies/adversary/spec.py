"""Powers of an adversary, and schedules of faults."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, Final, Literal, NamedTuple, final

from bus.lattice import SIDES, Lattice
from deploy.errors import InputError
from deploy.lab.faults import Table

Kind = Literal["loss", "delay", "death", "repair", "outage"]
KINDS: Final[tuple[Kind, ...]] = ("loss", "delay", "death", "repair", "outage")


class Act(NamedTuple):
    """A fault that begins in some tick.

    Attributes:
        kind: Its kind.
        place: Index of the cell; of a link, ``4 receiver + side``.
        ticks: Delay of a message or length of an outage; 0 for other kinds.
    """

    kind: Kind
    place: int
    ticks: int = 0


Schedule = tuple[tuple[int, Act], ...]
"""Faults by tick, in order of ticks."""


@final
@dataclass(frozen=True, slots=True)
class Adversary:
    """Powers of an adversary.

    Attributes:
        faults: Most faults in all.
        depth: Tick before which faults begin.
        kinds: Kinds of faults.
        delays: Delays of a message, ticks.
        outages: Lengths of an outage of one direction of a link, ticks.
        at_most: Most faults of a kind, where fewer than ``faults``.
        first_tick: First tick in which faults begin.
        tail_ticks: Ticks that are followed after ``depth`` in any case.
    """

    faults: int = 1
    depth: int = 12
    kinds: tuple[Kind, ...] = ("loss", "delay", "death", "repair")
    delays: tuple[int, ...] = (1,)
    outages: tuple[int, ...] = (4,)
    at_most: Mapping[str, int] = field(default_factory=dict[str, int])
    first_tick: int = 0
    tail_ticks: int = 0

    def __post_init__(self) -> None:
        for name, least in (("faults", 0), ("depth", 1), ("first_tick", 0), ("tail_ticks", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{name} {getattr(self, name)}: must be at least {least}")
        for kind in (*self.kinds, *self.at_most):
            if kind not in KINDS:
                raise InputError(f"kind {kind!r}: must be one of {', '.join(KINDS)}")
        for name in ("delays", "outages"):
            if any(ticks < 1 for ticks in getattr(self, name)):
                raise InputError(f"{name} {getattr(self, name)}: must be ticks from 1")

    def left(self, spent: Mapping[str, int] | Sequence[int]) -> tuple[int, ...]:
        """Return how many faults of each of ``kinds`` are still allowed.

        Args:
            spent: Number of faults so far, in the order of ``kinds``.
        """
        counts = list(spent.values()) if isinstance(spent, Mapping) else list(spent)
        total = self.faults - sum(counts)
        return tuple(
            min(total, self.at_most.get(kind, self.faults) - count)
            for kind, count in zip(self.kinds, counts, strict=True)
        )

    def combinations(self, possible: Sequence[Act], spent: Sequence[int]) -> Iterator[tuple[Act, ...]]:
        """Yield the sets of faults that may begin in one tick, the empty set first.

        No two faults of a set concern the same cell or link.

        Args:
            possible: Faults that make a difference in this tick.
            spent: Number of faults so far, in the order of ``kinds``.
        """
        yield ()
        left: dict[str, int] = dict(zip(self.kinds, self.left(spent), strict=True))
        allowed = [act for act in possible if left.get(act.kind, 0) > 0]
        for size in range(1, self.faults - sum(spent) + 1):
            for acts in combinations(allowed, size):
                places = {(act.kind in ("death", "repair"), act.place) for act in acts}
                if len(places) == size and all(
                    sum(act.kind == kind for act in acts) <= most for kind, most in left.items()
                ):
                    yield acts

    def add(self, spent: Sequence[int], acts: Sequence[Act]) -> tuple[int, ...]:
        """Return the number of faults by kind after more."""
        return tuple(
            count + sum(act.kind == kind for act in acts)
            for kind, count in zip(self.kinds, spent, strict=True)
        )


def tables_of(schedule: Schedule, lattice: Lattice) -> list[Table]:
    """Return the faults of a schedule as tables of ``[[faults]]``, with ``at_tick`` and ``until_tick``.

    Args:
        schedule: The schedule.
        lattice: The cells.
    """
    tables: list[Table] = []
    crashes: dict[int, Table] = {}
    for tick, act in schedule:
        cell = list(lattice.cells[act.place if act.kind in ("death", "repair") else act.place // 4])
        link: dict[str, Any] = {"cell": cell, "side": SIDES[act.place % 4], "direction": "in"}
        if act.kind == "death":
            crashes[act.place] = {"kind": "crash", "at_tick": tick, "cell": cell}
            tables.append(crashes[act.place])
        elif act.kind == "repair":
            crashes[act.place]["until_tick"] = tick
        elif act.kind == "delay":
            tables.append(
                {"kind": "link_delay", "at_tick": tick, "until_tick": tick + 1, "ticks": act.ticks, **link}
            )
        else:
            length = act.ticks if act.kind == "outage" else 1
            tables.append({"kind": "link_down", "at_tick": tick, "until_tick": tick + length, **link})
    return tables
