"""The kinds of fault that a scene may schedule, and when each acts.

A new kind is a file beside this one and a line in `FAULTS` and `Fault`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from decimal import Decimal

from bus.lattice import Lattice
from deploy.faults.crash import CrashFault

FAULTS: Mapping[str, type[CrashFault]] = {"crash": CrashFault}
"""Spec by kind."""

Fault = CrashFault
"""Any fault of a scene."""

Deaths = dict[int, tuple[int, ...]]
"""Indices of the cells that are dead from a tick on, by that tick."""


def first_tick(at_s: float, period_ns: int) -> int:
    """The first tick whose start is not before ``at_s``, read as the decimal number that was written."""
    return int(-(Decimal(repr(at_s)) * 1_000_000_000 // -period_ns))


def deaths(faults: Iterable[Fault], lattice: Lattice, period_ns: int) -> Deaths:
    """When which cells die. A cell that is to die twice dies the first time.

    Raises:
        KeyError: A fault names a cell that does not exist.
    """
    first: dict[int, int] = {}
    for fault in faults:
        cell, tick = lattice.index(fault.cell), first_tick(fault.at_s, period_ns)
        first[cell] = min(tick, first.get(cell, tick))
    by_tick: dict[int, list[int]] = {}
    for cell in sorted(first):
        by_tick.setdefault(first[cell], []).append(cell)
    return {tick: tuple(cells) for tick, cells in sorted(by_tick.items())}
