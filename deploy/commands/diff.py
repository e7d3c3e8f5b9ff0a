"""``mdms diff``: first difference of two recordings."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deploy.commands.options import JsonOption
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from collections.abc import Iterator

    from deploy.recordings.difference import RecordingDifference, ValueDifference

_MOST_VALUES = 12
"""Differing values of the scenes that are listed; further ones are counted."""


def diff(
    a: Annotated[Path, typer.Argument(metavar="A", help="A recording, or its output folder.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another recording, or its output folder.")],
    *,
    as_json: JsonOption = False,
) -> None:
    """Compare two recordings: the first tick, cell and quantity in which they differ, with both values.

    Parcels, wheel speeds, sensor bits, registers and messages if both have them, drives, events, faults and commands
    are compared to the last bit, tick by tick, as far as both recordings go. Differing values of the scenes are listed.
    In a tick causes come before effects: what a cell read before what it did.

    Exit status: 0 if everything that both have is the same, 1 if a value, the cells or the length differ, 2 if a
    recording can't be read. Scenes that differ in their text alone don't count as a difference.

      [cyan]mdms run heat --output a; mdms run heat --processes 4 --output b; mdms diff a b[/cyan]
      [cyan]mdms diff runs/before runs/after --json[/cyan]
    """
    from deploy.recordings.difference import compare
    from deploy.recordings.reader import load

    recordings = load(a), load(b)
    found = compare(*recordings)
    if as_json:
        digests = [[one.digest, one.motion_digest] for one in recordings]
        print(json.dumps(_to_json(found, digests), indent=2))
    else:
        for line in _lines(found):
            print(line)
    raise typer.Exit(0 if found.same else 1)


def _to_json(found: RecordingDifference, digests: list[list[str | None]]) -> dict[str, Any]:
    from deploy.runs.summary import finite

    return finite(
        {
            "same": found.same,
            "first": asdict(found.differences[0]) if found.differences else None,
            "differences": [asdict(one) for one in found.differences],
            "scenes": [asdict(one) for one in found.scenes],
            "compared": found.compared,
            "unlike": found.unlike,
            "left_out": found.left_out,
            "instants": found.instants,
            "ticks": found.ticks,
            "digest": [digest for digest, _ in digests],
            "motion_digest": [motion for _, motion in digests],
        }
    )


def _lines(found: RecordingDifference) -> Iterator[str]:
    """Yield the text for people: the first difference comes first."""
    if found.differences:
        first = found.differences[0]
        yield f"first difference: {_place(first)}"
        yield f"  A: {first.a!r}"
        yield f"  B: {first.b!r}"
        if first.places > 1:
            yield f"  {first.places} values of {first.quantity} differ in this tick"
        for one in found.differences[1:]:
            yield f"{one.quantity} differ first: {_place(one)}: {one.a!r} and {one.b!r}"
    else:
        yield f"no difference in {plural(found.instants, 'instant')}"
    if found.ticks[0] != found.ticks[1]:
        yield f"A ends with tick {found.ticks[0]}, B with tick {found.ticks[1]}"
    if found.scenes:
        yield f"the scenes differ in {plural(len(found.scenes), 'value')}:"
        for value in found.scenes[:_MOST_VALUES]:
            yield f"  {value.path}: {_said(value.a)} and {_said(value.b)}"
        if len(found.scenes) > _MOST_VALUES:
            yield f"  and {len(found.scenes) - _MOST_VALUES} more"
    yield f"compared: {', '.join(found.compared)}; {plural(found.instants, 'instant')}"
    for what in (*found.unlike, *found.left_out):
        yield f"not compared: {what}"


def _said(value: object) -> str:
    from deploy.recordings.difference import ABSENT

    return ABSENT if value == ABSENT else repr(value)


def _place(one: ValueDifference) -> str:
    whose = f"cell {one.cell[0]},{one.cell[1]}" if one.cell is not None else None
    if one.parcel is not None:
        whose = f"parcel {one.parcel}"
    parts = [f"tick {one.tick} ({one.time_s:g} s)", whose, one.quantity, one.part]
    return ", ".join(part for part in parts if part)
