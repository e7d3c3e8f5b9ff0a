"""Effect ``motors``: each wheel follows its voltage with a first-order lag, and sticks where that is too little.

``dV/dt = (gain (u - coulomb sign V) - V) / tau``: a DC motor without load, its coil's inductance neglected (the
parcel's reaction is the effect ``wheel_load``). A wheel that stands stays where ``|u| <= static``, else it starts the
way of u. Integrated in closed form, when a wheel stops or turns round included, so a period of any length is exact.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple, Self, cast, final

import numpy as np
from pydantic import model_validator

from bus.effect import EffectSpec
from bus.spec import NotNegative, Positive, Spec
from bus.state import StateFields
from plant.wheels import Floats, WheelChanges, WheelMotion, WheelRun


@final
class DcMotorSpec(Spec):
    """A DC motor with gears and a wheel, by values of data sheets."""

    gear_ratio: Positive = 1.0
    """Turns of the rotor per turn of the wheel."""
    rotor_inertia_kg_m2: Positive
    wheel_inertia_kg_m2: NotNegative = 0.0
    """Inertia of the wheel and all parts that turn with it, about the wheel's shaft."""
    wheel_radius_m: Positive
    damping_n_m_s: NotNegative = 0.0
    """Viscous torque at the rotor, per rad/s of the rotor."""
    resistance_ohm: Positive
    torque_constant_n_m_per_a: Positive
    """Torque constant at the rotor; equal to the back-EMF constant, V s/rad."""
    coulomb_torque_n_m: NotNegative = 0.0
    """Dry friction at the shaft of a turning wheel."""
    static_torque_n_m: NotNegative | None = None
    """Torque at the wheel's shaft that starts a standing wheel; None: as ``coulomb_torque_n_m``."""

    @model_validator(mode="after")
    def _starts_no_easier(self) -> Self:
        if self.static_torque_n_m is not None and self.static_torque_n_m < self.coulomb_torque_n_m:
            raise ValueError(
                f"static_torque_n_m = {self.static_torque_n_m:g}: must be at least coulomb_torque_n_m, "
                f"{self.coulomb_torque_n_m:g}"
            )
        return self

    @property
    def inertia_kg(self) -> float:
        """``m``: of rotor, gears and wheel, as the surface feels it."""
        geared = self.rotor_inertia_kg_m2 * self.gear_ratio**2
        return (geared + self.wheel_inertia_kg_m2) / self.wheel_radius_m**2

    @property
    def stall_force_n_per_v(self) -> float:
        """Stall force at the wheel's surface per volt, N/V: ``f0`` of eq. 25."""
        per_ampere = self.torque_constant_n_m_per_a * self.gear_ratio / self.wheel_radius_m
        return per_ampere / self.resistance_ohm

    @property
    def damping_n_s_per_m(self) -> float:
        """``b``: how much less a wheel gives per m/s of surface speed, eq. 26 without a speed controller."""
        leverage = self.gear_ratio / self.wheel_radius_m
        per_ampere = self.torque_constant_n_m_per_a * leverage
        return self.damping_n_m_s * leverage**2 + per_ampere**2 / self.resistance_ohm

    @property
    def time_constant_s(self) -> float:
        """``m / b``."""
        return self.inertia_kg / self.damping_n_s_per_m

    @property
    def speed_per_volt_m_s(self) -> float:
        """``f0 / b``: surface speed per volt without load."""
        return self.stall_force_n_per_v / self.damping_n_s_per_m

    @property
    def coulomb_v(self) -> float:
        """Voltage that dry friction takes from a turning wheel."""
        return self.coulomb_torque_n_m / self.wheel_radius_m / self.stall_force_n_per_v

    @property
    def static_v(self) -> float:
        """Voltage beyond which a wheel that stands starts."""
        torque = self.coulomb_torque_n_m if self.static_torque_n_m is None else self.static_torque_n_m
        return torque / self.wheel_radius_m / self.stall_force_n_per_v


class FirstOrder(NamedTuple):
    """First-order response of an unloaded wheel to voltage.

    Attributes:
        time_constant_s: tau.
        speed_per_volt_m_s: gain.
        coulomb_v: friction while it turns.
        static_v: friction that it must overcome to start.
    """

    time_constant_s: float
    speed_per_volt_m_s: float
    coulomb_v: float
    static_v: float


@final
class MotorsSpec(EffectSpec):
    """First-order motors, one per wheel: given by time constant and gain, or by DC motor parameters."""

    states: ClassVar[tuple[str, ...]] = ("speed and travel of every wheel", "integral of every speed loop")
    messages: ClassVar[tuple[str, ...]] = ("cells receive encoder counts", "drives are volts")
    fidelity_rank: ClassVar[int | None] = 30
    time_constant_s: Positive | None = None
    """Time constant of the wheel speed; 0.06 unless ``dc`` is given."""
    speed_per_volt_m_s: Positive | None = None
    """No-load surface speed per volt; 0.1 unless ``dc`` is given."""
    coulomb_v: NotNegative | None = None
    """Voltage that dry friction takes from a turning wheel; 0 unless ``dc`` is given."""
    static_v: NotNegative | None = None
    """Voltage that starts a standing wheel; as ``coulomb_v`` unless ``dc`` is given."""
    supply_v: Positive = 12.0
    """Supply voltage, at which commands saturate in both directions."""
    dc: DcMotorSpec | None = None

    @model_validator(mode="before")
    @classmethod
    def _filled_in(cls, data: Any) -> Any:
        """Defaults, which hold only where there is no ``dc``: two ways to say the same are the same."""
        if not isinstance(data, dict) or cast("dict[str, Any]", data).get("dc") is not None:
            return data  # pyright: ignore[reportUnknownVariableType]
        given = {key: value for key, value in cast("dict[str, Any]", data).items() if value is not None}
        usual = {"time_constant_s": 0.06, "speed_per_volt_m_s": 0.1, "coulomb_v": 0.0}
        return {**usual, "static_v": given.get("coulomb_v", 0.0), **given}

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        if self.dc is not None:
            for name in FirstOrder._fields:
                if getattr(self, name) is not None:
                    raise ValueError(f"{name} follows from dc: give one or the other")
        elif (self.static_v if self.static_v is not None else math.inf) < (self.coulomb_v or 0.0):
            raise ValueError(f"static_v = {self.static_v:g}: must be at least coulomb_v, {self.coulomb_v:g}")
        return self

    @property
    def first_order(self) -> FirstOrder:
        """Response of the wheels without load, from first-order parameters or from ``dc``."""
        motor = self if self.dc is None else self.dc
        assert motor.time_constant_s is not None, "this is a bug: no time constant"
        assert motor.speed_per_volt_m_s is not None, "this is a bug: no speed per volt"
        return FirstOrder(
            motor.time_constant_s, motor.speed_per_volt_m_s, motor.coulomb_v or 0.0, motor.static_v or 0.0
        )

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """The defaults."""
        return cls()


@final
class Motors:
    """First-order motors of all wheels; drives are volts, saturated at the supply.

    Args:
        spec: Time constant, gain, friction and supply.
        cells: Number of cells.
        loaded: Whether they feel what they pull (effect ``wheel_load``).
    """

    state_fields: ClassVar[StateFields] = StateFields("_volts", "_speed", "_travel")

    def __init__(self, spec: MotorsSpec, cells: int, *, loaded: bool = False) -> None:
        from plant.kernels.wheels import entry  # loads numba: only where a plant is really built

        self._entry: Any = entry
        self._supply_v = spec.supply_v
        self._motor = spec.first_order
        self._rate = 1.0 / self._motor.time_constant_s
        self._law: Floats = np.array(self._motor[1:])
        self._loaded = loaded
        self._volts: Floats = np.zeros((cells, 2))
        self._speed: Floats = np.zeros((cells, 2))
        self._travel: Floats = np.zeros((cells, 2))

    def command(self, drives: Floats, span_s: float, acts_s: Floats | None = None) -> WheelRun:
        """Motion under the voltages, and how it changes where they act later or wheels stop on the way."""
        volts = np.empty((len(self._volts), 2))
        self._entry.limited(_whole(drives), self._supply_v, volts)
        before, self._volts = self._volts, volts
        slowing = np.zeros((len(volts), 4)) if self._loaded else None
        if acts_s is not None:
            first, begun_s = np.empty_like(volts), np.empty_like(volts)
            if self._entry.delayed(volts, before, _whole(acts_s), first, begun_s):
                return self._over(first, volts, begun_s, span_s, slowing)
        steady, decay, stops = self._set_off(self._speed, volts, span_s)
        return WheelRun(WheelMotion(steady, decay, self._rate, slowing), stops)

    def _over(
        self, first: Floats, volts: Floats, acts_s: Floats, span_s: float, slowing: Floats | None
    ) -> WheelRun:
        """Wheels that go over from the voltages ``first`` to others at ``acts_s`` ``(n, 2)``, infinite where not."""
        n, tau = len(volts), self._motor.time_constant_s
        steady, decay = np.empty_like(volts), np.empty_like(volts)
        changes = WheelChanges(np.empty((3, n, 2)), np.empty((3, n, 2)), np.empty((3, n, 2)))
        rows = self._entry.go_over(
            _whole(self._speed), first, volts, acts_s, span_s, self._law, tau, steady, decay, *changes
        )
        motion = WheelMotion(steady, decay, self._rate, slowing)
        return WheelRun(motion, WheelChanges(*(part[:rows] for part in changes)))

    def _set_off(
        self, speed: Floats, volts: Floats, end_s: float
    ) -> tuple[Floats, Floats, WheelChanges | None]:
        """The motion (steady, decay) of wheels at a speed under voltages, and how those go on that stop.

        Those that stop before ``end_s`` stand, or turn round. From V towards s on the other side of zero it takes
        ``tau ln(1 + |V / s|)``.
        """
        steady, decay, log_ratio = np.empty_like(volts), np.empty_like(volts), np.empty_like(volts)
        if not self._entry.set_off(_whole(speed), volts, self._law, steady, decay, log_ratio):
            return steady, decay, None
        after_s = self._motor.time_constant_s * log_ratio
        stops = after_s < end_s
        if not stops.any():
            return steady, decay, None
        stood = WheelChanges(*(np.empty((1, *volts.shape)) for _ in WheelChanges._fields))
        stood.after_s[0] = np.where(stops, after_s, np.inf)
        self._entry.stand(volts, self._law, stood.steady[0], stood.decay[0])
        return steady, decay, stood

    def elapse(self, run: WheelRun, span_s: float, reads_s: Floats | None = None) -> Floats | None:
        """Take speed and travel ``span_s`` seconds along ``run``; see ``plant.wheels.Wheels``."""
        motion, begun, passed = run.motion, self._travel, None
        if run.changes is not None:
            passed, travel, self._speed = self._pass_changes(run, span_s, reads_s)
            self._travel = begun + travel
        else:
            if reads_s is not None:
                passed, _, _ = self._pass_changes(run, span_s, reads_s)
            left = math.exp(-motion.rate * span_s)
            covered = -math.expm1(-motion.rate * span_s) / motion.rate
            self._travel, self._speed = np.empty_like(begun), np.empty_like(begun)
            self._entry.elapse(
                motion.steady, motion.decay, _whole(begun), span_s, covered, left, self._travel, self._speed
            )
        if motion.slowing is not None:
            self._speed += motion.slowing[:, :2]
            self._travel = self._travel + motion.slowing[:, 2:]
        return None if passed is None or reads_s is None else begun + passed

    def _pass_changes(
        self, run: WheelRun, span_s: float, reads_s: Floats | None
    ) -> tuple[Floats, Floats, Floats]:
        """Way until the cells read, way until ``span_s``, and speed then, ``(n, 2)`` each."""
        motion, found = run.motion, [np.empty_like(self._travel) for _ in range(3)]
        changes = (np.empty((0, *self._travel.shape)),) * 3 if run.changes is None else run.changes
        self._entry.pass_changes(
            _whole(motion.steady), _whole(motion.decay), motion.rate, *map(_whole, changes),
            np.zeros(len(self._travel)) if reads_s is None else _whole(reads_s), span_s, *found,
        )  # fmt: skip
        return found[0], found[1], found[2]

    @property
    def speed(self) -> Floats:
        """``(n, 2)`` m/s."""
        return self._speed

    @property
    def travel(self) -> Floats:
        """``(n, 2)`` m of surface passed since the start."""
        return self._travel


def _whole(array: Floats) -> Floats:
    """Return an array in one piece and aligned, as kernels take it: the array itself if it is."""
    flags = array.flags
    if (
        flags.c_contiguous and flags.aligned and array.dtype == np.float64
    ):  # ``require`` alone takes ten times as long
        return array
    return np.require(array, np.float64, ("C", "A"))
