"""Settings of every solver, as a scene gives them."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, NamedTuple, get_args

from pydantic import BeforeValidator, Field

from bus.spec import Spec
from plant.tagged import tagged

Tolerance = Annotated[float, Field(ge=1e-14, le=1e-2, allow_inf_nan=False)]
StepsPerSecond = Annotated[float, Field(ge=1e3, le=1e12, allow_inf_nan=False)]
Accuracy = dict[str, str | float]
"""Name of a solver, and what its accuracy hangs on."""


class Sweep(NamedTuple):
    """Settings of a solver from coarse to fine, for a study of what accuracy costs.

    Attributes:
        key: what is swept: ``tolerance`` or ``step_s``.
        values: from coarse to fine.
        quick: some of them, for a quick study; none: it is left out then.
        fixed: settings beside it.
        title: distinguishes this sweep from the solver's others.
        note: what a reader of its errors must know.
    """

    key: Literal["tolerance", "step_s"]
    values: tuple[float, ...]
    quick: tuple[float, ...]
    fixed: tuple[tuple[str, str], ...] = ()
    title: str = ""
    note: str = ""


def _decades(first: int, last: int) -> tuple[float, ...]:
    """``1e-first`` down to ``1e-last``."""
    return tuple(float(f"1e-{exponent}") for exponent in range(first, last + 1))


_STEPS_S = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4, 6.25e-5)
_FEW_STEPS_S = (4e-3, 1e-3, 2.5e-4)


class ExactSpec(Spec):
    """Event-driven, analytic between events."""

    sweeps: ClassVar[tuple[Sweep, ...]] = (
        Sweep("tolerance", _decades(4, 12), (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)),
    )
    """Settings of the solver in a study of accuracy."""
    laws: ClassVar[tuple[str, ...] | None] = ("viscous", "coulomb_sliding", "rolling", "stick_slip")
    """Traction laws that the solver supports; None: all."""
    library: ClassVar[str] = ""
    """Function of a library that an adapter calls between events; empty: kernels of the plant."""
    name: Literal["exact"] = "exact"
    tolerance: Tolerance = 1e-9
    """Error of the footprint over the run, metres."""
    capture_m: Annotated[float, Field(gt=0, le=1e-2, allow_inf_nan=False)] = 1e-6
    """Amplitude below which chatter is captured."""
    max_steps_per_s: StepsPerSecond = 200_000.0
    """Limit of steps of one parcel per simulated second, at which its motion is aborted."""

    def accuracy(self) -> Accuracy:
        """Name of the solver, and what its accuracy hangs on."""
        return {"name": self.name, "tolerance": self.tolerance}


class ImplicitSpec(Spec):
    """Implicit steps, each a convex problem, for any law."""

    sweeps: ClassVar[tuple[Sweep, ...]] = (
        Sweep("tolerance", _decades(3, 11), (1e-4, 1e-7, 1e-10)),
        Sweep("step_s", _STEPS_S, (4e-3, 1e-3), title="steps"),
    )
    """Settings of the solver in a study of accuracy."""
    laws: ClassVar[tuple[str, ...] | None] = None
    """Traction laws that the solver supports; None: all."""
    library: ClassVar[str] = ""
    """Function of a library that an adapter calls between events; empty: kernels of the plant."""
    name: Literal["implicit"]
    tolerance: Tolerance = 1e-6
    """Error of the footprint, metres per second of motion; not used with ``step_s``."""
    capture_m: Annotated[float, Field(gt=0, le=1e-2, allow_inf_nan=False)] = 1e-6
    """Amplitude below which chatter is captured; not used with ``step_s``."""
    step_s: Annotated[float, Field(gt=0, le=1.0, allow_inf_nan=False)] | None = None
    """Constant step; default: steps controlled by the tolerance."""
    max_steps_per_s: StepsPerSecond = 1_000_000.0
    """Limit of steps of one parcel per simulated second, at which its motion is aborted; not used with ``step_s``."""

    def accuracy(self) -> Accuracy:
        """Name of the solver, and what its accuracy hangs on."""
        if self.step_s is not None:
            return {"name": self.name, "step_s": self.step_s}
        return {"name": self.name, "tolerance": self.tolerance}


class QuasiStaticSpec(Spec):
    """Motion without inertia: at every instant the velocity at which all forces balance."""

    sweeps: ClassVar[tuple[Sweep, ...]] = (
        Sweep(
            "tolerance",
            _decades(3, 8),
            (1e-4, 1e-7),
            note="leaves out inertia: the error is the model's",
        ),
    )
    """Settings of the solver in a study of accuracy."""
    laws: ClassVar[tuple[str, ...] | None] = ("viscous", "coulomb", "rolling", "stick_slip")
    """Traction laws that the solver supports; None: all."""
    library: ClassVar[str] = ""
    """Function of a library that an adapter calls between events; empty: kernels of the plant."""
    name: Literal["quasi_static"]
    tolerance: Annotated[float, Field(ge=1e-11, le=1e-2, allow_inf_nan=False)] = 1e-6
    """Error of the footprint, metres per second of motion; not used with ``step_s``."""
    step_s: Annotated[float, Field(ge=1e-9, le=1.0, allow_inf_nan=False)] | None = None
    """Constant step; default: steps controlled by the tolerance."""
    max_steps_per_s: StepsPerSecond = 1_000_000.0
    """Limit of steps of one parcel per simulated second, at which its motion is aborted; not used with ``step_s``."""

    def accuracy(self) -> Accuracy:
        """Name of the solver, and what its accuracy hangs on."""
        if self.step_s is not None:
            return {"name": self.name, "step_s": self.step_s}
        return {"name": self.name, "tolerance": self.tolerance}


class FixedStepSpec(Spec):
    """Explicit steps of constant length, with new supports in each step: the papers' own loop, for comparison."""

    sweeps: ClassVar[tuple[Sweep, ...]] = (
        Sweep("step_s", _STEPS_S, _FEW_STEPS_S, (("method", "euler"),), "euler"),
        Sweep("step_s", _STEPS_S, _FEW_STEPS_S, (("method", "rk4"),), "rk4"),
    )
    """Settings of the solver in a study of accuracy."""
    laws: ClassVar[tuple[str, ...] | None] = None
    """Traction laws that the solver supports; None: all."""
    library: ClassVar[str] = ""
    """Function of a library that an adapter calls between events; empty: kernels of the plant."""
    name: Literal["fixed_step"]
    method: Literal["euler", "rk4"] = "rk4"
    """Euler's method, or the classic Runge-Kutta method of four stages."""
    step_s: Annotated[float, Field(ge=1e-9, le=1.0, allow_inf_nan=False)] = 1e-3
    """Largest step; steps also end at ticks and samples."""

    def accuracy(self) -> Accuracy:
        """Name of the solver, and what its accuracy hangs on."""
        return {"name": self.name, "method": self.method, "step_s": self.step_s}


class SciPySpec(Spec):
    """``scipy.integrate.solve_ivp``, restarted at every detected event, for comparison."""

    sweeps: ClassVar[tuple[Sweep, ...]] = (
        Sweep("tolerance", _decades(3, 12), (1e-4, 1e-9), (("method", "RK45"),), "RK45"),
        Sweep("tolerance", _decades(3, 12), (1e-4, 1e-9), (("method", "DOP853"),), "DOP853"),
        Sweep("tolerance", _decades(3, 9), (), (("method", "Radau"),), "Radau"),
        Sweep("tolerance", _decades(3, 11), (), (("method", "LSODA"),), "LSODA"),
    )
    """Settings of the solver in a study of accuracy."""
    laws: ClassVar[tuple[str, ...] | None] = ("viscous", "coulomb_sliding", "rolling", "stick_slip")
    """Traction laws that the solver supports; None: all."""
    library: ClassVar[str] = "scipy.integrate.solve_ivp"
    """Function of a library that an adapter calls between events; empty: kernels of the plant."""
    name: Literal["scipy"]
    method: Literal["RK45", "DOP853", "Radau", "LSODA"] = "DOP853"
    """Method of ``solve_ivp``."""
    tolerance: Annotated[float, Field(ge=1e-13, le=1e-2, allow_inf_nan=False)] = 1e-9
    """``rtol`` and ``atol`` of one step, in SI units."""
    max_step_s: Annotated[float, Field(ge=1e-9, allow_inf_nan=False)] | None = None
    """Largest step; default: limited by the tolerance alone. Events within one step can remain undetected."""
    max_evaluations_per_s: StepsPerSecond = 1_000_000.0
    """Limit of right-hand sides of one parcel per simulated second, at which its motion is aborted."""

    def accuracy(self) -> Accuracy:
        """Name of the solver, and what its accuracy hangs on."""
        return {"name": self.name, "method": self.method, "tolerance": self.tolerance}


class HeyokaSpec(Spec):
    """heyoka's Taylor integrator, which isolates the roots of event functions, for verification."""

    sweeps: ClassVar[tuple[Sweep, ...]] = (Sweep("tolerance", _decades(4, 14), (1e-4, 1e-12)),)
    """Settings of the solver in a study of accuracy."""
    laws: ClassVar[tuple[str, ...] | None] = ("viscous", "rolling")
    """Traction laws that the solver supports; None: all."""
    library: ClassVar[str] = "heyoka.taylor_adaptive"
    """Function of a library that an adapter calls between events; empty: kernels of the plant."""
    name: Literal["heyoka"]
    tolerance: Annotated[float, Field(ge=1e-16, le=1e-2, allow_inf_nan=False)] = 1e-12
    """Relative error of a step; absolute in SI units for values below 1."""
    max_steps_per_s: StepsPerSecond = 200_000.0
    """Limit of steps of one parcel per simulated second, at which its motion is aborted."""

    def accuracy(self) -> Accuracy:
        """Name of the solver, and what its accuracy hangs on."""
        return {"name": self.name, "tolerance": self.tolerance}


AnySolver = ExactSpec | ImplicitSpec | QuasiStaticSpec | FixedStepSpec | SciPySpec | HeyokaSpec
SolverSpec = Annotated[
    Annotated[AnySolver, Field(discriminator="name")], BeforeValidator(tagged("name", "exact"))
]
"""Any solver, discriminated by ``name``."""


def settings_of(name: object) -> frozenset[str]:
    """The keys of a solver's table, its name included; none where there is no such solver."""
    for spec in get_args(AnySolver):
        if get_args(spec.model_fields["name"].annotation) == (name,):
            return frozenset(spec.model_fields)
    return frozenset()
