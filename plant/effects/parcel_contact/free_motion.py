"""Free motion of a group's parcels within a span, without contact, at arbitrary instants."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from plant.effects.parcel_contact.bodies import Group
from plant.solver_api import AdvanceResult, Rewindable, Segment
from plant.wheels import WheelMotion

Floats = NDArray[np.float64]


def later(motion: WheelMotion, after_s: float) -> WheelMotion:
    """The wheels' motion, begun ``after_s`` seconds later."""
    if motion.rate == 0.0 or after_s == 0.0:
        return motion
    return WheelMotion(motion.steady, motion.decay * math.exp(-motion.rate * after_s), motion.rate)


STILL_THERE = ("moving", "tipped")
"""Endings of a parcel's motion that others can go on beside."""


@final
class FreeMotionEnded(Exception):
    """The free motion of a parcel ended early, so that no states exist beyond the end.

    Attributes:
        done: result up to the end, with times from the start of the motion.
    """

    def __init__(self, done: AdvanceResult) -> None:
        super().__init__(done.termination)
        self.done = done


@final
class FreeMotion:
    """Free motion of a group's parcels from their present states.

    Args:
        solver: solver that moves the parcels. `sample` leaves the solver's states anywhere on the motion, `advance` at
            the end of the span.
        group: bodies of the group.
        motion: motion of the wheels, from now on. What loads take from them is added to it by `advance`.
        grip: as for ``Solver.advance``.
    """

    def __init__(self, solver: Rewindable, group: Group, motion: WheelMotion, grip: Floats) -> None:
        self._solver, self._group = solver, group
        self._motion, self._grip = motion, grip
        self._snapshot = solver.snapshot(group.parcels)
        self.start: Floats = group.still.copy()
        self.start[group.moving] = solver.state[group.parcels]

    def sample(self, times: Floats) -> Floats:
        """``(k, b, 6)`` states at ``times`` ``(k,)`` in seconds from the start, ascending and after it.

        Raises:
            FreeMotionEnded: a parcel did not come so far.
        """
        group = self._group
        out = np.empty((len(times), len(self._solver.state), 6))
        self._solver.restore(self._snapshot)
        # a look ahead takes nothing from the wheels
        leg = Segment(replace(self._motion, slowing=None), self._grip, float(times[-1]), times, out)
        results = self._solver.advance(group.parcels, leg)
        states = np.empty((len(times), len(group.names), 6))
        states[:] = group.still
        states[:, group.moving] = out[:, group.parcels]
        for one in results:
            if one.termination not in STILL_THERE:
                raise FreeMotionEnded(one)
            if one.termination != "moving":
                states[times > one.moved_s, np.searchsorted(group.names, one.parcel), 3:] = 0.0
        return states

    def rewind(self) -> None:
        """Put the parcels back to the start."""
        self._solver.restore(self._snapshot)

    def advance(self, span_s: float) -> list[AdvanceResult]:
        """Move the parcels on by ``span_s`` for good. Returns those to which something happened."""
        self._solver.restore(self._snapshot)
        return self._solver.advance(
            self._group.parcels, Segment.through(self._motion, self._grip, span_s, len(self._solver.state))
        )
