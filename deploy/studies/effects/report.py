"""Terminal and JSON output of effects, their influence, advice and the ladder."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from statistics import median
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from deploy.studies.effects.ablation import effect_types, summary
from deploy.util.formatting import plural, short_number
from deploy.util.tables import Column, print_columns

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from deploy.studies.effects.advice import Advice
    from deploy.studies.effects.ladder import RungResult
    from deploy.studies.effects.sensitivity import Sensitivity
    from deploy.studies.effects.study import AblationRow, Cost


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
        "cost_ratio": row.cost and row.cost.ratio,
        **_cost_json(row.cost),
        "influence_m": influence and influence.displacement_m,
        "influence_rad": influence and influence.turn_rad,
        "influence_at_s": influence and influence.at_s,
        "influence_parcel": influence and influence.parcel,
        "end_m": influence and influence.end_m,
        "end_rad": influence and influence.end_rad,
        "settling_s": influence and influence.settling_s,
        "settled_with_s": influence and influence.settled_s[0],
        "settled_without_s": influence and influence.settled_s[1],
        "parcels_on_one_side": influence and influence.parcels,
        "events": influence and _events(influence),
        "solver_error_m": error and error.displacement_m,
        "solver_error_rad": error and error.turn_rad,
        "reason": row.reason,
    }


def _cost_json(cost: Cost | None) -> dict[str, Any]:
    low, high = (None, None) if cost is None or cost.range_s is None else cost.range_s
    return {
        "cost_s": cost and cost.seconds,
        "cost_low_s": low,
        "cost_high_s": high,
        "wall_with_s": cost and median(cost.with_s),
        "wall_without_s": cost and median(cost.without_s),
    }


def _events(influence: Sensitivity) -> dict[str, Any]:
    (with_it, without), moved = influence.only, influence.moved
    return {
        "matched": influence.events,
        "moved_s": influence.moved_s,
        "moved": moved
        and {
            "kind": moved.kind,
            "parcel": moved.parcel,
            "cells": [list(cell) for cell in moved.cells],
            "with_s": moved.times_s[0],
            "without_s": moved.times_s[1],
        },
        "only_with": with_it,
        "only_without": without,
    }


def advice_json(advice: Advice) -> dict[str, Any]:
    """Convert advice to JSON types: effects to leave out with the time that this saves, and effects to add."""
    together = advice.together
    influence = together and together.influence
    return {
        "tolerance_m": advice.tolerance_m,
        "can_go": [row.name for row in advice.can_go],
        "together_m": influence and influence.displacement_m,
        "together_at_s": influence and influence.at_s,
        "together_events": influence and _events(influence),
        "together_saves": together and _cost_json(together.cost),
        "missing": [row.name for row in advice.missing],
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
            "wall_low_s": min(one.walls_s, default=None),
            "wall_high_s": max(one.walls_s, default=None),
            "distance_m": one.distance and one.distance.displacement_m,
            "distance_rad": one.distance and one.distance.turn_rad,
            "distance_at_s": one.distance and one.distance.at_s,
            "end_m": one.distance and one.distance.end_m,
            "reason": one.reason,
        }
        for one in climbed
    ]


_NONE = "–"


def print_declared(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print effects and their additions to a scene; ``rows``: of `declared`."""
    console = Console(highlight=False)
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="cyan", no_wrap=True)
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    for one in rows:
        table.add_row(one["name"], "", one["summary"])
        for key in ("states", "events", "messages", "parameters", "needs", "excludes", "solvers"):
            if one[key]:
                table.add_row("", key, ", ".join(one[key]))
    console.print(table)


SIGNIFICANT = 10.0
"""An influence below so many times the solver's own error is marked."""
_KEY = (
    "mm, mrad: largest displacement of a corner and rotation of a parcel at any time; at: time of the displacement; "
    "event: largest shift of an event in time; cost: wall time that the effect adds to a run, median of {rounds}, "
    "± half the range of the rounds; error: the solver's own, against a tenth of its tolerance; ~: below ten times "
    "this error; end: displacement at the end; rests: delay until all parcels rest; ×: wall time with the effect over "
    "without"
)


def print_rows(scene: Scene, rows: Sequence[AblationRow], repeats: int) -> None:
    """Print the effects' influence and cost: what matters first, then a table of all."""
    console = Console(highlight=False, soft_wrap=True)
    console.print(
        f"scene {scene.name}, {scene.duration_s:g} s: runs with and without each effect, compared at every tick",
        markup=False,
    )
    for line in verdict(rows):
        console.print(line, markup=False)
    console.print()
    left_out = print_columns(_columns(sorted(rows, key=_importance), many=scene.parcel_count > 1))
    notes = [(row.name, list(_notes(row, scene.solver.name))) for row in rows]
    console = Console(highlight=False)
    console.print()
    for name, said in notes:
        if said:
            console.print(f"{name}: {'; '.join(said)}", markup=False)
    console.print("\n" + _KEY.format(rounds=plural(repeats, "round")), style="dim", markup=False)
    if left_out:
        console.print(
            f"left out, too wide for this terminal: {'; '.join(left_out)} (see --json)", style="dim"
        )


def _importance(row: AblationRow) -> tuple[bool, bool, float]:
    """Order of rows: the scene's effects, then the others, each by influence, and at last what has none."""
    influence = row.influence
    off = -1.0 if influence is None else influence.displacement_m or 0.0
    return not row.on, influence is None, -(math.inf if influence and influence.parcels else off)


def verdict(rows: Sequence[AblationRow]) -> list[str]:
    """Name the effect that matters most among the scene's own, and among those that the scene lacks."""
    found: list[str] = []
    if not any(row.on for row in rows):
        found.append("none of these effects is in the scene")
    for on, head in ((True, "of the scene's effects"), (False, "of the effects that the scene lacks")):
        there = sorted((row for row in rows if row.on is on and row.influence is not None), key=_importance)
        idle = [row.name for row in there if row.influence is not None and row.influence.none]
        if len(idle) < len(there):
            found.append(f"{head}, {there[0].name} matters most: {_influence_words(there[0], events=True)}")
        if idle:
            found.append(f"{head}, without any influence: {', '.join(idle)}")
    return found


def _influence_words(row: AblationRow, *, events: bool = False) -> str:
    """Influence and cost in a line; ``events``: with the event that shifts most."""
    influence, cost = row.influence, row.cost
    assert influence is not None, "this is a bug: a row without influence"
    parts: list[str] = []
    if influence.displacement_m is not None:
        at = "" if influence.at_s is None else f" at {influence.at_s:.3g} s"
        parts.append(f"{_marked(row)} mm{at}")
    if influence.parcels:
        parts.append(f"{plural(influence.parcels, 'parcel')} at the end of one run only")
    if events and (moved := influence.moved) is not None and moved.shift_s > 0.0:
        where = f" of {', '.join(map(str, moved.cells[:2]))}" if moved.cells else ""
        parts.append(f"{moved.kind}{where} moves by {moved.shift_s:.3g} s")
    if cost is not None:
        parts.append(_cost_words(cost))
    return ", ".join(parts)


def _cost_words(cost: Cost, *, saved: bool = False) -> str:
    """``costs 0.12 s (0.1 to 0.13), 0.62 instead of 0.5 s a run``; a cost within the noise is called that."""
    sides = (cost.without_s, cost.with_s) if saved else (cost.with_s, cost.without_s)
    whole = f"{median(sides[0]):.2g} instead of {median(sides[1]):.2g} s a run"
    verb = "saves" if saved else "costs"
    if cost.range_s is None:
        return f"{verb} {cost.seconds:.2g} s, {whole} (one round: noise unknown)"
    low, high = cost.range_s
    head = "nothing beyond the noise" if cost.is_noise else f"{cost.seconds:.2g} s"
    return f"{verb} {head} ({low:.2g} to {high:.2g} s), {whole}"


def _columns(rows: Sequence[AblationRow], *, many: bool) -> list[Column]:
    """Columns of the table, ``many``: with the number of the parcel."""

    def figures(of: Callable[[Sensitivity], str]) -> list[str]:
        return [_NONE if row.influence is None else of(row.influence) for row in rows]

    def costs(of: Callable[[Cost], str]) -> list[str]:
        return [_NONE if row.cost is None else of(row.cost) for row in rows]

    displacements = [_marked(row) for row in rows]
    columns = [
        Column("effect", [row.name for row in rows], justify="left", style="cyan"),
        Column("on", ["yes" if row.on else "no" for row in rows], justify="left"),
        Column("mm", displacements),
        Column("at, s", figures(lambda one: _NONE if not one.displacement_m else f"{one.at_s:.3g}"), 1),
        Column("parcel", figures(lambda one: _NONE if not one.displacement_m else f"{one.parcel}"), 4),
        Column("end, mm", figures(lambda one: _scaled(one.end_m)), 4),
        Column("mrad", figures(lambda one: _scaled(one.turn_rad)), 5),
        Column("event, s", figures(lambda one: _NONE if one.moved_s is None else f"{one.moved_s:.3g}"), 3),
        Column("rests, s", figures(_settling), 6),
        Column("cost, s", costs(lambda one: f"{one.seconds:+.2g}")),
        Column("±", costs(_half_range), 1),
        Column("×", costs(lambda one: _NONE if one.ratio is None else f"{one.ratio:.2f}"), 5),
        Column("error, mm", [_scaled(row.error and row.error.displacement_m) for row in rows], 2),
    ]
    return [column for column in columns if many or column.heading != "parcel"]


def _marked(row: AblationRow) -> str:
    """The displacement in mm, marked where the solver's own error may be a part of it."""
    if row.influence is None:
        return _NONE
    off, error = row.influence.displacement_m, (row.error and row.error.displacement_m) or 0.0
    return f"{'~' if off and off < SIGNIFICANT * error else ''}{_scaled(off)}"


def _half_range(cost: Cost) -> str:
    return _NONE if cost.range_s is None else f"{0.5 * (cost.range_s[1] - cost.range_s[0]):.1g}"


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


def print_advice(advice: Advice, rows: Sequence[AblationRow]) -> None:
    """Print effects to leave out with the time that this saves, and effects to add; ``rows``: of all effects."""
    console = Console(highlight=False)
    limit = f"{short_number(1e3 * advice.tolerance_m)} mm"
    console.print()
    if advice.can_go:
        console.print(f"can be left out, within {limit} at any time:", markup=False)
        for row in advice.can_go:
            assert row.influence is not None, "this is a bug: advice without an influence"
            saved = "" if row.cost is None else f", {_cost_words(row.cost, saved=True)}"
            console.print(f"  {row.name}: {_scaled(row.influence.displacement_m)} mm{saved}", markup=False)
        if advice.together is not None and len(advice.can_go) > 1:
            influence, cost = advice.together.influence, advice.together.cost
            parcels = f", {plural(influence.parcels, 'parcel')} in one run only" if influence.parcels else ""
            words = f"{_scaled(influence.displacement_m)} mm{parcels}, {_cost_words(cost, saved=True)}"
            console.print(f"  all of them together: {words}", markup=False)
    elif any(row.on for row in rows):
        console.print(f"No effect of the scene can be left out within {limit}.")
    else:
        console.print("There is nothing to leave out: none of these effects is in the scene.")
    if advice.missing:
        console.print(f"missing, beyond {limit} with typical settings:", markup=False)
        for row in sorted(advice.missing, key=_importance):
            console.print(f"  {row.name}: {_influence_words(row)}", markup=False)
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
    for heading in ("wall s", "±", "off top, mm", "mrad"):
        table.add_column(heading, justify="right", no_wrap=True)
    for one in climbed:
        if one.distance is None or one.wall_s is None:
            table.add_row(one.rung.name, f"left out: {one.reason}", _NONE, _NONE, _NONE, _NONE)
            continue
        spread = 0.5 * (max(one.walls_s) - min(one.walls_s))
        table.add_row(
            one.rung.name,
            one.rung.words,
            f"{one.wall_s:.3g}",
            f"{spread:.1g}" if len(one.walls_s) > 1 else _NONE,
            _scaled(one.distance.displacement_m),
            _scaled(one.distance.turn_rad),
        )
    console.print(table)
