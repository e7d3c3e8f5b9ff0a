"""``mdms plot``: plots of a recording."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from deploy.errors import InputError


class Kind(StrEnum):
    """Kinds of plots."""

    overview = "overview"
    time = "time"
    phase = "phase"
    loads = "loads"
    torque = "torque"
    field = "field"
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
        help="overview: the parcels' motion from above and over time; time: position, angle and velocities; phase: "
        "velocity against position; loads: loads and tractions of the cells at an instant; torque: force and torque of "
        "the wheels over time; field: speeds of the wheels at an instant; protocol: the protocol's fields (needs a run "
        "with --registers).",
    ),
]
AtOption = Annotated[
    float | None,
    typer.Option(
        "--at", metavar="SECONDS", help="Instant of loads and field, simulated time. Default: the last one."
    ),
]
AnimateOption = Annotated[
    Path | None,
    typer.Option(
        "--animate",
        metavar="FILE",
        help="Write an animation of the view from above instead: MP4 or GIF by its suffix.",
    ),
]


def plot(
    recording: RecordingArgument,
    output: OutputOption = None,
    kind: KindOption = Kind.overview,
    at: AtOption = None,
    animate: AnimateOption = None,
) -> None:
    """Plot a recording, complete or truncated.

    A plot beside the recording; a PDF for print; loads at an instant; an animation:

      [cyan]mdms plot runs/NAME[/cyan]
      [cyan]mdms plot runs/NAME --output figure.pdf[/cyan]
      [cyan]mdms plot runs/NAME --kind loads --at 1.5 --output loads.svg[/cyan]
      [cyan]mdms plot runs/NAME --animate run.mp4[/cyan]
    """
    from deploy.plots.theme import format_of
    from deploy.recordings.reader import load

    if at is not None and kind not in (Kind.loads, Kind.field):
        raise InputError(f"--at: goes with --kind loads or field, not {kind.value}")
    if animate is not None:
        from deploy.plots.animation import check_animation, draw_animation

        if output is not None or kind is not Kind.overview:
            raise InputError("--animate: goes without --output and --kind")
        check_animation(animate)  # a wrong suffix is refused before a long recording is read
        draw_animation(load(recording), animate)
        print(animate)
        return
    if output is not None:
        format_of(output)
    run = load(recording)
    path = output or run.path.with_name(f"{kind.value}.png")
    if kind is Kind.protocol:
        from deploy.protocol_report.from_recording import report_from_recording
        from deploy.protocol_report.plot import draw_protocol

        draw_protocol(*report_from_recording(run), path)
    else:
        from deploy.plots.kinds import draw_kind

        draw_kind(run, kind.value, path, at)
    print(path)
