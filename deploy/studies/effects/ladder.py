"""Ladder of fidelity: one scene from quasi-static motion to all effects, cost against distance from the top rung."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import TYPE_CHECKING, Any, final

from deploy.errors import InputError
from deploy.runs.headless import needs_cells
from deploy.studies.effects.ablation import (
    Table,
    VariantRejected,
    dependents,
    effect_types,
    summary,
    tables,
    typical,
    variant,
)
from deploy.studies.effects.run import TracedRun, run_variant
from deploy.studies.effects.sensitivity import Sensitivity, compare

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene

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
    """Rung of the ladder: the rungs below plus one effect or refinement.

    Attributes:
        name: Name of the addition.
        adds: Description of the addition.
        scene: Scene that is run; None where the addition is incompatible with the rungs below.
        reason: Reason for incompatibility; empty where the scene is run.
        instead: Effects of lower rungs that this rung omits as incompatible. Such a rung stands beside the ladder.
    """

    name: str
    adds: str
    scene: Scene | None
    reason: str = ""
    instead: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """Description of the addition, with the effects that it replaces."""
        return f"{self.adds}; in place of {', '.join(self.instead)}" if self.instead else self.adds


@final
@dataclass(frozen=True, slots=True)
class RungResult:
    """Result of a rung.

    Attributes:
        rung: Which.
        walls_s: Wall times of its runs, s; empty where it was not run, or came to no end.
        distance: Difference from the top rung's run; None likewise.
        reason: Why; empty where all is well.
    """

    rung: Rung
    walls_s: Sequence[float] = ()
    distance: Sensitivity | None = None
    reason: str = ""

    @property
    def wall_s(self) -> float | None:
        """Median wall time, s."""
        return median(self.walls_s) if self.walls_s else None


def rungs(scene: Scene) -> list[Rung]:
    """The ladder of a scene, from the bottom.

    Below are a quasi-static motion under viscous friction, the same with inertia, and stick-slip. On these come the
    registered effects that have a place, in its order, with the scene's settings or typical ones; from the motors on
    they, and no longer the law, are what drives, and traction is Coulomb's alone. What has no place (feeders, rails) is
    the same on all rungs, as the scene has it. An effect that doesn't go with one below stands beside the ladder, in
    the other's place, and those above do without it.

    Args:
        scene: With or without effects; its law's coefficients serve where they can.
    """
    present = {
        name: table for name, table in tables(scene).items() if effect_types()[name].fidelity_rank is None
    }
    viscous, stick_slip = _law(scene, VISCOUS), _law(scene, STICK_SLIP)
    above = _solver(scene)
    found = [
        _rung("quasi_static", "viscous friction, no inertia", scene, present, viscous, QUASI_STATIC),
        _rung("viscous", "inertia", scene, present, viscous, above),
        _rung("stick_slip", "rolling wheels, traction that runs out", scene, present, stick_slip, above),
    ]
    for name, kind in effect_types().items():
        if kind.fidelity_rank is not None:
            found.append(rung := _next(scene, present, name))
            if rung.scene is not None and not rung.instead:
                present = tables(rung.scene)
    return found


def _next(scene: Scene, present: Mapping[str, Table], name: str) -> Rung:
    """An effect on what is ``present`` from below."""
    own = tables(scene)
    gone = _obstacles(name, present)
    instead = tuple(other for other in present if other in gone)
    try:
        settings = own[name] if name in own else typical(name, scene)
    except VariantRejected as why:
        return Rung(name, summary(name), None, str(why))
    effects = {**{other: table for other, table in present.items() if other not in gone}, name: settings}
    law = _law(scene, STICK_SLIP)
    if "motors" in effects:
        law = {"law": "coulomb", "coefficient": law["coefficient"]}
    return replace(_rung(name, summary(name), scene, effects, law, _solver(scene)), instead=instead)


def _obstacles(name: str, present: Mapping[str, Table]) -> set[str]:
    """Effects with which one doesn't go, and those that build on them; none where the scene itself can't do without."""
    types = effect_types()
    against = [other for other in present if other in types[name].excludes or name in types[other].excludes]
    found = {other for one in against for other in dependents(one, present)}
    return set() if any(types[other].fidelity_rank is None for other in found) else found


def _law(scene: Scene, usual: Table) -> Table:
    """Return the scene's friction law if its kind matches, else the usual settings of the kind."""
    own = scene.friction.model_dump(mode="json")
    return own if own["law"] == usual["law"] else usual


def _solver(scene: Scene) -> Table:
    """Return the solver of the rungs with inertia: the scene's own if ``implicit``, else a default ``implicit``."""
    return scene.solver.model_dump(mode="json") if scene.solver.name == "implicit" else {"name": "implicit"}


def _rung(name: str, adds: str, scene: Scene, effects: Mapping[str, Any], law: Table, solver: Table) -> Rung:
    try:
        return Rung(name, adds, variant(scene, effects, law=law, solver=solver))
    except VariantRejected as why:
        return Rung(name, adds, None, str(why))


def run_ladder(ladder: Sequence[Rung], repeats: int, notify: Callable[[str], None]) -> list[RungResult]:
    """Run every rung in the same mode: with cells if any rung needs cells.

    Args:
        ladder: Rungs from the bottom. The distance is measured from the last completed rung that is not beside the
            ladder.
        repeats: Timed runs of each rung, at least 1, after one untimed run. The rungs take turns, so that a slower
            machine affects all rungs alike.
        notify: Called with one line at the start of each run.
    """
    there = {rung.name: rung.scene for rung in ladder if rung.scene is not None}
    cells = any(needs_cells(scene) for scene in there.values())
    runs: dict[str, TracedRun] = {}
    reasons = {rung.name: rung.reason for rung in ladder}
    for number, (name, scene) in enumerate(there.items(), start=1):
        notify(f"{name} ({number} of {len(there)}) ...")
        try:
            run = run_variant(scene, cells=cells, notify=notify)
        except InputError as why:  # a scene may be valid, and its plant still refuse it
            reasons[name] = str(why)
            continue
        reasons[name] = run.result.reason
        if run.result.ok:
            runs[name] = run
    walls: dict[str, list[float]] = {name: [] for name in runs}
    for turn in range(repeats):
        seconds = sum(run.result.wall_s for run in runs.values())
        notify(f"timing, round {turn + 1} of {repeats} (about {seconds:.2g} s) ...")
        for name, spans in walls.items():
            spans.append(run_variant(there[name], cells=cells, notify=notify).result.wall_s)
    tops = [rung.name for rung in ladder if rung.name in runs and not rung.instead]
    return [
        RungResult(rung, walls[rung.name], compare(runs[rung.name], runs[tops[-1]]))
        if rung.name in runs and tops
        else RungResult(rung, reason=reasons[rung.name])
        for rung in ladder
    ]
