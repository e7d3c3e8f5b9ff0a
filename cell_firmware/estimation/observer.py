"""Observer of a moving pose from binary sensors: an extended Kalman filter that measures contradictions."""

from __future__ import annotations

from typing import Final, NamedTuple, final

import numpy as np

from cell_firmware.estimation.footprint_residual import (
    Pose,
    Sensors,
    rotate,
    to_parcel_frame,
    total,
    worst_residual,
)
from cell_firmware.firmware import Bools, Floats

CORRECTIONS: Final = 4
"""Contradictions that are resolved in a period, at most."""
_FIRST_CORRECTIONS: Final = 12
_ANGLES: Final = 16
"""Angles that are tried, evenly over half a turn, where nothing is known yet."""
_DIRECTIONS: Final = np.stack(
    (np.cos(np.arange(_ANGLES) * np.pi / _ANGLES), np.sin(np.arange(_ANGLES) * np.pi / _ANGLES)), axis=1
)
_FARTHEST_TURN_RAD: Final = 0.2
_DRIFT: Final = 0.1
"""By how many pitches a guess strays in a second."""
_PACE_PER_S: Final = 2.0
"""Velocity that is gained by the metre of correction."""
_FASTEST_M_S: Final = 2.0
_FASTEST_RAD_S: Final = 10.0


class Belief(NamedTuple):
    """Estimates of n leaders: pose and covariance of each parcel.

    Attributes:
        pose: The best guess.
        spread: ``(n, 3, 3)``, its covariance: place, m, and angle, rad.
    """

    pose: Pose
    spread: Floats


@final
class Observer:
    """Observer of rectangles of known size by the coverage of sensors.

    Between two changes a sensor says no more than on which side of the contour it is. So a contradiction is taken as a
    measurement, "the contour runs through this sensor", and nothing is measured where there is none: a guess that is
    late is put right when a sensor changes before it should, and one that is early because the sensor does not change
    when it should, both to within what the parcel moves in a period. (Contour observers after set-membership
    estimation: Schweppe, IEEE Trans. Automatic Control 13, 1968; the gain is a Kalman filter's.)

    Args:
        half_m: Half the sides of the parcels.
        pitch_m: Distance of neighbouring cells.
        period_s: The control period.
        response_s: Time constant with which a parcel follows wheels that all run alike: under viscous friction
            1 / (mu g).
    """

    def __init__(
        self, half_m: tuple[float, float], pitch_m: float, period_s: float, response_s: float
    ) -> None:
        self._half_m = np.array(half_m)
        self._pitch_m, self._period_s = pitch_m, period_s
        self._rate = period_s / response_s
        metric = np.diag([1.0, 1.0, 1.0 / (half_m[0] * half_m[0] + half_m[1] * half_m[1])])
        self.unsure = (0.4 * pitch_m) ** 2 * metric
        """Spread of a first guess."""
        self.received = (0.1 * pitch_m) ** 2 * metric
        """Spread of a guess that another cell has made."""
        self._drift = (_DRIFT * pitch_m) ** 2 * period_s * metric
        self._fineness = (0.01 * pitch_m) ** 2

    def half_m(self, n: int) -> Floats:
        """``(n, 2)``, half the sides."""
        return np.broadcast_to(self._half_m, (n, 2))

    def begun(self, sensors: Sensors) -> tuple[Belief, Floats]:
        """Make first guesses from the readings alone: of several angles at the centroid, the least contradicted.

        Returns:
            The guesses, at rest; and by how far the worst sensor still contradicts, ``(n,)`` m.
        """
        n = len(sensors.known)
        over = sensors.known & sensors.covered
        weight = np.where(over, 1.0, 0.0)
        number = np.maximum(total(weight), 1.0)
        centre = np.stack(
            (total(weight * sensors.x_m) / number, total(weight * sensors.y_m) / number), axis=1
        )
        many = sensors.take(np.repeat(np.arange(n), _ANGLES))
        pose = Pose(
            np.repeat(centre, _ANGLES, axis=0), np.tile(_DIRECTIONS, (n, 1)), np.zeros((n * _ANGLES, 3))
        )
        belief = Belief(pose, np.broadcast_to(self.unsure, (n * _ANGLES, 3, 3)))
        for _ in range(_FIRST_CORRECTIONS):
            pose = self._corrected(belief, many)[0].pose
            belief = Belief(pose, belief.spread)
        wrong = np.maximum(worst_residual(many, belief.pose, self.half_m(n * _ANGLES))[0], 0.0)
        moved = pose.centre_m - np.repeat(centre, _ANGLES, axis=0)
        score = wrong + 0.05 * np.sqrt(moved[:, 0] * moved[:, 0] + moved[:, 1] * moved[:, 1])
        best = score.reshape(n, _ANGLES).argmin(axis=1) + np.arange(n) * _ANGLES
        found = Pose(pose.centre_m[best], pose.direction[best], np.zeros((n, 3)))
        return Belief(found, np.broadcast_to(self.unsure, (n, 3, 3)).copy()), wrong[best]

    def moved(self, belief: Belief, command: Floats, grip: Floats) -> Belief:
        """Predict the estimates a period ahead.

        Args:
            belief: Current estimates.
            command: ``(n, 3)``, velocity and angular velocity commanded to the wheels.
            grip: ``(n,)``, share of the load on wheels that drive.
        """
        pose, spread = belief
        dt, follow = self._period_s, (self._rate * grip)[:, None]
        centre = pose.centre_m + dt * pose.motion[:, :2]
        direction = rotate(pose.direction, dt * pose.motion[:, 2])
        motion = pose.motion + follow * (command - pose.motion)
        return Belief(Pose(centre, direction, motion), spread + self._drift)

    def corrected(self, belief: Belief, sensors: Sensors) -> tuple[Belief, Floats]:
        """Correct the estimates by resolving the worst contradictions, one after another.

        Returns:
            The belief, and how far the worst sensor contradicted it before, ``(n,)`` m.
        """
        change, first = np.zeros((len(belief.spread), 3)), np.zeros(len(belief.spread))
        for number in range(CORRECTIONS):
            belief, more, wrong = self._corrected(belief, sensors)
            change, first = change + more, np.where(number == 0, np.maximum(wrong, 0.0), first)
            if not (wrong > 0.0).any():
                break
        limits = (_FASTEST_M_S, _FASTEST_M_S, _FASTEST_RAD_S)
        motion = np.clip(belief.pose.motion + _PACE_PER_S * change, np.negative(limits), limits)
        return Belief(belief.pose._replace(motion=motion), belief.spread), first

    def _corrected(self, belief: Belief, sensors: Sensors) -> tuple[Belief, Floats, Floats]:
        """Resolve the worst contradiction; return the estimate, its change, and the contradiction, m."""
        pose, spread = belief
        wrong, slope = worst_residual(sensors, pose, self.half_m(len(pose.centre_m)))
        any_ = wrong > 0.0
        error = np.where(any_, wrong, 0.0)
        carried = (
            spread[:, :, 0] * slope[:, :1] + spread[:, :, 1] * slope[:, 1:2] + spread[:, :, 2] * slope[:, 2:]
        )
        late = (
            self._period_s
            * self._period_s
            * (pose.motion[:, 0] * pose.motion[:, 0] + pose.motion[:, 1] * pose.motion[:, 1])
        )
        variance = (
            carried[:, 0] * slope[:, 0] + carried[:, 1] * slope[:, 1] + carried[:, 2] * slope[:, 2]
        ) + (self._fineness + late)
        change = carried * (-error / variance)[:, None]
        change[:, 2] = np.clip(change[:, 2], -_FARTHEST_TURN_RAD, _FARTHEST_TURN_RAD)
        after = Pose(pose.centre_m + change[:, :2], rotate(pose.direction, change[:, 2]), pose.motion)
        gain = np.where(any_, 1.0 / variance, 0.0)[:, None, None]
        smaller = spread - carried[:, :, None] * carried[:, None, :] * gain
        return Belief(after, smaller), change, wrong


class Footing(NamedTuple):
    """Support of n parcels by live cells and silent cells.

    Attributes:
        grip: ``(n,)``, share of the load on cells that live.
        shift_m: ``(n, 2)``, from the centre to the mean, by load, of the cells that live.
    """

    grip: Floats
    shift_m: Floats


def footing(cells: Sensors, pose: Pose, half_m: Floats) -> Footing:
    """Compute the support of parcels, with loads as on equal springs under a flat bottom: affine in position.

    Args:
        cells: Centres of the cells around; ``known`` marks live cells.
        pose: Poses of the parcels.
        half_m: ``(n, 2)``, half their sides.
    """
    along, across = to_parcel_frame(cells, pose)
    under = (abs(along) <= half_m[:, :1]) & (abs(across) <= half_m[:, 1:])
    one = np.where(under, 1.0, 0.0)
    number = np.maximum(total(one), 1.0)
    mean_a, mean_b = total(one * along) / number, total(one * across) / number
    a, b = one * (along - mean_a[:, None]), one * (across - mean_b[:, None])
    aa, ab, bb = total(a * a), total(a * b), total(b * b)
    det = aa * bb - ab * ab
    fit = det > 1e-9 * (aa + bb) * (aa + bb)
    safe = np.where(fit, det, 1.0)
    tilt_a = np.where(fit, number * (ab * mean_b - bb * mean_a) / safe, 0.0)
    tilt_b = np.where(fit, number * (ab * mean_a - aa * mean_b) / safe, 0.0)
    load = np.maximum(one + tilt_a[:, None] * a + tilt_b[:, None] * b, 0.0)
    alive: Bools = cells.known
    living = np.where(alive, load, 0.0)
    sum_living, missing = total(living), np.where(alive, 0.0, load)
    grips = sum_living > 0.0
    per = np.where(grips, sum_living, 1.0)
    shift_a, shift_b = (-total(missing * along) / per, -total(missing * across) / per)
    ux, uy = pose.direction[:, 0], pose.direction[:, 1]
    shift = np.stack((ux * shift_a - uy * shift_b, uy * shift_a + ux * shift_b), axis=1)
    return Footing(
        sum_living / np.maximum(sum_living + total(missing), 1e-9), np.where(grips[:, None], shift, 0.0)
    )
