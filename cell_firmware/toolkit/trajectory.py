"""Journeys: where a reference pose is after a time, leg by leg."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from cell_firmware.specs import Finite, NotNegative, Spec, Vector

Floats = NDArray[np.float64]


class TrajectorySegment(Spec):
    """Segment of a journey: a translation, a rotation, both at once, or a pause."""

    to_m: Vector | None = None
    """End of the segment, m; default: its beginning."""
    turn_rad: Finite = 0.0
    """Angle of the rotation, counter-clockwise."""
    wait_s: NotNegative = 0.0
    """Duration of a pause, instead of a motion."""

    @model_validator(mode="after")
    def _moves_or_waits(self) -> TrajectorySegment:
        moves = self.to_m is not None or self.turn_rad != 0.0
        if moves == (self.wait_s > 0.0):
            raise ValueError("give wait_s, or to_m or turn_rad or both of these")
        return self


@final
@dataclass(frozen=True, slots=True)
class Setpoint:
    """Reference poses, and how they move.

    Attributes:
        x: m, in an array of any shape, like the others.
        y: m.
        angle: rad.
        vx: m/s.
        vy: m/s.
        turning: rad/s.
        ended: Whether the journey is over.
    """

    x: Floats
    y: Floats
    angle: Floats
    vx: Floats
    vy: Floats
    turning: Floats
    ended: NDArray[np.bool_]


@final
class ReferenceTrajectory:
    """Legs one after the other, each at one speed and one rate of turning, begun and ended at once.

    A leg takes as long as the slower of its two motions at its greatest speed, and the other is slowed down to end
    with it.

    Args:
        start: x and y, m, and angle, rad.
        legs: In their order.
        speed_m_s: Of a leg that moves, at most.
        turn_rate_rad_s: Of a leg that turns, at most.
    """

    def __init__(
        self,
        start: tuple[float, float, float],
        legs: tuple[TrajectorySegment, ...],
        speed_m_s: float,
        turn_rate_rad_s: float,
    ) -> None:
        here: Floats = np.array(start)
        time = 0.0
        begins, poses = [0.0], [here]
        speeds: list[Floats] = []
        for leg in legs:
            there: Floats = np.array([*(here[:2] if leg.to_m is None else leg.to_m), here[2] + leg.turn_rad])
            displacement = there - here
            distance = float(np.sqrt(displacement[0] * displacement[0] + displacement[1] * displacement[1]))
            took = leg.wait_s or max(distance / speed_m_s, abs(leg.turn_rad) / turn_rate_rad_s)
            speeds.append(displacement / took if took else displacement)
            time, here = time + took, there
            begins.append(time)
            poses.append(here)
        speeds.append(np.zeros(3))
        self.duration_s = time
        self._begin: Floats = np.array(begins)
        self._pose: Floats = np.array(poses)
        self._speed: Floats = np.array(speeds)

    def at(self, time_s: Floats) -> Setpoint:
        """The reference after times of at least 0, ``(n,)`` s."""
        leg = np.searchsorted(self._begin, time_s, side="right") - 1
        speed = self._speed[leg]
        pose = self._pose[leg] + speed * (time_s - self._begin[leg])[:, None]
        ended = leg == len(self._begin) - 1
        x, y, angle = pose.T
        vx, vy, turning = speed.T
        return Setpoint(x, y, angle, vx, vy, turning, ended)


def at_all(journeys: tuple[ReferenceTrajectory, ...], time_s: Floats) -> Setpoint:
    """The references of journeys after times ``(n, journeys)`` s, in the same shape."""
    found = [journey.at(time_s[:, j]) for j, journey in enumerate(journeys)]

    def together(part: str) -> NDArray[Any]:
        return np.stack([getattr(reference, part) for reference in found], axis=1)

    x, y, angle, vx, vy, turning, ended = (together(part.name) for part in fields(Setpoint))
    return Setpoint(x, y, angle, vx, vy, turning, ended)
