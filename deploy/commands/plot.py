"""``mdms plot``: a picture of a recording."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Kind(StrEnum):
    """The pictures there are."""

    overview = "overview"


RecordingArgument = Annotated[
    Path, typer.Argument(metavar="RECORDING", help="A recording, or the output folder it is in.")
]
OutputOption = Annotated[
    Path | None,
    typer.Option("--output", metavar="FILE", help="The PNG to write; default: beside the recording."),
]
KindOption = Annotated[Kind, typer.Option("--kind", help="Which picture.")]


def plot(recording: RecordingArgument, output: OutputOption = None, kind: KindOption = Kind.overview) -> None:
    """Draw a picture of a recording, whole or cut short."""
    from deploy.overview.picture import draw_overview
    from deploy.recordings.replay import load

    run = load(recording)
    path = output or run.path.with_name(f"{kind.value}.png")
    draw_overview(run, path)
    print(path)
