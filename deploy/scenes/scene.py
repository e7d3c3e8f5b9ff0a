"""The scene: complete specification of a run, composed of the packages' specs."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, PrivateAttr, ValidationError, field_validator, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from bus.fault import tick_at
from bus.spec import NO_LATENCY, BusSpec, Positive, Spec, StallSpec
from cell_firmware.specs import CellsSpec, SpeedLoopSpec, nanoseconds
from deploy.faults.registry import Fault
from deploy.scenes.checks import cross_problems, normal_parameters
from deploy.scenes.effects import EffectsSpec
from deploy.scenes.errors import CROSS
from deploy.scenes.goal import GoalSpec
from plant.friction.registry import FrictionSpec
from plant.parcel_spec import ArraySpec, ParcelSpec
from plant.solver_specs import ExactSpec, SolverSpec
from plant.specs import PlantSpec

if TYPE_CHECKING:
    from bus.lattice import Lattice
    from cell_firmware.clocks import ArrayClocks

_ASIDE = {
    "title": True,
    "goal": True,
    "stall": {"deadline_s", "lease_s", "start_s"},
    "solver": {"max_steps_per_s", "max_evaluations_per_s"},
    "rest_speed_m_s": True,
    "effects": {"encoder": {"decoder"}},
}
"""Values that a run cannot show in its results: words, the campaigns' criterion, limits on the wall clock and on work,
the speed that counts as rest, and what costs only a processor's time."""

_UNSAID: dict[str, object] = {"destination": None, "to": [], "order": "turn"}
"""Keys of a parcel or a feed that say nothing so: a run is described without them."""


class Scene(Spec):
    """A scene file, validated.

    Every section belongs to the package that acts on it. What concerns several sections (a fault's cell, the
    firmware's parameters, the speed loop and the motors it closes on) is checked here.
    """

    title: str = ""
    """Title in one line; has no effect on the run."""
    duration_s: Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False)]
    """Simulated time, s. The run ends exactly at this time; the last tick may be shorter than the others."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Seed of all random streams."""
    gravity_m_s2: Positive = 9.81
    rest_speed_m_s: Positive | None = None
    """Largest corner speed of a parcel at rest; default: 1e-5 pitches a second."""
    array: ArraySpec
    cells: CellsSpec = CellsSpec()
    parcels: tuple[ParcelSpec, ...] = ()
    friction: FrictionSpec
    effects: EffectsSpec = EffectsSpec()
    faults: tuple[Fault, ...] = ()
    solver: SolverSpec = ExactSpec()
    bus: BusSpec = NO_LATENCY
    stall: StallSpec = StallSpec()
    goal: GoalSpec | None = None

    _name: str = PrivateAttr("scene")

    @field_validator("duration_s")
    @classmethod
    def _whole_nanoseconds(cls, value: float) -> float:
        nanoseconds(value)
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Scene:
        faults = dict(enumerate(self.faults))
        parcels = dict(enumerate(self.parcels))
        problems = cross_problems(
            self.array, self.cells, self.friction, self.effects, self.solver, faults, parcels
        )
        if problems:
            raise ValidationError.from_exception_data(
                "Scene",
                [
                    InitErrorDetails(
                        type=PydanticCustomError(CROSS, "{rule}", {"rule": problem.rule}),
                        loc=problem.path,
                        input=problem.value,
                    )
                    for problem in problems
                ],
            )
        return self

    @property
    def name(self) -> str:
        """Bundled name, or the file as it was given."""
        return self._name

    def _repr_html_(self) -> str:
        """Representation in notebooks."""
        from deploy.scenes.notebook import start_svg
        from deploy.util.formatting import plural
        from deploy.util.notebook import facts_html

        effects = [name for name, _ in self.effects.enabled()]
        facts = [
            ("scene", self.name),
            ("array", f"{plural(self.array.count, 'cell')}, pitch {self.array.pitch_m:g} m"),
            ("firmware", f"{self.cells.firmware}, every {self.cells.period_s:g} s"),
            ("parcels", str(self.parcel_count)),
            ("friction", self.friction.law),
            ("solver", self.solver.name),
            ("effects", ", ".join(effects) or "none"),
            ("faults", str(len(self.faults))),
            ("duration", f"{self.duration_s:g} s, {plural(self.ticks, 'tick')}"),
            ("seed", str(self.seed)),
        ]
        return facts_html(self.title or self.name, facts, start_svg(self.array, self.parcels))

    def named(self, name: str) -> Scene:
        """Return a copy of the scene under another name."""
        copy = self.model_copy()
        copy._name = name  # noqa: SLF001 - our own
        return copy

    @property
    def duration_ns(self) -> int:
        """Simulated time, integer nanoseconds."""
        return nanoseconds(self.duration_s)

    @property
    def tick_ns(self) -> int:
        """Time served by one exchange between plant and cells: a control period, or a window with local clocks, ns."""
        clock = self.effects.clock
        return self.cells.period_ns if clock is None else clock.window_ns(self.cells.period_ns)

    @property
    def ticks(self) -> int:
        """Ticks of the run; the last one may be shorter than the others."""
        return -(-self.duration_ns // self.tick_ns)

    def clocks(self) -> ArrayClocks | None:
        """The clocks of all cells; None where they step at once."""
        clock = self.effects.clock
        return None if clock is None else clock.clocks(self.lattice(), self.cells.period_ns, self.seed)

    @property
    def speed_loop(self) -> SpeedLoopSpec | None:
        """Gains of the speed loop, the defaults where the scene says nothing; None without motors."""
        if self.effects.motors is None:
            return None
        return self.cells.speed_loop or SpeedLoopSpec()

    @property
    def parcel_count(self) -> int:
        """Number of parcels, the scene's own and fed parcels."""
        feeders = self.effects.feeders
        return len(self.parcels) + (0 if feeders is None else feeders.total)

    def tick_at(self, at_s: float) -> int:
        """The first tick that does not begin before a scheduled time ``at_s`` (s, >= 0)."""
        return tick_at(at_s, self.tick_ns)

    def lattice(self) -> Lattice:
        """The cells that exist."""
        return self.array.lattice()

    def plant_spec(self) -> PlantSpec:
        """The plant's part of the scene."""
        return PlantSpec(
            array=self.array,
            parcels=self.parcels,
            friction=self.friction,
            effects=self.effects.of_plant(),
            solver=self.solver,
            gravity_m_s2=self.gravity_m_s2,
            rest_speed_m_s=self.rest_speed_m_s,
            seed=self.seed,
        )

    def canonical(self) -> bytes:
        """Serialize the simulated content; equivalent spellings of a scene produce the same bytes.

        The bytes are sorted JSON of all values, including defaults and the firmware's own. Settings that don't change
        the simulation are left out: the title, the goal, limits on the wall clock, the folder of a firmware's file, and
        absent effects. The code of user firmware is not covered.
        """
        data = self.model_dump(mode="json", exclude=_ASIDE)
        data["effects"] = {name: table for name, table in data["effects"].items() if table is not None}
        feeders = data["effects"].get("feeders", {"feed": ()})
        for parcel in (*data["parcels"], *feeders["feed"]):
            for key, silence in _UNSAID.items():
                if parcel.get(key) == silence:
                    del parcel[key]
        if data["effects"].get("parcel_contact", {}).get("bounce_speed_m_s", 0) is None:
            del data["effects"]["parcel_contact"]["bounce_speed_m_s"]
        if self.bus == NO_LATENCY:
            del data["bus"]
        data["faults"] = [
            {key: value for key, value in fault.items() if value is not None} for fault in data["faults"]
        ]
        data["cells"]["firmware"] = self.cells.firmware.rpartition("/")[2]
        del data["cells"]["board"]  # its effects are written out
        del data["cells"]["on_failure"]  # changes no tick before a failure
        if not self.cells.initial_registers:
            del data["cells"]["initial_registers"]
        data["cells"]["parameters"] = normal_parameters(self.cells)
        data["cells"]["speed_loop"] = self.speed_loop and self.speed_loop.model_dump(mode="json")
        for key in ("missing", "cells"):
            data["array"][key] = sorted(data["array"][key] or ())
        return json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
