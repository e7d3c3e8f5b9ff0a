"""A rectangle among sensors: which of them contradict where it is believed to be, and how it would have to move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Bools, Floats


class Pose(NamedTuple):
    """Poses and velocities of n rectangles.

    Attributes:
        centre_m: ``(n, 2)``.
        direction: ``(n, 2)``, unit vector along the first side.
        motion: ``(n, 3)``: velocity of the centre, m/s, and angular velocity, rad/s.
    """

    centre_m: Floats
    direction: Floats
    motion: Floats


class Sensors(NamedTuple):
    """Sensor readings gathered by n leaders, m sensors each.

    Attributes:
        x_m: ``(n, m)``, where they are.
        y_m: ``(n, m)``.
        known: ``(n, m)``: is there a word from it?
        covered: ``(n, m)``: was there a parcel over it?
        age_s: ``(m,)``, how old the word is.
    """

    x_m: Floats
    y_m: Floats
    known: Bools
    covered: Bools
    age_s: Floats

    def take(self, rows: NDArray[np.int64]) -> Sensors:
        """Select the readings of ``rows``, in order."""
        return Sensors(self.x_m[rows], self.y_m[rows], self.known[rows], self.covered[rows], self.age_s)


def total(values: NDArray[np.float64]) -> Floats:
    """``(n,)``, sums of ``(n, m)`` over m, each in an order that does not depend on n."""
    while values.shape[1] > 1:
        half = values.shape[1] // 2
        folded = values[:, :half] + values[:, half : 2 * half]
        if values.shape[1] % 2:
            folded[:, 0] += values[:, -1]
        values = folded
    return values[:, 0]


def to_parcel_frame(sensors: Sensors, pose: Pose) -> tuple[Floats, Floats]:
    """Sensors in the axes of the rectangles, ``(n, m)`` each: where the parcel has carried what they told by now."""
    dx, dy = sensors.x_m - pose.centre_m[:, :1], sensors.y_m - pose.centre_m[:, 1:]
    vx, vy, spin = pose.motion[:, :1], pose.motion[:, 1:2], pose.motion[:, 2:]
    x, y = dx + (vx - spin * dy) * sensors.age_s, dy + (vy + spin * dx) * sensors.age_s
    ux, uy = pose.direction[:, :1], pose.direction[:, 1:]
    return ux * x + uy * y, ux * y - uy * x


def worst_residual(sensors: Sensors, pose: Pose, half_m: Floats) -> tuple[Floats, Floats]:
    """The sensor that contradicts a pose the most, one of each of n.

    A sensor contradicts by how far it is on the wrong side of the nearest edge: outside though it senses the
    parcel, or inside though it senses none.

    Args:
        sensors: What is known.
        pose: What is believed.
        half_m: ``(n, 2)``, half the rectangles' sides.

    Returns:
        ``(n,)``, how far, m; negative where none does. ``(n, 3)``, how much farther if the centre moved
        by a metre along x, along y, and the rectangle turned by a radian.
    """
    along, across = to_parcel_frame(sensors, pose)
    beyond_along, beyond_across = abs(along) - half_m[:, :1], abs(across) - half_m[:, 1:]
    outside = np.maximum(beyond_along, beyond_across)
    wrong = np.where(sensors.known, np.where(sensors.covered, outside, -outside), -np.inf)
    one = wrong.argmax(axis=1)
    every = np.arange(len(one))
    a, b = along[every, one], across[every, one]
    end = beyond_along[every, one] > beyond_across[every, one]
    towards = np.where(sensors.covered[every, one], 1.0, -1.0) * np.where(
        np.where(end, a, b) < 0.0, -1.0, 1.0
    )
    ux, uy = pose.direction[:, 0], pose.direction[:, 1]
    slope = np.stack(
        (np.where(end, -ux, uy) * towards, np.where(end, -uy, -ux) * towards, np.where(end, b, -a) * towards),
        axis=1,
    )
    return wrong[every, one], slope


def rotate(direction: Floats, angle_rad: Floats) -> Floats:
    """Unit vectors ``(n, 2)`` turned by small angles ``(n,)``, to first order and back to unit length."""
    x = direction[:, 0] - angle_rad * direction[:, 1]
    y = direction[:, 1] + angle_rad * direction[:, 0]
    length = np.sqrt(x * x + y * y)
    return np.stack((x / length, y / length), axis=1)
