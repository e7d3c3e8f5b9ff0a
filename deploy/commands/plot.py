"""``mdms plot``: plots of a recording."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Kind(StrEnum):
    """Kinds of plots."""

    overview = "overview"
    protocol = "protocol"


RecordingArgument = Annotated[
    Path, typer.Argument(metavar="RECORDING", help="A recording, or its output folder.")
]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output",
        metavar="FILE",
        help="File to write: PNG, SVG or PDF by its suffix. Default: a PNG beside the recording.",
    ),
]
KindOption = Annotated[
    Kind,
    typer.Option(
        "--kind",
        help="Kind of plot: the parcels' motion, or the protocol's fields (needs a run with --registers).",
    ),
]


def plot(recording: RecordingArgument, output: OutputOption = None, kind: KindOption = Kind.overview) -> None:
    """Plot a recording, complete or truncated.

    A plot beside the recording; a PDF for print; the protocol's fields:

      [cyan]mdms plot runs/NAME[/cyan]
      [cyan]mdms plot runs/NAME --output figure.pdf[/cyan]
      [cyan]mdms plot runs/NAME --kind protocol --output protocol.svg[/cyan]
    """
    from deploy.plots.theme import format_of
    from deploy.recordings.reader import load

    if output is not None:
        format_of(output)  # a wrong suffix is refused before a long recording is read
    run = load(recording)
    path = output or run.path.with_name(f"{kind.value}.png")
    if kind is Kind.protocol:
        from deploy.protocol_report.from_recording import report_from_recording
        from deploy.protocol_report.plot import draw_protocol

        draw_protocol(*report_from_recording(run), path)
    else:
        from deploy.plots.overview import draw_overview

        draw_overview(run, path)
    print(path)
