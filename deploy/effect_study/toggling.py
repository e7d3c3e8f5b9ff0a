"""The two scenes that differ in one effect, which tell what it does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from deploy.effect_study.course import needs_cells
from deploy.effect_study.variants import Table, effect_types, tables, typical, variant

if TYPE_CHECKING:
    from deploy.scene import Scene


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Toggled:
    """An effect, on and off.

    Attributes:
        on: The scene with it.
        off: The scene without it, under the same solver.
        settings: Of the effect, as it is on.
        beside: Effects that are on in both though the scene lacks them, because it needs them.
        along: Effects that are toggled with it because they need it.
    """

    on: Scene
    off: Scene
    settings: Table
    beside: tuple[str, ...] = ()
    along: tuple[str, ...] = ()

    @property
    def cells(self) -> bool:
        """Whether the cells of one of the two do more than hold a field's speeds."""
        return needs_cells(self.on) or needs_cells(self.off)


def toggled(scene: Scene, name: str) -> Toggled:
    """A scene with and without one effect: its own settings, or where it lacks the effect typical ones.

    Raises:
        NotPossible: Says why it can't be toggled in this scene.
    """
    own = tables(scene)
    return _taken_out(scene, name, own) if name in own else _put_in(scene, name, own)


def _taken_out(scene: Scene, name: str, own: dict[str, Table]) -> Toggled:
    gone = dependents(name, own)
    on = variant(scene, own)
    off = variant(scene, {n: table for n, table in own.items() if n not in gone}, solver=_solver_table(on))
    return Toggled(on=on, off=off, settings=own[name], along=tuple(n for n in own if n in gone - {name}))


def _put_in(scene: Scene, name: str, own: dict[str, Table]) -> Toggled:
    settings = typical(name, scene)
    beside = {
        needed: typical(needed, scene)
        for needed in sorted(_needs(name, settings, scene))
        if needed not in own
    }
    on = variant(scene, {**own, **beside, name: settings})
    off = variant(scene, {**own, **beside}, solver=_solver_table(on))
    return Toggled(on=on, off=off, settings=settings, beside=tuple(beside))


def _solver_table(scene: Scene) -> Table:
    return scene.solver.model_dump(mode="json")


def _needs(name: str, settings: Table, scene: Scene) -> set[str]:
    """All effects that one with these settings builds on, these with typical settings."""
    found: set[str] = set()
    waiting = list(_needed(name, settings))
    while waiting:
        needed = waiting.pop()
        if needed not in found:
            found.add(needed)
            waiting += _needed(needed, typical(needed, scene))
    return found


def _needed(name: str, settings: Table) -> tuple[str, ...]:
    return effect_types()[name].model_validate(settings).needed()


def dependents(name: str, own: Mapping[str, Table]) -> set[str]:
    """The effect, and those of the scene's that build on it as they are set."""
    found, size = {name}, 0
    while len(found) > size:
        size = len(found)
        found |= {other for other, table in own.items() if not found.isdisjoint(_needed(other, table))}
    return found
