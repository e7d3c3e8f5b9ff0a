"""Messages about lost cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, get_args

from bus.lockstep.counters import Loss, Reason

Places = Sequence[tuple[int, int]]
"""``(row, column)`` of every cell, in the lattice's order."""

_WORDS: Final = {"disconnected": "its process disconnected", "timed_out": "it did not answer in time"}
_REASONS: Final[tuple[Reason, ...]] = get_args(Reason)
_NAMED: Final = 6
"""Most cells that a line names; further cells are counted."""


def found(faults: Sequence[Mapping[str, Any]], places: Places) -> list[Loss]:
    """Return the losses among recorded faults, which are neither scheduled nor injected."""
    index = {place: cell for cell, place in enumerate(places)}
    return [
        Loss(index[row, column], fault["tick"], fault["kind"], fault["detail"])
        for fault in faults
        if fault["kind"] in _REASONS
        for row, column in [fault["cell"]]
    ]


def lines(losses: Sequence[Loss], places: Places, period_ns: int) -> list[str]:
    """Describe losses, one line for all cells lost in the same tick for the same reason."""
    alike: dict[tuple[int, str], list[str]] = {}
    for loss in losses:
        row, column = places[loss.cell]
        alike.setdefault((loss.tick, _why(loss)), []).append(f"{row},{column}")
    described: list[str] = []
    for (tick, why), names in alike.items():
        described.append(f"{_cells(names)} lost in {_when(tick, period_ns)}: {why}")
    return described


def rejoined(cells: Sequence[int], places: Places, tick: int, period_ns: int) -> str:
    """Describe cells (indices) that rejoin at ``tick``."""
    names = [f"{row},{column}" for row, column in map(places.__getitem__, cells)]
    return f"{_cells(names)} rejoined in {_when(tick, period_ns)}, as after power-on"


def unreported(cells: Sequence[int], places: Places) -> str:
    """Describe cells (indices) whose messages are missing from the counters."""
    names = [f"{row},{column}" for row, column in map(places.__getitem__, cells)]
    return f"messages of {_cells(names)} were not counted: no report arrived in time"


def failure(losses: Sequence[Loss], places: Places, period_ns: int) -> str:
    """Describe the first of the programs that failed in a tick, and count the others; cells ascend."""
    first, more = losses[0], len(losses) - 1
    row, column = places[first.cell]
    others = f"; {more} cell{'s' if more > 1 else ''} more failed in that tick" if more else ""
    return (
        f"the program of cell {row},{column} failed in {_when(first.tick, period_ns)}: {_why(first)}{others}"
    )


def nobody(losses: Sequence[Loss], places: Places, period_ns: int) -> str:
    """Explain from the losses why no cell is left at the end of a run."""
    named = lines(losses, places, period_ns)
    more = f"; and {len(named) - 3} more losses" if len(named) > 3 else ""
    causes = "; ".join(named[:3]) or "faults injected during the run killed them"
    return f"no cell was alive at the end: {causes}{more}"


def _cells(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f"cell{'s' if len(names) > 1 else ''} {' '.join(names[:_NAMED])}{more}"


def _when(tick: int, period_ns: int) -> str:
    return f"tick {tick} ({tick * period_ns * 1e-9:g} s)"


def _why(loss: Loss) -> str:
    """Return the cause in one line; of a traceback, its last line."""
    written = [line for line in loss.detail.splitlines() if line.strip()]
    return _WORDS.get(loss.reason) or (written[-1].strip() if written else loss.reason)
