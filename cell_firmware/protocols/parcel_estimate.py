"""Cells under a parcel estimate together where it is, from sensors and messages alone, and bring it to a place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from bus.lattice import Lattice
from cell_firmware.estimation.estimator import MESSAGE, Estimator, EstimatorParameters
from cell_firmware.firmware import Cells, Firmware, Floats, Inputs, Outputs, State
from cell_firmware.program import Theory
from cell_firmware.specs import Positive, Vector


class ParcelEstimateParameters(EstimatorParameters):
    """Parcel parameters, target, gain and speed limit."""

    target_m: Vector
    """Target of the parcel's centre."""
    gain_per_s: Positive = 0.5
    """Commanded speed by distance from the target."""
    speed_m_s: Positive = 0.2
    """Largest commanded speed."""


@final
class ParcelEstimate(Firmware):
    """Transport of parcels to a target by a pose that the cells under each parcel estimate together.

    Cells that know a pose drive a rigid field, ``v = gain (target - centre)``, no faster than requested; a cell that
    senses a parcel and knows no pose takes its own place for the centre. Close to the target they add ``gain (centre +
    shift - own place)``. That brings the parcel's true centre to the target though the estimate may be off: loads share
    out so that ``sum N_i p_i = W X`` whatever cells carry it (the paper's eq. 5); ``shift`` allows for dead ones.
    """

    Parameters = ParcelEstimateParameters
    message = MESSAGE
    observable = "centre_m"

    def __init__(self, parameters: ParcelEstimateParameters) -> None:
        super().__init__(parameters)
        self._estimator = Estimator(parameters)

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Return the value ranges of the estimator's message fields."""
        return self._estimator.plausible()

    def theory(self, lattice: Lattice) -> Theory:
        """Predict when a pose is known, and the damped motion to the target, in seconds."""
        del lattice
        gain, response = self.parameters.gain_per_s, self.parameters.response_s
        damping = 1.0 / (2.0 * float(np.sqrt(gain * response)))
        return Theory(
            "a pose is known 8 (1 + sensors) ticks after the election, which takes as many as the group is wide; near "
            f"the target the centre is a damped oscillator, natural frequency sqrt(gain / response) = "
            f"{float(np.sqrt(gain / response)):.3g} rad/s, damping ratio {damping:.3g}"
        )

    def init(self, cells: Cells) -> State:
        """Return the initial state: the estimator's, and the rigid motion commanded last, ``(n, 3)``."""
        return {**self._estimator.init(cells), "command": np.zeros((len(cells), 3))}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Estimate the pose, and drive by it."""
        after, outbox = self._estimator.step(state, inputs, state["command"])
        estimate = self._estimator.estimate(after)
        place = state["position_m"]
        centre = np.where(estimate.known[:, None], estimate.centre_m, place)
        velocity, near = self._velocity(centre)
        pull = self.parameters.gain_per_s * near * (centre + estimate.shift_m - place)
        drives = (estimate.known | estimate.covered)[:, None]
        speed = np.where(drives, np.where(estimate.known[:, None], velocity + pull, velocity), 0.0)
        command = np.concatenate((velocity, np.zeros((len(place), 1))), axis=1)
        return {**after, "command": command}, Outputs(speed, outbox)

    def _velocity(self, centre: Floats) -> tuple[Floats, Floats]:
        """``(n, 2)`` m/s towards the target, and ``(n, 1)``, 1 at the target to 0 where the speed limit begins."""
        wanted = self.parameters.gain_per_s * (np.array(self.parameters.target_m) - centre)
        length = np.sqrt(wanted[:, :1] * wanted[:, :1] + wanted[:, 1:] * wanted[:, 1:])
        limit = self.parameters.speed_m_s
        slower = np.where(length > limit, limit / np.maximum(length, limit), 1.0)
        return wanted * slower, np.maximum(1.0 - length / limit, 0.0)
