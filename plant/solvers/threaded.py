"""Solvers whose kernels move blocks of parcels: as many blocks at a time as there are processors."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from plant.array import CellArray
from plant.kernels.parcels import CHANGES, LEFT_OUT, LOG_CAPACITY, LOGGED, MOVED, REPORT_SIZE, WHICH
from plant.kernels.surface import Surface
from plant.solvers.bodies import LoggedEvents
from plant.solvers.compiled import CompiledSolver
from plant.solvers.crew import Crew
from plant.solvers.solver import Advance, Leg
from plant.specs import ParcelSpec
from plant.wheels import Floats

Work = TypeVar("Work")

WORTH_WAKING = 32
"""Waking a thread costs as much as moving so many parcels by a tick, or one of them by a second."""
SENSED_WORTH_WAKING = 128
"""... and as much as looking for the sensors under so many."""


class Errand(NamedTuple):
    """What is the same for all parcels of a call."""

    surface: Surface
    span_s: float
    times_s: Floats
    out: Floats


class Desk(NamedTuple, Generic[Work]):
    """What one thread works with.

    Attributes:
        work: scratch of the solver's kernels.
        log: ``(rows, 4)``: see ``plant.kernels.layout``.
        report: ``(m, REPORT_SIZE)``: see ``plant.kernels.parcels``.
    """

    work: Work
    log: Floats
    report: Floats


class ThreadedSolver(CompiledSolver, Generic[Work]):
    """A ``plant.solvers.solver.Solver`` but for one block of parcels.

    What becomes of a parcel depends neither on the other parcels of its block nor on the thread.

    Args:
        array: the surface.
        parcels: footprint, mass and start of each.
        rate: of the motors, 1/s; 0 without.

    Attributes:
        crew: the threads.
    """

    def __init__(self, array: CellArray, parcels: tuple[ParcelSpec, ...], rate: float) -> None:
        super().__init__(array, parcels, rate)
        self.crew = Crew()
        self._desks: dict[int, Desk[Work]] = {}

    @abstractmethod
    def _make_work(self) -> Work:
        """Scratch for one thread."""

    @abstractmethod
    def _advance_block(self, desk: Desk[Work], block: NDArray[np.int64], errand: Errand) -> tuple[int, int]:
        """Move the parcels of a block, as many as ``desk.log`` is sure to have room for.

        Returns:
            How many of the block were moved, and how many rows of ``desk.report`` were written.
        """

    def desk(self, thread: int) -> Desk[Work]:
        """What a thread works with, made when it first does."""
        if thread not in self._desks:
            log, report = np.zeros((2 * LOG_CAPACITY, 4)), np.zeros((len(self.parcels), REPORT_SIZE))
            self._desks[thread] = Desk(self._make_work(), log, report)
        return self._desks[thread]

    def advance(self, indices: NDArray[np.int64], leg: Leg) -> list[Advance]:
        """Move some parcels; see ``plant.solvers.solver.Solver``."""
        errand = Errand(self._surface(leg.motion, leg.grip), leg.span_s, leg.times_s, leg.out)

        def move(thread: int, share: slice) -> list[Advance]:
            desk = self.desk(thread)
            return self._move(desk, indices[share], lambda block: self._advance_block(desk, block, errand))

        least = max(1, round(WORTH_WAKING / (1.0 + WORTH_WAKING * leg.span_s)))
        return [news for share in self.crew.share(len(indices), move, least) for news in share]

    def presence(self, indices: NDArray[np.int64], bits: NDArray[np.bool_]) -> None:
        """Set the presence bits ``(n, sensors)`` under those parcels."""

        def mark(_: int, share: slice) -> None:
            self._cover.mark(self.packed, indices[share], bits)

        self.crew.share(len(indices), mark, SENSED_WORTH_WAKING)

    def _move(
        self,
        desk: Desk[Work],
        block: NDArray[np.int64],
        advance: Callable[[NDArray[np.int64]], tuple[int, int]],
    ) -> list[Advance]:
        """Move a block, in as many calls as its events need. Returns the parcels to which something happened.

        Args:
            desk: what the thread works with.
            block: which parcels.
            advance: moves the first of those given; see ``_advance_block``.
        """
        news: list[Advance] = []
        while len(block):
            moved, noted = advance(block)
            block = block[moved:]
            report: list[list[float]] = desk.report[:noted].tolist()
            log = desk.log[: int(sum(told[LOGGED] for told in report))].copy()
            row = 0
            for told in report:
                begin, row = row, row + int(told[LOGGED])
                events = LoggedEvents(log[begin:row])
                done = self._done(int(told[WHICH]), told[MOVED], int(told[CHANGES]), events)
                left_out = int(told[LEFT_OUT])
                # The last event, by which a parcel tips, is told as the ending.
                told_else = left_out > 0 and done.ending == "tipped"
                news.append(done._replace(left_out=left_out - told_else))
        return news
