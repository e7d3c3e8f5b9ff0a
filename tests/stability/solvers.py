"""The solvers that the hard cases are put to, and what each claims of itself.

A hard case names the claims that it takes (``claiming``) and runs with every solver that makes them. A claim is fixed
here by what a solver is and promises, not by what it happens to pass. Another solver is one entry in ``SOLVERS``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from importlib.util import find_spec
from typing import Any, TypeVar, get_args

import pytest
from pydantic import TypeAdapter

from bus.effect import EffectSpec
from plant.effects.registry import PlantEffects
from plant.friction.registry import FrictionSpec
from plant.kernels.common import layout
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.solver_specs import SolverSpec
from tests.plant.laws import LAWS, STATIC_LAWS, VISCOUS
from tests.plant.scenes import solved

LEVER_M = 0.1
"""No parcel of the scenes here is smaller: an error at the footprint over this is the most that its angle is off."""


class Claim(Enum):
    """What a solver may claim, in the words of its user."""

    MOTION = "the motion, to the error that its settings promise"
    ORDER = "errors that fall as fast as the steps, or faster"
    EVENTS = "every change of supports, however brief, at its time"
    CHATTER = "few changes where supports chatter, and the right place and angle in the end"
    LOADS = (
        "loads that balance to rounding and never pull; a parcel that tips does so where and when it should"
    )
    REST = "a parcel at rest stays, to the bit"
    PACE = "steps grow as a motion ends: rest costs next to nothing"
    STICKING = "a parcel that sticks does so to the bit"
    ENERGY = "no kinetic energy from wheels that stand, in steps of any length"
    STIFFNESS = "friction, inertia and motors of any size"
    SCALES = "motions of any speed, for any time"
    LAGS = "wheels that lag behind their command, however short the lag is against a step"
    FAR = "the same digits a thousand kilometres away, but for those of the place"
    SYMMETRY = "what space does not change, the motion does not change; symmetric scenes stay so to 1e-12"
    FAILURES = "a motion that is given no number ends, and says where and when"
    FINALITY = "a motion too fast for numbers ends as one, and what has failed stays failed"


@dataclass(frozen=True)
class Solver:
    """A solver under test.

    Attributes:
        settings: a scene's ``[solver]`` table.
        declines: what it doesn't claim, and why.
        error_m: what its settings promise to be off by at the footprint after a second of motion; 0 where that is
            rounding, which each case then states for its scene.
        located: settings that keep it from anything but following every crossing.
        package: of which it is made, if it isn't always there.
    """

    settings: dict[str, Any]
    declines: Mapping[Claim, str] = field(default_factory=dict[Claim, str])
    error_m: float = 0.0
    located: Mapping[str, Any] = field(default_factory=dict[str, Any])
    package: str | None = None

    def claims(self, *needed: Claim) -> bool:
        """Whether it claims all of them."""
        return not any(claim in self.declines for claim in needed)

    def solves(self, law: FrictionSpec) -> bool:
        """Whether it takes scenes with this law."""
        laws = SPEC.validate_python(self.settings).laws
        own = law.solvers is None or self.settings["name"] in law.solvers
        return own and (laws is None or law.law in laws)

    def simulates(self, effect: str) -> bool:
        """Whether it takes scenes with this effect."""
        annotation = PlantEffects.model_fields[effect].annotation
        (kind,) = (one for one in get_args(annotation) if issubclass(one, EffectSpec))
        return kind.solvers is None or self.settings["name"] in kind.solvers

    def within(self, rounding: float, span_s: float = 1.0) -> float:
        """By how much an entry of the state may be off after ``span_s``; ``rounding`` is the least there can be."""
        return max(rounding, self.error_m * span_s / LEVER_M)

    def plant(self, *parcels: ParcelSpec, law: FrictionSpec | None = None, **scene: Any) -> Plant:
        """A plant of a scene of ``tests.plant.scenes.spec``; ``solver`` holds what of its table is set otherwise."""
        return solved(self.settings | dict(scene.pop("solver", {})), *parcels, law=law, **scene)

    def steps(self, plant: Plant) -> int:
        """How many steps a plant of one parcel has taken so far."""
        return int(plant._solver.parcels[0].ctl[layout.N_STEPS])


SPEC: TypeAdapter[Any] = TypeAdapter(SolverSpec)
"""Of the settings of every solver that there is."""

LOOKS = "looks at supports at the ends of its steps: what begins and ends within one is not seen"
LOST = "ends, but the place is lost with the numbers; an infinite speed of a wheel is taken for none"
STEPLESS = "takes what steps its tolerance asks"
EXPLICIT = "is explicit: steps too long for the friction throw a parcel back"
UNPROMISED = "errors fall with the step, but no figure is promised for one"
STEPWISE = "its tolerance is that of a step: what errors come to over a run is not said"
SECOND_S = "its tolerance is that of a second of motion: far shorter and longer ones are not meant"
TOO_FAR = "what a step may be off by is less than the rounding of such a place; it does not get on"
THROWN = "a parcel too fast for its steps is thrown off the array in one of them"
EVEN = "misses it where an edge leaves a cell from rest, or only just reaches one to the last bit"
COMPILED = "an event function a cell in reach is compiled, for every plant anew"
GIVEN = "the length of its steps is given"
FOLLOWS = "follows chatter through step by step; nothing replaces its limit"

SOLVERS = {
    "exact": Solver(
        settings={"name": "exact", "tolerance": 1e-12, "capture_m": 1e-6},
        located={"capture_m": 1e-12},
        declines={Claim.ORDER: STEPLESS},
    ),
    "implicit": Solver(
        settings={"name": "implicit", "tolerance": 1e-6},
        error_m=1e-6,
        located={"capture_m": 1e-12},
        declines={
            Claim.ORDER: STEPLESS,
            Claim.EVENTS: "locates them to its tolerance, and not to the rounding that these cases ask for",
            Claim.ENERGY: "extrapolates from steps of several lengths, which only each by itself never adds any",
            Claim.SCALES: SECOND_S,
            Claim.FINALITY: THROWN,
        },
    ),
    "implicit, fixed steps": Solver(
        settings={"name": "implicit", "step_s": 1e-2},
        declines={
            Claim.MOTION: UNPROMISED,
            Claim.PACE: GIVEN,
            Claim.EVENTS: LOOKS,
            Claim.CHATTER: FOLLOWS,
            Claim.LAGS: GIVEN,
            Claim.SCALES: GIVEN,
            Claim.FINALITY: THROWN,
        },
    ),
    "fixed_step": Solver(
        settings={"name": "fixed_step", "method": "rk4", "step_s": 1e-2},
        declines={
            Claim.FINALITY: THROWN,
            Claim.MOTION: UNPROMISED,
            Claim.PACE: GIVEN,
            Claim.EVENTS: LOOKS,
            Claim.CHATTER: FOLLOWS,
            Claim.STICKING: "steps back and forth over the velocity at which it should stick",
            Claim.ENERGY: EXPLICIT,
            Claim.STIFFNESS: EXPLICIT,
            Claim.LAGS: GIVEN,
            Claim.SCALES: GIVEN,
        },
    ),
    "quasi_static": Solver(
        settings={"name": "quasi_static"},
        error_m=1e-6,
        declines={
            Claim.FAILURES: "ends, but the place is lost with the numbers",
            Claim.FINALITY: THROWN,
            Claim.MOTION: "leaves inertia out: it is another motion, near the true one where that is slow",
            Claim.ORDER: STEPLESS,
            Claim.EVENTS: LOOKS,
            Claim.CHATTER: FOLLOWS,
            Claim.STICKING: "has no velocity to take on its wheels': it runs with them from the start",
            Claim.ENERGY: "has no kinetic energy to lose",
            Claim.STIFFNESS: "leaves inertia out",
            Claim.LAGS: "leaves inertia out",
            Claim.SCALES: SECOND_S,
            Claim.SYMMETRY: "its steps are right to the tolerance, no symmetry beyond that is promised",
            Claim.FAR: TOO_FAR,
        },
    ),
    "scipy": Solver(
        settings={"name": "scipy"},
        package="scipy",
        declines={
            Claim.FINALITY: "starts afresh each time that it is called",
            Claim.MOTION: STEPWISE,
            Claim.PACE: "no step of its own is promised to be long",
            Claim.ORDER: STEPLESS,
            Claim.EVENTS: "looks at signs at the ends of its steps: two crossings within one are none to it",
            Claim.CHATTER: "locates crossing after crossing",
            Claim.STICKING: "solves no law whose force is set-valued",
            Claim.ENERGY: STEPWISE,
            Claim.STIFFNESS: EXPLICIT,
            Claim.LAGS: STEPWISE,
            Claim.SCALES: STEPWISE,
            Claim.SYMMETRY: STEPWISE,
            Claim.FAR: STEPWISE,
        },
    ),
    "heyoka": Solver(
        settings={"name": "heyoka"},
        package="heyoka",
        declines={
            Claim.EVENTS: EVEN,
            Claim.LOADS: COMPILED,
            Claim.REST: STEPWISE,
            Claim.MOTION: STEPWISE,
            Claim.PACE: "no step of its own is promised to be long",
            Claim.ORDER: STEPLESS,
            Claim.CHATTER: "locates crossing after crossing",
            Claim.STICKING: "solves no law whose force is set-valued",
            Claim.ENERGY: STEPWISE,
            Claim.STIFFNESS: EXPLICIT,
            Claim.LAGS: STEPWISE,
            Claim.SCALES: STEPWISE,
            Claim.SYMMETRY: STEPWISE,
            Claim.FAR: STEPWISE,
            Claim.FINALITY: "starts afresh each time that it is called",
        },
    ),
}
"""Every solver, under every set of settings that claims differ with."""

Case = TypeVar("Case", bound=Callable[..., None])


def _params(names: list[str], *more: Any) -> list[Any]:
    """Parameters of a test, which where a solver's package isn't installed are skipped."""
    found = []
    for name in names:
        package = SOLVERS[name].package
        absent = package is not None and find_spec(package) is None
        marks = [pytest.mark.skip(reason=f"{package} is not installed")] if absent else []
        found.append(pytest.param(SOLVERS[name], *more, id="-".join([name, *map(str, more)]), marks=marks))
    return found


def claiming(
    *needed: Claim, laws: list[str] | None = None, effect: str | None = None
) -> Callable[[Case], Case]:
    """Run a hard case with every solver that claims what it needs, and knows an effect where one is named.

    The test gets it as ``solver``. With ``laws`` it runs with each of them that the solver solves, and gets their names
    of ``tests.plant.laws`` as ``law``; without, scenes are viscous.
    """

    def parametrised(case: Case) -> Case:
        params: list[Any] = []
        for law in laws or ["viscous"]:
            able = [
                name
                for name, solver in SOLVERS.items()
                if solver.claims(*needed)
                and solver.solves((LAWS | STATIC_LAWS)[law] if laws else VISCOUS)
                and (effect is None or solver.simulates(effect))
            ]
            assert able, f"{case.__name__}: no solver claims it under {law}"
            params += _params(able, law) if laws else _params(able)
        return pytest.mark.parametrize(("solver", "law") if laws else "solver", params)(case)

    return parametrised


def claims_table() -> str:
    """Which solver claims what, and why not, as the page about the hard cases shows it."""
    rows = [["claim", *SOLVERS], ["---"] * (1 + len(SOLVERS))]
    for claim in Claim:
        made = ["yes" if one.claims(claim) else "no" for one in SOLVERS.values()]
        rows.append([f"*{claim.name.lower()}*: {claim.value}", *made])
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    reasons: list[str] = []
    for name, solver in SOLVERS.items():
        why: dict[str, list[str]] = {}
        for claim, reason in solver.declines.items():
            why.setdefault(reason, []).append(f"*{claim.name.lower()}*")
        told = "; ".join(f"{', '.join(claims)}: {reason}" for reason, claims in why.items())
        reasons.append(f"- `{name}` does not claim {told}.")
    return table + "\n\nWhy not:\n\n" + "\n".join(reasons)
