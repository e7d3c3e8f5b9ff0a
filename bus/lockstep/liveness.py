"""Liveness tracking: presence and readiness of units by token, and rejoins of restarted shards."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import NDArray

from bus.errors import BarrierError
from bus.lattice import Lattice
from bus.transports.base import LivelinessChange
from bus.wire.format import CoordinatorCodec

_NAMED = 12
"""Cells that a message names before it only counts them."""


@final
class LivenessTracker:
    """Liveness of every unit of a wire format, by token.

    Attributes:
        alive: Units whose token is present.
        ready: Units whose readiness token is present.
        ever_left: Units whose token was present and disappeared at least once.
        unhandled_departures: Units whose disappearance has not been handled yet.
    """

    def __init__(self, form: CoordinatorCodec, lattice: Lattice) -> None:
        self._form = form
        self._lattice = lattice
        self.alive: set[int] = set()
        self.ready: set[int] = set()
        self.ever_left: set[int] = set()
        self.unhandled_departures: set[int] = set()

    def all_ready(self) -> bool:
        """Whether every unit is ready."""
        return len(self.ready) == len(self._form.unit_cells)

    def absent(self, shard_of: NDArray[np.int64]) -> set[int]:
        """Return the shards with a unit whose token never appeared; ``shard_of``: ``(n,)``, shard of every cell."""
        seen = self.alive | self.ever_left
        units = enumerate(self._form.unit_cells)
        return {int(shard_of[int(i)]) for unit, cells in units if unit not in seen for i in cells}

    def handle(self, event: LivelinessChange) -> None:
        """Record a change of a token; tokens outside the wire format are ignored."""
        if (unit := self._form.alive_units.get(event.key)) is not None:
            if event.present:
                self.alive.add(unit)
                self.unhandled_departures.discard(unit)
            else:
                self.alive.discard(unit)
                self.ever_left.add(unit)
                self.unhandled_departures.add(unit)
        elif (unit := self._form.ready_units.get(event.key)) is not None:
            (self.ready.add if event.present else self.ready.discard)(unit)

    def missing(self, waited_s: float, unheard: Sequence[int]) -> BarrierError:
        """Return the error that names missing cells; ``unheard``: units that are not subscribed yet."""
        units = range(len(self._form.unit_cells))
        never = [u for u in units if u not in self.alive and u not in self.ever_left]
        left = [u for u in units if u not in self.alive and u in self.ever_left]
        unready = [u for u in units if u in self.alive and u not in self.ready]
        deaf: Sequence[int] = () if never or left or unready else unheard
        parts = [
            f"{verb}: {self._names(who)}"
            for verb, who in (
                ("never appeared", never),
                ("appeared and left again", left),
                ("appeared but not ready", unready),
                ("ready but can't be sent to", deaf),
            )
            if who
        ]
        return BarrierError(
            f"not every cell is ready after {waited_s:g} s; {'; '.join(parts)}",
            absent=self._cells(never + left),
            unready=self._cells([*unready, *deaf]),
        )

    def _cells(self, units: Sequence[int]) -> list[tuple[int, int]]:
        return [self._lattice.cells[int(i)] for unit in units for i in self._form.unit_cells[unit]]

    def _names(self, units: Sequence[int]) -> str:
        cells = self._cells(units)
        named = " ".join(f"{row},{column}" for row, column in cells[:_NAMED])
        more = f" and {len(cells) - _NAMED} more" if len(cells) > _NAMED else ""
        return f"{len(cells)} cell{'s' if len(cells) > 1 else ''} ({named}{more})"


@final
@dataclass(slots=True)
class PendingRejoin:
    """A shard that was lost and may rejoin.

    Attributes:
        cells: Indices of the cells lost with the shard.
        prepared: Whether the rejoin has been announced to the other shards.
        linked: Shards that have answered.
    """

    cells: list[int]
    prepared: bool = False
    linked: set[int] = field(default_factory=set[int])


@final
class RejoinTracker:
    """Lost shards, and the progress of their rejoins.

    Args:
        roll: Liveness of the run's units.
        units: Units of each shard.
        matched: Whether a unit is subscribed.
    """

    def __init__(
        self, roll: LivenessTracker, units: Sequence[Sequence[int]], matched: Callable[[int], bool]
    ) -> None:
        self._roll = roll
        self._units = units
        self._matched = matched
        self._absent: dict[int, PendingRejoin] = {}

    def on_left(self, shard: int, cells: Iterable[int]) -> None:
        """Record cells of a shard as lost with their process."""
        self._absent.setdefault(shard, PendingRejoin([])).cells.extend(cells)

    def on_ready(self, shard: int, cells: Iterable[int]) -> None:
        """Record that ``shard`` can send to ``cells`` again."""
        wanted = set(cells)
        for absence in self._absent.values():
            if wanted.issuperset(absence.cells):
                absence.linked.add(shard)

    def to_prepare(self) -> list[PendingRejoin]:
        """Return rejoins to prepare: shards whose units are ready again and that were not announced yet."""
        found: list[PendingRejoin] = []
        for shard, absence in self._absent.items():
            if not self._back(shard):
                absence.prepared = False  # one that was lost again is prepared again
                absence.linked.clear()
            elif not absence.prepared:
                absence.prepared = True
                found.append(absence)
        return found

    def ready_to_commit(self, others: Iterable[int]) -> list[int]:
        """Pop cells whose rejoin can be committed, as all live shards in ``others`` can send to them."""
        wanted = set(others)
        ready = [s for s, absence in self._absent.items() if absence.prepared and absence.linked >= wanted]
        return sorted(cell for shard in ready for cell in self._absent.pop(shard).cells)

    def __bool__(self) -> bool:
        return bool(self._absent)

    def _back(self, shard: int) -> bool:
        """Whether all units of a lost shard are present again, ready and subscribed."""
        roll, units = self._roll, self._units[shard]
        here = roll.ever_left & roll.alive & roll.ready
        return here.issuperset(units) and all(self._matched(unit) for unit in units)
