"""Physics sections of a scene: frozen, validated input of the plant."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import Annotated

from pydantic import Field, model_validator

from bus.spec import Positive, Spec
from plant.effects.registry import PlantEffects
from plant.friction.registry import FrictionSpec
from plant.parcel_spec import ArraySpec, ParcelSpec
from plant.solver_specs import ExactSpec, SolverSpec

REST_TIME_S = 1e5
"""A parcel that takes longer to move by a pitch is at rest."""


def disagreements(
    friction: FrictionSpec | None, effects: PlantEffects | None, solver: SolverSpec | None
) -> Iterator[tuple[tuple[str, str], object, str]]:
    """Find disagreements between sections of a scene: the path of a value, the value, and the broken rule."""
    if solver is not None and effects is not None:
        for name, effect in effects.enabled():
            if effect.solvers is not None and solver.name not in effect.solvers:
                yield (
                    ("solver", "name"),
                    solver.name,
                    f"leaves out effects.{name}; use {' or '.join(effect.solvers)}",
                )
    if effects is not None:
        yield from effects.problems()
    if friction is None:
        return
    if solver is not None and solver.laws is not None and friction.law not in solver.laws:
        rule = f"solves law {', '.join(solver.laws)}, not {friction.law}; use implicit"
        yield ("solver", "name"), solver.name, rule
    if effects is not None and effects.load_transfer is not None and friction.traction().static_ratio != 1.0:
        rule = "doesn't go with effects.load_transfer: loads that depend on who sticks need not balance"
        yield ("friction", "static_coefficient"), None, rule
    uneven = None if effects is None else effects.uneven_friction
    if uneven is not None and not friction.by_load:
        rule = "doesn't depend on the load, so effects.uneven_friction can't vary it; leave it out"
        yield ("friction", "law"), friction.law, rule
    if uneven is not None and uneven.parts_wheels and friction.traction().isotropic:
        rule = (
            "gives both wheels of a cell one limit: effects.uneven_friction may vary cells only, not wheels"
        )
        yield ("friction", "contact"), "isotropic", rule
    if solver is not None and friction.solvers is not None and solver.name not in friction.solvers:
        rule = f"leaves out friction.static_coefficient; use {' or '.join(friction.solvers)}"
        yield ("solver", "name"), solver.name, rule
    if effects is not None and effects.motors is not None and friction.own_motors:
        rule = "has motors of its own; leave effects.motors out"
        yield ("friction", "law"), friction.law, rule


def misplaced(array: ArraySpec, effects: PlantEffects) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
    """Find effect settings that don't fit the array: the path of a value, the value, and the broken rule."""
    enabled = list(effects.enabled())
    if not enabled:
        return
    lattice = array.lattice()
    for name, effect in enabled:
        for path, value, rule in effect.problems(lattice, array.pitch_m):
            yield ("effects", name, *path), value, rule


def unknown_exits(
    parcels: Mapping[int, ParcelSpec], effects: PlantEffects
) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
    """Exits that parcels are meant for and that are none: the path of a value, the value, and the broken rule.

    Args:
        parcels: By their number in the scene.
        effects: Those of the scene.
    """
    feeders = effects.feeders
    meant = [(("parcels", number, "destination"), parcel.destination) for number, parcel in parcels.items()]
    known = [] if feeders is None else [one.name for one in feeders.exits]
    for number, feed in enumerate(() if feeders is None else feeders.feed):
        path = ("effects", "feeders", "feed", number, "to")
        meant += [((*path, place), name) for place, name in enumerate(feed.to)]
    for path, name in meant:
        if name is not None and name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            advice = f"nearest: {close[0]}" if close else f"there are {', '.join(known) or 'none'}"
            yield path, name, f"effects.feeders.exits has none of that name; {advice}"


class PlantSpec(Spec):
    """All the plant needs to know of a scene."""

    array: ArraySpec
    parcels: tuple[ParcelSpec, ...] = ()
    friction: FrictionSpec
    effects: PlantEffects = PlantEffects()
    solver: SolverSpec = ExactSpec()
    gravity_m_s2: Positive = 9.81
    rest_speed_m_s: Positive | None = None
    """Largest corner speed of a parcel at rest; default: 1e-5 pitches a second."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of all random streams."""

    @model_validator(mode="after")
    def _agrees(self) -> PlantSpec:
        for path, value, rule in disagreements(self.friction, self.effects, self.solver):
            raise ValueError(f"{'.'.join(path)} {value} {rule}")
        own = dict(enumerate(self.parcels))
        for path, value, rule in (*misplaced(self.array, self.effects), *unknown_exits(own, self.effects)):
            raise ValueError(f"{'.'.join(map(str, path))} {value}: {rule}")
        return self

    @property
    def slow_m_s(self) -> float:
        """A parcel none of whose corners moves faster, or gains speed faster than this a second, is at rest."""
        given = self.rest_speed_m_s
        return self.array.pitch_m / REST_TIME_S if given is None else given

    def with_fed(self) -> PlantSpec:
        """Return a copy with all fed parcels appended to the scene's own."""
        feeders = self.effects.feeders
        if feeders is None:
            return self
        return self.model_copy(update={"parcels": self.parcels + feeders.parcels(self.seed)})

    def parcel_key(self, number: int) -> str:
        """The key in the scene of what one of the parcels is made from, own or fed."""
        number -= len(self.parcels)
        if number < 0:
            return f"parcels[{number + len(self.parcels)}]"
        assert self.effects.feeders is not None
        for place, feed in enumerate(self.effects.feeders.feed):
            if number < feed.total:
                return f"effects.feeders.feed[{place}]"
            number -= feed.total
        raise AssertionError("this is a bug: the scene has no parcel of this number")
