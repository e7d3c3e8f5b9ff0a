"""``mdms info``: contents of a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deploy.commands.options import JsonOption
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from collections.abc import Iterator

    from deploy.recordings.info import RecordingInfo

_MOST_FAULTS = 8
"""Faults that are listed; further ones are counted."""


def info(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording, or its output folder.")
    ],
    *,
    as_json: JsonOption = False,
) -> None:
    """Print the contents of a recording, complete or truncated: scene, versions, time, topics, status, faults.

    The topics have their number of messages, their encoding and their schema. With --json faults are listed in full.

      [cyan]mdms info runs/NAME[/cyan]
      [cyan]mdms info runs/NAME/recording.mcap --json[/cyan]
    """
    from deploy.recordings.info import recording_info

    found = recording_info(recording)
    if as_json:
        print(json.dumps(found.to_json(), indent=2))
    else:
        _print(found)


def _print(found: RecordingInfo) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(highlight=False)
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(style="cyan", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in _rows(found):
        table.add_row(name, Text(text))
    console.print(table)
    topics = Table(box=None, pad_edge=False)
    topics.add_column("topic", style="cyan", no_wrap=True)
    for heading in ("messages", "size"):
        topics.add_column(heading, justify="right")
    topics.add_column("encoding")
    topics.add_column("schema")
    for topic in found.topics:
        schema = f"{topic.schema} ({topic.schema_encoding})" if topic.schema else "none"
        topics.add_row(topic.name, f"{topic.messages:,}", _size(topic.bytes), topic.encoding, schema)
    console.print()
    console.print(topics)


def _rows(found: RecordingInfo) -> Iterator[tuple[str, str]]:
    from deploy.faults.records import describe_faults

    yield "file", f"{found.path}, {_size(found.size_bytes)}, format {found.format}"
    yield "scene", f"{found.scene}: {found.title}"
    seed = "" if found.seed is None else f", seed {found.seed}"
    yield "array", f"{plural(found.cells, 'cell')}, {plural(found.parcels, 'parcel')}{seed}"
    yield "run", found.run
    ticks = "no instant" if found.ticks is None else f"{plural(found.ticks, 'tick')} of {found.period_s:g} s"
    yield "time", f"{found.time_s:g} s, {ticks}, {plural(found.instants, 'instant')}"
    yield "status", found.status or "cut before the end of the run"
    if found.digest:
        yield "digest", found.digest
    if found.motion_digest:
        yield "motion", found.motion_digest
    for name, counts in (("events", found.events), ("commands", found.commands)):
        if counts:
            yield name, ", ".join(f"{number:,} {kind}" for kind, number in sorted(counts.items()))
    lines = describe_faults(found.faults)
    for number, line in enumerate(lines[:_MOST_FAULTS]):
        yield "" if number else "faults", line
    if len(lines) > _MOST_FAULTS:
        yield "", f"and {len(lines) - _MOST_FAULTS} more"
    yield "versions", ", ".join(f"{name} {version}" for name, version in found.versions.items())


def _size(count: float) -> str:
    """``12.3 kB``."""
    for unit in ("B", "kB", "MB"):
        if count < 1000:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} GB"
