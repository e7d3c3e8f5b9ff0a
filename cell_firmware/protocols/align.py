"""Cells turn the parcel over them to an angle and bring it to a place, by an estimate of its pose: a closed loop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Final, Literal, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.estimation.estimator import MESSAGE, Estimator, EstimatorParameters
from cell_firmware.firmware import Bools, Cells, Firmware, Floats, Inputs, Outputs, State
from cell_firmware.program import Theory
from cell_firmware.specs import Finite, Positive, Vector
from cell_firmware.toolkit.camera_tracking import CameraTracker

_AGAIN: Final = 2.0
"""Ratio of the error at which the cells start again to the error at which they stop."""


class AlignParameters(EstimatorParameters):
    """Target pose of the parcel, source of its pose, gain and speed limits."""

    angle_rad: Finite = 0.0
    """Target direction of the parcel's x axis, up to half a turn."""
    target_m: Vector | None = None
    """Target of the parcel's centre; None: the parcel is turned in place."""
    source: Literal["sensors", "camera"] = "sensors"
    """Source of the pose: the cells' presence sensors and messages, or the scene's camera."""
    gain_per_s: Positive = 0.5
    """Commanded speed per distance from the target, and commanded angular speed per sine of the remaining angle."""
    speed_m_s: Positive = 0.2
    """Largest commanded speed of the parcel's centre, and of a corner by rotation."""
    rest_m: Positive = 0.003
    """Largest distance of the centre from the target at which wheels stop; they start again at twice this distance."""
    rest_rad: Positive = 0.003
    """Largest error of the angle at which wheels stop; they start again at twice this error."""
    rest_s: Positive = 1.0
    """Time for which distance and angle must be within ``rest_m`` and ``rest_rad`` before wheels stop."""
    patience_s: Annotated[float, Field(gt=0, le=10)] = 0.2
    """Validity of a camera frame."""


@final
class Align(Firmware):
    """Rigid field about the estimated centre, which turns and shifts the parcel to its target.

    With c the centre that is believed and e the angle from the parcel's x axis to the target's, less whole half turns,
    the parcel is commanded to move by ``v = gain (target - c)`` and ``omega = gain sin(e)``, slower where that would be
    faster than allowed, and the wheels at p drive ``v + omega x (p - c) + gain (c + shift - p) near``. Under viscous
    friction the loads' balance makes that the parcel's own law of motion whichever cells carry it
    (``sum N_i p_i = W X``, the paper's eq. 5)::

        X'' = mu g (v - X'),   theta'' = (omega - theta') mu sum N_i r_i^2 / I

    The last term, 1 at the target and 0 where the speed limit begins, holds the true centre to the estimate. It has no
    moment, and does not affect the angle. Source: the law is a proportional controller; the estimate is that of
    ``parcel_estimate``, or the scene's camera (the paper's vision system).
    """

    Parameters = AlignParameters
    message = MESSAGE
    observable = "left"

    def __init__(self, parameters: AlignParameters) -> None:
        super().__init__(parameters)
        self._estimator: Estimator | None = None
        self._sightings: CameraTracker | None = None
        if parameters.source == "sensors":
            self._estimator = Estimator(parameters)
        else:
            self.message = None  # pyright: ignore[reportIncompatibleVariableOverride, reportAttributeAccessIssue]
            self._sightings = CameraTracker(parameters.size_m, parameters.patience_s)
        self._target = np.array((np.cos(parameters.angle_rad), np.sin(parameters.angle_rad)))
        self._corner_m = 0.5 * float(np.sqrt(parameters.size_m[0] ** 2 + parameters.size_m[1] ** 2))

    def required_effects(self) -> tuple[str, ...]:
        """Require the camera where it is the source of the pose."""
        return () if self._sightings is None else ("camera",)

    def uses_camera(self) -> bool:
        """Whether the camera is the source of the pose."""
        return self._sightings is not None

    def warnings(self, lattice: Lattice) -> tuple[str, ...]:
        """Warn of a gain with which parcels overshoot."""
        del lattice
        damping = self._damping()
        if damping >= 1.0:
            return ()
        beyond = np.exp(-np.pi * damping / np.sqrt(1.0 - damping * damping))
        product = self.parameters.gain_per_s * self.parameters.response_s
        line = (
            f"gain_per_s times response_s is {product:.3g}, above 1/4: parcels overshoot the target, first "
            f"by {beyond:.0%} of the distance that they move at less than speed_m_s"
        )
        return (line,)

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Return the value ranges of the estimator's message fields."""
        return {} if self._estimator is None else self._estimator.plausible()

    def theory(self, lattice: Lattice) -> Theory:
        """The rate at which the slower of the two modes dies out."""
        del lattice
        damping, response_s = self._damping(), self.parameters.response_s
        slower = 1.0 if damping <= 1.0 else 1.0 - np.sqrt(1.0 - 1.0 / (damping * damping))
        return Theory(
            f"X'' = mu g (gain (target - X) - X'): the remaining error decays at {0.5 * slower / response_s:.3g} 1/s"
        )

    def _damping(self) -> float:
        """Damping ratio of the motion towards the target."""
        return float(0.5 / np.sqrt(self.parameters.gain_per_s * self.parameters.response_s))

    def init(self, cells: Cells) -> State:
        """Return the initial state: pose source, commanded motion ``(n, 3)``, remaining distance and angle's sine."""
        n = len(cells)
        source = self._estimator or self._sightings
        assert source is not None
        return {
            **source.init(cells),
            "command": np.zeros((n, 3)),
            "left": np.zeros((n, 2)),
            "quiet": np.zeros(n, dtype=np.int64),
            "wait": np.full(n, max(1, round(self.parameters.rest_s / cells.period_s))),
        }

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Estimate the pose, and drive by the remaining error."""
        after, outbox = state, None
        if self._estimator is not None:
            after, outbox = self._estimator.step(state, inputs, state["command"])
            found = self._estimator.estimate(after)
            known, centre, direction, shift = found.known, found.centre_m, found.direction, found.shift_m
        else:
            assert self._sightings is not None
            after = self._sightings.step(state, inputs)
            known, centre, direction = self._sightings.pose(after)
            shift = np.zeros_like(centre)
        error, sine = self._error(centre, direction)
        quiet = self._quiet(state, known, error, sine)
        moves = known & (quiet < state["wait"])
        velocity, spin, near = self._command(error, sine)
        place = state["position_m"] - centre
        pull = (self.parameters.gain_per_s * near)[:, None] * (shift - place)
        turning = spin[:, None] * np.stack((-place[:, 1], place[:, 0]), axis=1)
        speed = np.where(moves[:, None], velocity + turning + pull, 0.0)
        command = np.where(moves[:, None], np.concatenate((velocity, spin[:, None]), axis=1), 0.0)
        own = {"command": command, "left": self._left(error, sine, known), "quiet": quiet}
        return {**after, **own}, Outputs(speed, outbox)

    def _error(self, centre: Floats, direction: Floats) -> tuple[Floats, Floats]:
        """``(n, 2)`` m to the target; ``(n,)`` sine of the angle to it, whichever way round is nearer."""
        target = self.parameters.target_m
        error = np.zeros_like(centre) if target is None else np.array(target) - centre
        x, y = float(self._target[0]), float(self._target[1])
        along = direction[:, 0] * x + direction[:, 1] * y
        across = direction[:, 0] * y - direction[:, 1] * x
        return error, np.where(along < 0.0, -across, across)

    def _quiet(self, state: State, known: Bools, error: Floats, sine: Floats) -> NDArray[np.int64]:
        """``(n,)``: for how many periods the parcel has been where it may rest."""
        p = self.parameters
        stands = state["quiet"] >= state["wait"]
        slack = np.where(stands, _AGAIN, 1.0)
        square = error[:, 0] * error[:, 0] + error[:, 1] * error[:, 1]
        there = (square <= (slack * p.rest_m) * (slack * p.rest_m)) & (np.abs(sine) <= slack * p.rest_rad)
        return np.where(known & there, np.minimum(state["quiet"] + 1, state["wait"]), 0)

    def _command(self, error: Floats, sine: Floats) -> tuple[Floats, Floats, Floats]:
        """Velocity ``(n, 2)`` and angular velocity ``(n,)``; 1 at the target to 0 where the speed limit begins."""
        gain, limit = self.parameters.gain_per_s, self.parameters.speed_m_s
        wanted = gain * error
        length = np.sqrt(wanted[:, 0] * wanted[:, 0] + wanted[:, 1] * wanted[:, 1])
        slower = np.where(length > limit, limit / np.maximum(length, limit), 1.0)
        fastest = limit / self._corner_m
        spin: Floats = np.clip(gain * sine, -fastest, fastest)
        return wanted * slower[:, None], spin, np.maximum(1.0 - length / limit, 0.0)

    def _left(self, error: Floats, sine: Floats, known: Bools) -> Floats:
        distance = np.sqrt(error[:, 0] * error[:, 0] + error[:, 1] * error[:, 1])
        return np.where(known[:, None], np.stack((distance, np.abs(sine)), axis=1), 0.0)
