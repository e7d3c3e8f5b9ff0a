"""Invariants of a program: conditions on the registers of all cells, evaluated tick by tick."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final, Literal, cast, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.array_view import ArrayView, Violation
from cell_firmware.errors import FirmwareError
from cell_firmware.hooks import refusals
from cell_firmware.program import Program

_SHOWN: Final = 60
"""Characters of a wrong value that an error shows."""


def declares_invariants(program: Program) -> bool:
    """Whether a program has invariants, or conditions that come true eventually."""
    own = program.author
    return any(
        getattr(type(own), hook) is not getattr(Program, hook) for hook in ("invariants", "eventually")
    )


@final
class InvariantMonitor:
    """Monitor of a program's invariants and eventual conditions, in order of ticks.

    A condition of ``eventually`` is due ``ticks`` ticks after the first view, after the last disturbance, and after it
    was last true; where messages take several ticks, that many times as long. A disturbance is a fault that begins or
    ends, each tick of a fault of links or sensors that will end, and each change of the running cells.

    Args:
        program: The cells' program.
        name: Name of the program in errors.
    """

    def __init__(self, program: Program, name: str) -> None:
        self._program = program.author
        self._name = name
        self._since: dict[str, int] = {}
        self._running: tuple[tuple[int, int], ...] | None = None

    def check(self, view: ArrayView, *, disturbed: bool = False) -> list[Violation]:
        """Evaluate all conditions after a tick.

        Args:
            view: The registers.
            disturbed: Whether a fault begins, ends or is temporary in this tick.

        Raises:
            FirmwareError: The program's conditions raised, or yielded something else than conditions.
        """
        if self._running != view.cells:
            disturbed, self._running = True, view.cells
        found, awaited = self.evaluate(view)
        self._since = {
            one.rule: view.tick if disturbed else self._since.get(one.rule, view.tick) for one, _ in awaited
        }
        for one, ticks in awaited:
            if view.tick - self._since[one.rule] >= ticks:
                found.append(one)
                self._since[one.rule] = view.tick
        return found

    def evaluate(self, view: ArrayView) -> tuple[list[Violation], list[tuple[Violation, int]]]:
        """Evaluate all conditions on their own, without regard to earlier ticks.

        Returns:
            Broken invariants; and eventual conditions that are false, with their ticks.

        Raises:
            FirmwareError: The program's conditions raised, or yielded something else than conditions.
        """
        broken = [
            _violation("always", rule, view, holds)
            for rule, holds, _ in self._conditions("invariants", view)
            if not np.all(holds)
        ]
        awaited = [
            (_violation("eventually", rule, view, holds), ticks * view.link_ticks)
            for rule, holds, ticks in self._conditions("eventually", view)
            if not np.all(holds)
        ]
        return broken, awaited

    def waiting(self, tick: int) -> tuple[tuple[str, int], ...]:
        """Return for how many ticks each eventual condition has been false after ``tick``, sorted."""
        return tuple(sorted((rule, tick - since) for rule, since in self._since.items()))

    def resume(
        self, tick: int, waiting: Iterable[tuple[str, int]], running: tuple[tuple[int, int], ...]
    ) -> None:
        """Continue after ``tick`` from what ``waiting`` returned, with these running cells."""
        self._since = {rule: tick - age for rule, age in waiting}
        self._running = running

    def _conditions(self, hook: str, view: ArrayView) -> Iterator[tuple[str, Any, int]]:
        """Yield rule, truth and number of ticks of each condition of a hook."""
        if getattr(type(self._program), hook) is getattr(Program, hook):
            return
        with refusals(self._name, f"{hook}()"):
            view.forget_reads()
            for condition in getattr(self._program, hook)(view):
                yield _parsed(condition, hook, len(view))
                view.forget_reads()


def _parsed(condition: Any, hook: str, cells: int) -> tuple[str, Any, int]:
    """Check the form of a condition.

    Raises:
        FirmwareError: It is no condition.
    """
    wanted = "(rule, holds)" if hook == "invariants" else "(rule, holds, ticks)"
    if not (isinstance(condition, tuple) and len(condition) == wanted.count(",") + 1):  # pyright: ignore[reportUnknownArgumentType]
        given = f"{len(condition)} values" if isinstance(condition, tuple) else repr(condition)[:_SHOWN]  # pyright: ignore[reportUnknownArgumentType]
        raise FirmwareError(f"{hook}() must yield {wanted}, not {given}")
    values: list[Any] = list(cast("tuple[Any, ...]", condition))
    rule, ticks = values[0], values[2] if len(values) > 2 else 0
    if not isinstance(rule, str):
        raise FirmwareError(f"{hook}() must yield {wanted}, with a rule in words, not {rule!r}")
    truth: NDArray[Any] = np.asarray(values[1])
    if truth.dtype != np.bool_ or truth.shape not in ((), (cells,)):
        raise FirmwareError(
            f"{hook}(): {rule!r}: must be one truth value, or one for each of {cells} cells, not {truth.dtype} of "
            f"shape {truth.shape}"
        )
    if not isinstance(ticks, int) or ticks < 0:
        raise FirmwareError(f"{hook}(): {rule!r}: ticks must be a whole number from 0, not {ticks!r}")
    return rule, truth, ticks


def _violation(kind: Literal["always", "eventually"], rule: str, view: ArrayView, holds: Any) -> Violation:
    wrong = np.flatnonzero(~np.broadcast_to(holds, (len(view),))).tolist()
    rows = [view.values(row) for row in wrong]
    names = rows[0] if rows else {}
    values = {name: tuple(row[name] for row in rows) for name in names}
    return Violation(kind, rule, view.tick, tuple(view.cells[row] for row in wrong), values)
