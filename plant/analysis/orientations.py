"""Rest orientations of a parcel: angles at which its torque changes sign, and intervals without torque."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, final

import numpy as np
from numpy.typing import NDArray

from plant.analysis.crossings import TURN
from plant.wheels import Floats

Nature = Literal["attracting", "repelling", "neutral"]


@final
@dataclass(frozen=True, slots=True)
class Orientation:
    """An angle at which the torque changes its sign, or an interval without torque.

    Attributes:
        low_rad: where it begins, in [0, 2 pi).
        high_rad: where it ends, counter-clockwise of ``low_rad``; the same where it is a single angle.
        nature: ``attracting``: the torque on both sides turns the parcel towards it. ``repelling``: away from it.
            ``neutral``, intervals only: neither; a parcel may come to rest in it, and one pushed out on a side may not
            come back.
        before_n_m: torque just below it; None where the parcel doesn't stand there, or the interval is a whole turn.
        after_n_m: torque just above it; None likewise.
    """

    low_rad: float
    high_rad: float
    nature: Nature
    before_n_m: float | None
    after_n_m: float | None

    @property
    def is_interval(self) -> bool:
        """Whether it is an interval without torque, not a single angle."""
        return self.high_rad > self.low_rad

    @property
    def stable(self) -> bool:
        """Whether a parcel turned out of it, either way, is turned back."""
        return self.nature == "attracting"

    def away_from(self, angle_rad: float) -> float:
        """How far outside an angle lies, rad, the shorter way round; 0 where it lies in it."""
        beyond = float(np.mod(angle_rad - self.low_rad, TURN))
        width = self.high_rad - self.low_rad
        return 0.0 if beyond <= width else min(beyond - width, TURN - beyond)


@final
@dataclass(frozen=True, slots=True)
class TorqueProfile:
    """Torque of a parcel over its angle, a step function, with the centre of mass fixed at one point.

    Attributes:
        centre_m: ``(2,)`` that point.
        angles_rad: ``(m,)`` where the cells below change, ascending in [0, 2 pi).
        torque_n_m: ``(max(m, 1),)`` from each of these angles to the next, the last round to the first; exactly 0 where
            there is none, NaN where the parcel doesn't stand.
        force_n: ``(max(m, 1), 2)`` likewise. Zero all round where the point is an equilibrium at every angle.
        supports: ``(max(m, 1),)`` likewise: how many cells carry the parcel.
    """

    centre_m: Floats
    angles_rad: Floats
    torque_n_m: Floats
    force_n: Floats
    supports: NDArray[np.intp]

    def torque_at(self, angles_rad: Floats) -> Floats:
        """``(k,)`` N m at any angles ``(k,)``; at a step, that above it."""
        step = np.searchsorted(self.angles_rad, np.mod(angles_rad, TURN), side="right") - 1
        return self.torque_n_m[step]

    def largest_force_n(self) -> float:
        """Return the largest net force over all angles, N; 0 where the point is an equilibrium at every angle."""
        return float(np.nanmax(np.hypot(self.force_n[:, 0], self.force_n[:, 1])))

    def orientations(self) -> tuple[Orientation, ...]:
        """Find the zeros and sign changes of the torque, by ascending angle."""
        # 1, 0, -1, or NaN where the parcel doesn't stand
        sign = np.sign(self.torque_n_m)
        begins = np.flatnonzero(sign != np.roll(sign, 1))
        if not len(begins):
            return (Orientation(0.0, TURN, "neutral", None, None),) if sign[0] == 0.0 else ()
        found: list[Orientation] = []
        for here, following in pairwise([*begins.tolist(), int(begins[0])]):
            before, now = float(self.torque_n_m[here - 1]), float(self.torque_n_m[here])
            low = float(self.angles_rad[here])
            if now == 0.0:
                after, high = float(self.torque_n_m[following]), float(self.angles_rad[following])
                found.append(_orientation(low, high if high > low else high + TURN, before, after))
            elif before * now < 0.0:
                found.append(_orientation(low, low, before, now))
        return tuple(found)

    def stable(self) -> tuple[Orientation, ...]:
        """The attracting ones of `orientations`: an angle where the torque falls through zero, or an interval."""
        return tuple(one for one in self.orientations() if one.stable)


def _orientation(low: float, high: float, before: float, after: float) -> Orientation:
    nature: Nature = "neutral"
    if before > 0.0 > after:
        nature = "attracting"
    elif before < 0.0 < after:
        nature = "repelling"
    return Orientation(
        low, high, nature, None if np.isnan(before) else before, None if np.isnan(after) else after
    )
