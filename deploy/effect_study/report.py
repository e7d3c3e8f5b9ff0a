"""What a study of effects found, in JSON's types."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from deploy.effect_study.variants import effect_types, summary

if TYPE_CHECKING:
    from deploy.effect_study.advice import Advice
    from deploy.effect_study.influence import Influence
    from deploy.effect_study.ladder import Climbed
    from deploy.effect_study.study import Row


def declared() -> list[dict[str, Any]]:
    """What every registered effect says of itself."""
    return [
        {
            "name": name,
            "summary": summary(name),
            "states": list(kind.states),
            "events": list(kind.events),
            "messages": list(kind.messages),
            "parameters": list(kind.model_fields),
            "needs": list(kind.needs),
            "excludes": list(kind.excludes),
            "solvers": None if kind.solvers is None else list(kind.solvers),
            "rung": kind.rung,
        }
        for name, kind in effect_types().items()
    ]


def row_json(row: Row) -> dict[str, Any]:
    """One effect in a scene: what it declares, what it costs, and its influence."""
    influence, error = row.influence, row.error
    kind = effect_types()[row.name]
    return {
        "name": row.name,
        "on": row.on,
        "adds": {
            "states": list(kind.states),
            "events": list(kind.events),
            "messages": list(kind.messages),
        },
        "settings": row.settings,
        "beside": list(row.beside),
        "along": list(row.along),
        "solver": row.solver,
        "cells": row.cells,
        "cost_ratio": row.cost_ratio,
        "wall_with_s": row.wall_s and row.wall_s[0],
        "wall_without_s": row.wall_s and row.wall_s[1],
        "influence_m": influence and influence.displacement_m,
        "influence_rad": influence and influence.turn_rad,
        "settling_s": influence and influence.settling_s,
        "settled_with_s": influence and influence.settled_s[0],
        "settled_without_s": influence and influence.settled_s[1],
        "parcels_on_one_side": influence and influence.parcels,
        "events": influence and _events(influence),
        "solver_error_m": error and error.displacement_m,
        "solver_error_rad": error and error.turn_rad,
        "reason": row.reason,
    }


def _events(influence: Influence) -> dict[str, Any]:
    with_it, without = influence.only
    return {
        "matched": influence.events,
        "moved_s": influence.moved_s,
        "only_with": with_it,
        "only_without": without,
    }


def advice_json(advice: Advice) -> dict[str, Any]:
    """Which effects to leave out, and which to ask for."""
    together = advice.together
    return {
        "tolerance_m": advice.tolerance_m,
        "can_go": list(advice.can_go),
        "together_m": together and together.displacement_m,
        "missing": list(advice.missing),
        "unclear": list(advice.unclear),
    }


def ladder_json(climbed: Sequence[Climbed]) -> list[dict[str, Any]]:
    """The rungs, from the bottom."""
    return [
        {
            "name": one.rung.name,
            "adds": one.rung.adds,
            "in_place_of": list(one.rung.instead),
            "wall_s": one.wall_s,
            "distance_m": one.distance and one.distance.displacement_m,
            "distance_rad": one.distance and one.distance.turn_rad,
            "reason": one.reason,
        }
        for one in climbed
    ]
