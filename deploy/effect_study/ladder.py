"""A ladder of fidelity: one scene from a quasi-static motion to all effects, cost against distance from the top."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Any, final

from deploy.effect_study.course import Course, follow, needs_cells
from deploy.effect_study.influence import Influence, compare
from deploy.effect_study.variants import NotPossible, Table, effect_types, summary, tables, typical, variant

if TYPE_CHECKING:
    from deploy.scene import Scene

QUASI_STATIC: Table = {"name": "quasi_static"}
VISCOUS: Table = {"law": "viscous", "coefficient_s_per_m": 0.2}
STICK_SLIP: Table = {
    "law": "stick_slip",
    "coefficient": 0.2,
    "motor_constant_n_per_a": 1.0,
    "resistance_ohm": 4.0,
    "gain_v_s_per_m": 10.0,
}
"""Laws of the lower rungs where the scene has none of that kind: those of the bundled scenes."""


@final
@dataclass(frozen=True, slots=True)
class Rung:
    """One rung: what is below, and one thing more.

    Attributes:
        name: Of what it adds.
        adds: That in words.
        scene: What is run; None where it doesn't fit on what is below.
        reason: Why not; empty where it does.
    """

    name: str
    adds: str
    scene: Scene | None
    reason: str = ""


@final
@dataclass(frozen=True, slots=True)
class Climbed:
    """A rung, run.

    Attributes:
        rung: Which.
        wall_s: Median of its runs; None where it was not run, or came to no end.
        distance: From the top rung; None likewise.
        reason: Why; empty where all is well.
    """

    rung: Rung
    wall_s: float | None = None
    distance: Influence | None = None
    reason: str = ""


def rungs(scene: Scene) -> list[Rung]:
    """The ladder of a scene, from the bottom.

    Below are a quasi-static motion under viscous friction, the same with inertia, and stick-slip. On these come the
    registered effects that have a place, in its order, with the scene's settings or typical ones; from the motors on
    they, and no longer the law, are what drives, and traction is Coulomb's alone. What has no place (feeders, rails) is
    the same on all rungs, as the scene has it.

    Args:
        scene: With or without effects; its law's coefficients serve where they can.
    """
    own = tables(scene)
    kept = {name: table for name, table in own.items() if effect_types()[name].rung is None}
    law = scene.friction.model_dump(mode="json")
    viscous = law if law["law"] == "viscous" else VISCOUS
    stick_slip = law if law["law"] == "stick_slip" else STICK_SLIP
    coulomb = {"law": "coulomb", "coefficient": stick_slip["coefficient"]}
    above = scene.solver.model_dump(mode="json") if scene.solver.name == "implicit" else {"name": "implicit"}
    found = [
        _rung("quasi_static", "viscous friction, no inertia", scene, kept, viscous, QUASI_STATIC),
        _rung("viscous", "inertia", scene, kept, viscous, above),
        _rung("stick_slip", "rolling wheels, traction that runs out", scene, kept, stick_slip, above),
    ]
    for name, kind in effect_types().items():
        if kind.rung is None:
            continue
        try:
            wanted = {**kept, name: own.get(name) or typical(name, scene)}
        except NotPossible as why:
            found.append(Rung(name, summary(name), None, str(why)))
            continue
        rung = _rung(name, summary(name), scene, wanted, coulomb if "motors" in wanted else stick_slip, above)
        found.append(rung)
        kept = kept if rung.scene is None else wanted
    return found


def _rung(name: str, adds: str, scene: Scene, effects: Mapping[str, Any], law: Table, solver: Table) -> Rung:
    try:
        return Rung(name, adds, variant(scene, effects, law=law, solver=solver))
    except NotPossible as why:
        return Rung(name, adds, None, str(why))


def climb(ladder: Sequence[Rung], repeats: int, tell: Callable[[str], None]) -> list[Climbed]:
    """Run every rung, all in the same way: with their cells if one of them needs them.

    Args:
        ladder: From the bottom; the distance is from the last that comes to its end.
        repeats: Timed runs of each, at least 1, after one that is not timed.
        tell: Told what begins, one line.
    """
    scenes = [rung.scene for rung in ladder]
    cells = any(scene is not None and needs_cells(scene) for scene in scenes)
    courses: dict[int, Course] = {}
    walls: dict[int, float] = {}
    for number, scene in enumerate(scenes):
        if scene is None:
            continue
        tell(f"{ladder[number].name} ...")
        courses[number] = follow(scene, cells=cells)
        walls[number] = median(follow(scene, cells=cells).wall_s for _ in range(repeats))
    ended = [number for number, course in courses.items() if course.status == "ok"]
    found: list[Climbed] = []
    for number, rung in enumerate(ladder):
        if number in ended:
            distance = compare(courses[number], courses[ended[-1]])
            found.append(Climbed(rung, walls[number], distance))
        else:
            found.append(Climbed(rung, reason=rung.reason or courses[number].reason))
    return found
