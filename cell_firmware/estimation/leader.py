"""Pose estimation by a group's leader, and propagation of the pose to followers."""

from __future__ import annotations

from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.estimation import occupancy as pattern
from cell_firmware.estimation.election import ElectionState
from cell_firmware.estimation.footprint_residual import Pose, Sensors, rotate, worst_residual
from cell_firmware.estimation.observer import Belief, Observer, footing
from cell_firmware.firmware import Floats, Inbox, State
from cell_firmware.specs import Positive, Spec

SHOWN: Final = {
    "x_m": ("centre_m", 0),
    "y_m": ("centre_m", 1),
    "along_x": ("direction", 0),
    "along_y": ("direction", 1),
    "vx_m_s": ("motion", 0),
    "vy_m_s": ("motion", 1),
    "spin_rad_s": ("motion", 2),
    "shift_x_m": ("shift_m", 0),
    "shift_y_m": ("shift_m", 1),
}
"""Field of a message to array and column of the state."""
FIELDS: Final = [
    *((name, "<f4" if array == "centre_m" else "<f2") for name, (array, _) in SHOWN.items()),
    ("age", "u1"),
]
"""Fields of the pose in a message: 23 bytes."""
UNKNOWN: Final = 255
"""Age of a pose where there is none."""
_SETTLE: Final = 8
"""Periods, and as many more for each sensor of a cell, for which a new leader gathers the pattern before it guesses."""
_SMOOTHED: Final = 0.05
_STRANGE: Final = 0.3
"""Contradiction, in pitches, with which a pose is not believed for long."""
_STRANGE_PERIODS: Final = 16
_DOUBTFUL: Final = 0.02
"""Contradiction, in pitches, from which it is tested whether the parcel's sides are mistaken for each other."""
_DOUBT_PERIODS: Final = 32


class EstimatorParameters(Spec):
    """Parcel parameters of the estimator."""

    size_m: tuple[Positive, Positive]
    """Length along a parcel's x and along its y."""
    response_s: Positive = 0.5
    """Time constant with which a parcel follows wheels that all run alike: under viscous friction 1 / (mu g)."""


def followed(state: State, place: ElectionState, inbox: Inbox, period_s: float) -> dict[str, NDArray[Any]]:
    """Extrapolate the pose by a period: the parent's pose if it is no older than the cell's own, else the own."""
    views = {name: state[name] for name in ("centre_m", "direction", "motion", "shift_m", "age")}
    views = {name: array.copy() for name, array in views.items()}
    for side in range(4):
        word = inbox.message[:, side]
        age = word["age"].astype(np.int64)
        take = inbox.received[:, side] & (place.parent == side) & (age < UNKNOWN) & (age <= views["age"])
        for name, (array, column) in SHOWN.items():
            views[array][:, column] = np.where(take, word[name], views[array][:, column])
        views["age"] = np.where(take, age, views["age"])
    views["centre_m"] += period_s * views["motion"][:, :2]
    known = views["age"] < UNKNOWN
    direction = np.where(known[:, None], views["direction"], (1.0, 0.0))
    views["direction"] = rotate(direction, period_s * views["motion"][:, 2])
    views["age"] = np.where(known, views["age"] + 1, UNKNOWN)
    return views


@final
class Leader:
    """Estimate of n groups, advanced a period at a time.

    Args:
        parameters: Parameters of the protocol.
        site: Pitch, m; control period, s; places of the sensors, x and y in turn, m.
    """

    def __init__(self, parameters: EstimatorParameters, site: Floats) -> None:
        self._pitch_m, period_s = float(site[0]), float(site[1])
        sensors_m = site[2:].reshape(-1, 2)
        half_m = (parameters.size_m[0] / 2.0, parameters.size_m[1] / 2.0)
        self._observer = Observer(half_m, self._pitch_m, period_s, parameters.response_s)
        self._oblong = half_m[0] != half_m[1]
        self._settle = _SETTLE * (1 + len(sensors_m))
        self._places = pattern.places(sensors_m, self._pitch_m)
        self._cells = pattern.places(np.zeros((1, 2)), self._pitch_m)
        self._age_s: Floats = pattern.hops(len(sensors_m)) * np.float64(period_s)

    def step(self, before: State, whole: pattern.OccupancyMap, command: Floats) -> dict[str, NDArray[Any]]:
        """Advance the estimate by a period.

        Args:
            before: The leaders' state in the last period; for new leaders, the pose received.
            whole: The gathered occupancy map.
            command: ``(n, 3)``, rigid motion commanded to the wheels.
        """
        observer, n = self._observer, len(command)
        sensors = self._sensors(before, whole)
        new, old = ~before["leads"], before["age"] < UNKNOWN
        spread = np.where(new[:, None, None], observer.received, before["spread"])
        direction = np.where(old[:, None], before["direction"], (1.0, 0.0))
        pose = Pose(before["centre_m"], direction, before["motion"])
        belief = observer.moved(Belief(pose, spread), command, before["grip"])
        belief, wrong = observer.corrected(belief, sensors)

        young = np.where(new, 0, np.minimum(before["young"] + 1, self._settle))
        settled = young == self._settle
        wrong_here = wrong > _STRANGE * self._pitch_m
        strange = np.where(old & wrong_here, np.where(new, 0, before["strange"]) + 1, 0)
        begins = (~old & settled) | (strange > _STRANGE_PERIODS)
        belief = self._begun(belief, sensors, np.flatnonzero(begins))
        doubt = np.where(old & ~begins & ~new, before["doubt"], 0)
        if self._oblong:
            contradicted = np.flatnonzero(old & ~begins & (wrong > 0.0))
            belief, doubt = self._doubted(belief, sensors, doubt, contradicted)
        known = old | begins

        foot = footing(self._wheels(before, sensors), belief.pose, observer.half_m(n))
        share = np.where(settled, np.where(old, _SMOOTHED, 1.0), 0.0)
        return {
            "centre_m": belief.pose.centre_m,
            "direction": belief.pose.direction,
            "motion": belief.pose.motion,
            "spread": belief.spread,
            "grip": before["grip"] + share * (foot.grip - before["grip"]),
            "shift_m": before["shift_m"] + share[:, None] * (foot.shift_m - before["shift_m"]),
            "age": np.where(known, 0, UNKNOWN),
            "young": young,
            "strange": np.where(begins, 0, strange),
            "doubt": doubt,
        }

    def _doubted(
        self, belief: Belief, sensors: Sensors, doubt: NDArray[np.int64], rows: NDArray[np.int64]
    ) -> tuple[Belief, NDArray[np.int64]]:
        """Turn estimates by 90 degrees where that has long contradicted less: nearly equal sides are easily mistaken.

        Args:
            belief: Estimates corrected by the sensors.
            sensors: Readings of the sensors.
            doubt: Counter of periods in which a turn by 90 degrees would have been better.
            rows: Rows of contradicted estimates.
        """
        observer, doubt = self._observer, np.maximum(doubt, 1) - 1
        if not len(rows):
            return belief, doubt
        readings, half_m = sensors.take(rows), observer.half_m(len(rows))
        own = Pose(*(array[rows] for array in belief.pose))
        aside = own._replace(direction=np.stack((-own.direction[:, 1], own.direction[:, 0]), axis=1))
        spread = np.broadcast_to(observer.received, (len(rows), 3, 3)).copy()
        other = observer.corrected(Belief(aside, spread), readings)[0].pose
        gain = worst_residual(readings, own, half_m)[0] - np.maximum(
            worst_residual(readings, other, half_m)[0], 0.0
        )
        counts = doubt[rows] + np.where(gain > _DOUBTFUL * self._pitch_m, 2, 0)
        turns = counts > _DOUBT_PERIODS
        pose, found = [array.copy() for array in belief.pose], belief.spread.copy()
        for array, mine, new in zip(pose, own, other._replace(motion=own.motion), strict=True):
            array[rows] = np.where(turns[:, None], new, mine)
        found[rows] = np.where(turns[:, None, None], observer.unsure, found[rows])
        doubt[rows] = np.where(turns, 0, counts)
        return Belief(Pose(*pose), found), doubt

    def _sensors(self, before: State, whole: pattern.OccupancyMap) -> Sensors:
        n, place = len(before["row"]), before["position_m"]
        known = pattern.unfolded(whole.known, before["row"], before["column"]).reshape(n, -1)
        covered = pattern.unfolded(whole.covered, before["row"], before["column"]).reshape(n, -1)
        x, y = place[:, :1] + self._places[0], place[:, 1:] + self._places[1]
        return Sensors(x, y, known, covered, self._age_s)

    def _wheels(self, before: State, sensors: Sensors) -> Sensors:
        """Return the wheels of the cells around in the form of sensors; wheels of live cells are known."""
        cells, place = int(self._cells.shape[1]), before["position_m"]
        x, y = place[:, :1] + self._cells[0], place[:, 1:] + self._cells[1]
        return Sensors(x, y, sensors.known[:, :cells], sensors.covered[:, :cells], np.zeros(cells))

    def _begun(self, belief: Belief, sensors: Sensors, rows: NDArray[np.int64]) -> Belief:
        """Replace the estimates of ``rows`` by a first guess from the readings alone."""
        if not len(rows):
            return belief
        first, _ = self._observer.begun(sensors.take(rows))
        pose = [array.copy() for array in belief.pose]
        for array, new in zip(pose, first.pose, strict=True):
            array[rows] = new
        spread = belief.spread.copy()
        spread[rows] = first.spread
        return Belief(Pose(*pose), spread)
