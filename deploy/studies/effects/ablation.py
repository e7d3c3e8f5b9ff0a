"""Variants of a scene: effects added or removed, law or solver changed, validated like a scene file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

from pydantic import ValidationError

from bus.effect import EffectSpec
from cell_firmware.errors import dotted
from deploy.runs.headless import needs_cells
from deploy.scenes.effects import EffectsSpec
from deploy.scenes.errors import problems_of, strictly
from deploy.scenes.scene import Scene

Table = Mapping[str, Any]


@final
class VariantRejected(Exception):
    """The scene refuses the change; the message has the reason."""


def effect_types() -> dict[str, type[EffectSpec]]:
    """Return every registered effect by name: effects with a rung in the order of the ladder, then all others."""
    found: dict[str, type[EffectSpec]] = {}
    for name, field in EffectsSpec.model_fields.items():
        (kind,) = (
            kind
            for kind in getattr(field.annotation, "__args__", ())
            if isinstance(kind, type) and issubclass(kind, EffectSpec)
        )
        found[name] = kind
    last = len(found) * 1_000
    return dict(
        sorted(
            found.items(), key=lambda item: last if item[1].fidelity_rank is None else item[1].fidelity_rank
        )
    )


def summary(name: str) -> str:
    """Return an effect's summary: the first line of its docstring."""
    return (effect_types()[name].__doc__ or "").partition("\n")[0].rstrip(".").replace("`", "")


def tables(scene: Scene) -> dict[str, Table]:
    """The settings of the effects that a scene asks for, by name."""
    return {name: effect.model_dump(mode="json") for name, effect in scene.effects.enabled()}


def typical(name: str, scene: Scene) -> Table:
    """Settings with which a scene that lacks an effect tries it.

    Raises:
        VariantRejected: Only a scene can say.
    """
    settings = effect_types()[name].default_settings(scene.array.pitch_m)
    if isinstance(settings, str):
        raise VariantRejected(settings)
    return settings.model_dump(mode="json")


def variant(
    scene: Scene, effects: Mapping[str, Table], *, law: Table | None = None, solver: Table | None = None
) -> Scene:
    """The scene with other effects, and another law or solver where given.

    Gains of the speed loop go with the motors on which it closes. Where no solver is given and the scene's own doesn't
    know one of the effects, it is another that does, with its default settings.

    Args:
        scene: What is changed.
        effects: All that it is to have, by name.
        law: Its ``friction``.
        solver: Its ``solver``.

    Raises:
        VariantRejected: The scene refuses it.
    """
    data = scene.model_dump(mode="json")
    data["effects"] = dict(effects)
    data["solver"] = dict(solver) if solver is not None else _fitting_solver(scene, effects)
    if law is not None:
        data["friction"] = dict(law)
    if "motors" not in effects:
        data["cells"]["speed_loop"] = None
    try:
        return strictly(Scene, data).named(scene.name)
    except ValidationError as error:
        problems = problems_of(error, data, Scene)
        rules = dict.fromkeys(f"{dotted(problem.path)}: {problem.rule}" for problem in problems)
        raise VariantRejected("; ".join(rules)) from None


def _fitting_solver(scene: Scene, effects: Mapping[str, Table]) -> Table:
    """The scene's own; or the first that knows all the effects."""
    types = effect_types()
    known = [names for name in effects if (names := types[name].solvers) is not None]
    if all(scene.solver.name in names for names in known):
        return scene.solver.model_dump(mode="json")
    common = [name for name in known[0] if all(name in names for names in known)]
    return {"name": common[0] if common else known[0][0]}


def refined(scene: Scene, factor: float = 0.1) -> Scene | None:
    """The scene with a tolerance, or step, so many times as large; None where its solver has none so fine."""
    solver = scene.solver.model_dump(mode="json")
    key = "step_s" if "step_s" in scene.solver.accuracy() else "tolerance"
    solver[key] *= factor
    try:
        return variant(scene, tables(scene), solver=solver)
    except VariantRejected:
        return None


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class AblationPair:
    """Scenes with and without an effect.

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


def ablate(scene: Scene, name: str) -> AblationPair:
    """Return a scene with and without one effect, with the scene's settings, or typical settings if the scene has none.

    Raises:
        VariantRejected: The effect can't be toggled in this scene; the message has the reason.
    """
    own = tables(scene)
    return _taken_out(scene, name, own) if name in own else _put_in(scene, name, own)


def _taken_out(scene: Scene, name: str, own: dict[str, Table]) -> AblationPair:
    gone = dependents(name, own)
    on = variant(scene, own)
    off = variant(scene, {n: table for n, table in own.items() if n not in gone}, solver=_solver_table(on))
    return AblationPair(on=on, off=off, settings=own[name], along=tuple(n for n in own if n in gone - {name}))


def _put_in(scene: Scene, name: str, own: dict[str, Table]) -> AblationPair:
    settings = typical(name, scene)
    beside = {
        needed: typical(needed, scene)
        for needed in sorted(_needs(name, settings, scene))
        if needed not in own
    }
    on = variant(scene, {**own, **beside, name: settings})
    off = variant(scene, {**own, **beside}, solver=_solver_table(on))
    return AblationPair(on=on, off=off, settings=settings, beside=tuple(beside))


def _solver_table(scene: Scene) -> Table:
    return scene.solver.model_dump(mode="json")


def _needs(name: str, settings: Table, scene: Scene) -> set[str]:
    """Return all effects that an effect with these settings requires, directly or through typical settings."""
    found: set[str] = set()
    waiting = list(_needed(name, settings))
    while waiting:
        needed = waiting.pop()
        if needed not in found:
            found.add(needed)
            waiting += _needed(needed, typical(needed, scene))
    return found


def _needed(name: str, settings: Table) -> tuple[str, ...]:
    return effect_types()[name].model_validate(settings).required()


def dependents(name: str, own: Mapping[str, Table]) -> set[str]:
    """Return the effect and all effects of the scene that require it, directly or indirectly."""
    found, size = {name}, 0
    while len(found) > size:
        size = len(found)
        found |= {other for other, table in own.items() if not found.isdisjoint(_needed(other, table))}
    return found
