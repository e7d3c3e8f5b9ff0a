"""Cells that come back: from the tokens of their new process to the tick from which they take part again.

A process that is started in the place of one that went shows its tokens as any does. That it can be sent to is known
to nobody but those who send: so the plant asks all shards (``joining``), each answers when it can (``linked``), and at
the next tick boundary all are told from which tick on they wait for each other again (``joined``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import final

from bus.roll import Roll


@final
@dataclass(slots=True)
class Absence:
    """A shard that went.

    Attributes:
        cells: Those that went with it, by index.
        asked: Whether the others have been asked.
        linked: Shards that have answered.
    """

    cells: list[int]
    asked: bool = False
    linked: set[int] = field(default_factory=set[int])


@final
class Returns:
    """Keeps the shards that went, and says which of them can take part again.

    Args:
        roll: Of the run.
        units: Of each shard.
        matched: Whether a unit can be sent to.
    """

    def __init__(self, roll: Roll, units: Sequence[Sequence[int]], matched: Callable[[int], bool]) -> None:
        self._roll = roll
        self._units = units
        self._matched = matched
        self._absent: dict[int, Absence] = {}

    def left(self, shard: int, cells: Iterable[int]) -> None:
        """Cells of a shard went, as their process did."""
        self._absent.setdefault(shard, Absence([])).cells.extend(cells)

    def linked(self, shard: int, cells: Iterable[int]) -> None:
        """A shard can send to ``cells`` again."""
        wanted = set(cells)
        for absence in self._absent.values():
            if wanted.issuperset(absence.cells):
                absence.linked.add(shard)

    def to_ask(self) -> list[Absence]:
        """Those that are back, and of whom nobody has been asked yet."""
        found: list[Absence] = []
        for shard, absence in self._absent.items():
            if not self._back(shard):
                absence.asked = False  # one that went again is asked about again
                absence.linked.clear()
            elif not absence.asked:
                absence.asked = True
                found.append(absence)
        return found

    def back(self, others: Iterable[int]) -> list[int]:
        """Cells that take part again from now on, to whom all ``others`` (shards that live) can send."""
        wanted = set(others)
        ready = [s for s, absence in self._absent.items() if absence.asked and absence.linked >= wanted]
        return sorted(cell for shard in ready for cell in self._absent.pop(shard).cells)

    def __bool__(self) -> bool:
        return bool(self._absent)

    def _back(self, shard: int) -> bool:
        """Whether all of a shard's units went, came again, are ready, and can be sent to."""
        roll, units = self._roll, self._units[shard]
        here = roll.left & roll.alive & roll.ready
        return here.issuperset(units) and all(self._matched(unit) for unit in units)
