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
    """A DC motor with gears and a wheel, as its data sheet and a scale have it."""

    gear_ratio: Positive = 1.0
    """Turns of the rotor to one of the wheel."""
    rotor_inertia_kg_m2: Positive
    wheel_inertia_kg_m2: NotNegative = 0.0
    """Of the wheel and what turns with it, about its shaft."""
    wheel_radius_m: Positive
    damping_n_m_s: NotNegative = 0.0
    """Viscous torque at the rotor per rad/s."""
    resistance_ohm: Positive
    torque_constant_n_m_per_a: Positive
    """At the rotor; as many V s/rad."""
    coulomb_torque_n_m: NotNegative = 0.0
    """Dry friction at the wheel's shaft while it turns, ..."""
    static_torque_n_m: NotNegative | None = None
    """... and what it takes to start it; None: the same."""

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


STILL_M_S = 1e-15
"""A wheel slower than this stands: where it stopped, rounding leaves less."""


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
    """0.06 unless ``dc`` is given."""
    speed_per_volt_m_s: Positive | None = None
    """No-load surface speed per volt; 0.1 unless ``dc`` is given."""
    coulomb_v: NotNegative | None = None
    """Volts that dry friction takes from a turning wheel; none unless ``dc`` is given."""
    static_v: NotNegative | None = None
    """Volts that start a wheel; as ``coulomb_v`` unless ``dc`` is given."""
    supply_v: Positive = 12.0
    """Commands saturate at plus and minus this voltage."""
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
        told = self if self.dc is None else self.dc
        assert told.time_constant_s is not None, "this is a bug: no time constant"
        assert told.speed_per_volt_m_s is not None, "this is a bug: no speed per volt"
        return FirstOrder(
            told.time_constant_s, told.speed_per_volt_m_s, told.coulomb_v or 0.0, told.static_v or 0.0
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
        self._supply_v = spec.supply_v
        self._motor = spec.first_order
        self._rate = 1.0 / self._motor.time_constant_s
        self._loaded = loaded
        self._volts: Floats = np.zeros((cells, 2))
        self._speed: Floats = np.zeros((cells, 2))
        self._travel: Floats = np.zeros((cells, 2))

    def command(self, drives: Floats, span_s: float, acts_s: Floats | None = None) -> WheelRun:
        """Motion under the voltages, and how it changes where they act later or wheels stop on the way."""
        volts: Floats = np.minimum(np.maximum(drives, -self._supply_v), self._supply_v)
        before, self._volts = self._volts, volts
        slowing = np.zeros((len(volts), 4)) if self._loaded else None
        if acts_s is not None:
            late = (acts_s > 0.0)[:, None] & (volts != before)
            if late.any():
                acts: Floats = np.where(late, acts_s[:, None], np.inf)
                return self._over(np.where(late, before, volts), volts, acts, span_s, slowing)
        steady, decay = self._set_off(self._speed, volts)
        stops = self._stops(self._speed, steady, volts, 0.0, span_s)
        return WheelRun(WheelMotion(steady, decay, self._rate, slowing), _changes(stops))

    def _over(
        self, first: Floats, volts: Floats, acts_s: Floats, span_s: float, slowing: Floats | None
    ) -> WheelRun:
        """Wheels that go over from the voltages ``first`` to others at ``acts_s`` ``(n, 2)``, infinite where not."""
        steady, decay = self._set_off(self._speed, first)
        motion = WheelMotion(steady, decay, self._rate, slowing)
        rows = self._stops(self._speed, steady, first, 0.0, np.minimum(acts_s, span_s))
        speed = WheelRun(motion, _changes(rows)).speed(np.where(np.isfinite(acts_s), acts_s, 0.0))
        steady, decay = self._set_off(speed, volts)
        rows.append(WheelChanges(acts_s, steady, decay))
        rows += self._stops(speed, steady, volts, acts_s, span_s)
        return WheelRun(motion, _changes(rows))

    def _set_off(self, speed: Floats, volts: Floats) -> tuple[Floats, Floats]:
        """The motion (steady, decay) of wheels at a speed under voltages, until they stop."""
        gain, coulomb, static = self._motor[1:]
        if not static:
            steady = gain * volts
            return steady, speed - steady
        moves = np.abs(speed) > STILL_M_S
        way = np.sign(np.where(moves, speed, volts))
        goes = moves | (np.abs(volts) > static)
        steady = np.where(goes, gain * (volts - coulomb * way), 0.0)
        return steady, np.where(goes, speed - steady, 0.0)

    def _stops(
        self, speed: Floats, steady: Floats, volts: Floats, begun_s: Floats | float, end_s: Floats | float
    ) -> list[WheelChanges]:
        """How wheels go on that stop under voltages before ``end_s``: they stand, or turn round.

        From V towards s on the other side of zero it takes ``tau ln(1 + |V / s|)``.
        """
        if not self._motor.static_v:
            return []
        stops = (np.abs(speed) > STILL_M_S) & (speed * np.sign(steady) < 0.0)
        ratio = np.abs(speed) / np.where(stops, np.abs(steady), 1.0)
        after = begun_s + self._motor.time_constant_s * np.log1p(ratio)
        stops &= after < end_s
        if not stops.any():
            return []
        return [WheelChanges(np.where(stops, after, np.inf), *self._set_off(np.zeros_like(speed), volts))]

    def elapse(self, run: WheelRun, span_s: float, reads_s: Floats | None = None) -> Floats | None:
        """Take speed and travel ``span_s`` seconds along ``run``; see ``plant.wheels.Wheels``."""
        motion, begun, passed = run.motion, self._travel, None
        if run.changes is None:
            left = math.exp(-motion.rate * span_s)
            covered = -math.expm1(-motion.rate * span_s) / motion.rate
            self._travel = begun + motion.steady * span_s + motion.decay * covered
            self._speed = motion.steady + motion.decay * left
            passed = None if reads_s is None else begun + run.travel(reads_s)
        elif reads_s is None:
            self._travel, self._speed = begun + run.travel(span_s), run.speed(span_s)
        else:
            passed, self._travel = begun + run.travel(np.stack([reads_s, np.full_like(reads_s, span_s)]))
            self._speed = run.speed(span_s)
        if motion.slowing is not None:
            self._speed += motion.slowing[:, :2]
            self._travel = self._travel + motion.slowing[:, 2:]
        return passed

    @property
    def speed(self) -> Floats:
        """``(n, 2)`` m/s."""
        return self._speed

    @property
    def travel(self) -> Floats:
        """``(n, 2)`` m of surface passed since the start."""
        return self._travel


def _changes(rows: list[WheelChanges]) -> WheelChanges | None:
    """Stack wheel changes; None of an empty list."""
    if len(rows) == 1:
        return WheelChanges(*(part[None] for part in rows[0]))
    return WheelChanges(*(np.stack(parts) for parts in zip(*rows, strict=True))) if rows else None
