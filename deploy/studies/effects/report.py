"""Terminal and JSON output of effects, their influence, advice and the ladder."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from deploy.studies.effects.ablation import effect_types, summary
from deploy.util.formatting import plural, short_number

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from deploy.studies.effects.advice import Advice
    from deploy.studies.effects.ladder import RungResult
    from deploy.studies.effects.sensitivity import Sensitivity
    from deploy.studies.effects.study import AblationRow


def declared() -> list[dict[str, Any]]:
    """Return the declarations of all registered effects."""
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
            "rung": kind.fidelity_rank,
        }
        for name, kind in effect_types().items()
    ]


def row_json(row: AblationRow) -> dict[str, Any]:
    """Convert an ablation row to JSON types: declarations, cost and influence of an effect."""
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


def _events(influence: Sensitivity) -> dict[str, Any]:
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


def ladder_json(climbed: Sequence[RungResult]) -> list[dict[str, Any]]:
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


_NONE = "–"


def print_declared() -> None:
    """Print every effect and its additions to a scene."""
    console = Console(highlight=False)
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="cyan", no_wrap=True)
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for one in declared():
        table.add_row(one["name"], "", one["summary"])
        for key in ("states", "events", "messages", "parameters", "needs", "excludes", "solvers"):
            if one[key]:
                table.add_row("", key, ", ".join(one[key]))
    console.print(table)


def print_rows(scene: Scene, rows: Sequence[AblationRow]) -> None:
    """Print what every effect costs and does."""
    console = Console(highlight=False)
    console.print(
        f"scene {scene.name}, {scene.duration_s:g} s: difference between runs with and without each effect\n",
        markup=False,
    )
    table = Table(box=None, pad_edge=False)
    table.add_column("effect", style="cyan", no_wrap=True)
    table.add_column("on")
    for heading in ("cost", "mm", "mrad", "rests, s", "events, s", "solver, mm"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(row.name, "yes" if row.on else "no", *_figures(row))
    console.print(table)
    notes = [(row.name, note) for row in rows for note in _notes(row, scene.solver.name)]
    if notes:
        console.print()
    for name, note in notes:
        console.print(f"{name}: {note}", markup=False)
    console.print(
        "\nmm, mrad: largest final displacement of a corner and of an angle; rests: delay until all parcels rest; "
        "events: largest shift of an event in time; solver: the solver's own error, against a tenth of its tolerance",
        style="dim",
    )


def _figures(row: AblationRow) -> Iterable[str]:
    influence = row.influence
    if influence is None or row.cost_ratio is None:
        return [_NONE] * 6
    return (
        f"{row.cost_ratio:.2f}",
        _scaled(influence.displacement_m),
        _scaled(influence.turn_rad),
        _settling(influence),
        _NONE if influence.moved_s is None else f"{influence.moved_s:.3g}",
        _scaled(row.error and row.error.displacement_m),
    )


def _scaled(value: float | None) -> str:
    """In thousandths, three digits; 0 only where it is."""
    return _NONE if value is None else f"{1e3 * value:.3g}"


def _settling(influence: Sensitivity) -> str:
    if influence.settling_s is not None:
        return f"{influence.settling_s:+.3g}" if influence.settling_s else "0"
    with_it, without = influence.settled_s
    return _NONE if with_it is without else "never" if with_it is None else "only now"


def _notes(row: AblationRow, solver: str) -> Iterable[str]:
    if row.reason:
        yield f"not toggled: {row.reason}"
        return
    if row.settings is not None and not row.on:
        given = [(key, value) for key, value in row.settings.items() if value not in (None, [])]
        listed = ", ".join(f"{key} = {_plain(value)}" for key, value in given)
        yield f"tried with {listed or 'default settings'}"
    if row.solver != solver:
        yield f"both under {row.solver}, since {solver} doesn't support the effect"
    if row.beside:
        yield f"both with {', '.join(row.beside)}, which the effect needs"
    if row.along:
        yield f"toggled with {', '.join(row.along)}, which need the effect"
    if row.influence is not None and row.influence.parcels:
        yield f"{plural(row.influence.parcels, 'parcel')} at the end of one run only"
    if row.influence is not None and any(row.influence.only):
        with_it, without = row.influence.only
        yield f"{plural(with_it, 'event')} only with the effect, {without} only without"


def _plain(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def print_advice(advice: Advice) -> None:
    """Print effects to leave out, and effects to add."""
    console = Console(highlight=False)
    limit = f"{short_number(1e3 * advice.tolerance_m)} mm"
    console.print()
    if advice.can_go:
        together = advice.together and advice.together.displacement_m
        more = "" if together is None else f" (all of them together: {1e3 * together:.3g} mm)"
        console.print(f"can be left out, within {limit}: {', '.join(advice.can_go)}{more}", markup=False)
    else:
        console.print(
            f"No effect of the scene can be left out: each changes the result by {limit} or more, or it has none."
        )
    if advice.missing:
        console.print(f"missing, beyond {limit}: {', '.join(advice.missing)}", markup=False)
    else:
        console.print(f"No missing effect changes the result by {limit}, with typical settings.")
    if advice.unclear:
        console.print(
            f"unclear: {', '.join(advice.unclear)}: the solver's own error is beyond {limit}; tighten solver.tolerance"
        )


def print_ladder(scene: Scene, climbed: Sequence[RungResult]) -> None:
    """Print cost and distance of every rung."""
    console = Console(highlight=False)
    console.print(
        f"scene {scene.name}, {scene.duration_s:g} s: each rung adds to those above it\n", markup=False
    )
    table = Table(box=None, pad_edge=False)
    table.add_column("rung", style="cyan", no_wrap=True)
    table.add_column("adds")
    for heading in ("wall s", "off top, mm", "mrad"):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in climbed:
        if one.distance is None or one.wall_s is None:
            table.add_row(one.rung.name, f"left out: {one.reason}", _NONE, _NONE, _NONE)
        else:
            figures = (_scaled(one.distance.displacement_m), _scaled(one.distance.turn_rad))
            table.add_row(one.rung.name, one.rung.words, f"{one.wall_s:.3g}", *figures)
    console.print(table)
