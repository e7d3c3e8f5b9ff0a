"""``mdms plot``: plots of a recording."""

from __future__ import annotations

import re
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
    sequence = "sequence"
    spacetime = "spacetime"


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
        "the wheels over time; field: speeds of the wheels, or a register, at an instant; protocol: the protocol's "
        "fields (needs a run with --registers); sequence: messages between cells (needs a run with --trace-messages); "
        "spacetime: a register of a line of cells over time (needs a run with --registers).",
    ),
]
AtOption = Annotated[
    float | None,
    typer.Option(
        "--at", metavar="SECONDS", help="Instant of loads and field, simulated time. Default: the last one."
    ),
]
CellsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--cells",
        metavar="CELLS",
        help="Cells of sequence and spacetime: a cell such as 3,4, or a rectangle such as 3,0-3,9; repeat the option "
        "for more. Default: the traced cells; the middle row.",
    ),
]
TicksOption = Annotated[
    str | None,
    typer.Option("--ticks", metavar="FIRST-LAST", help="Ticks of sequence. Default: the first 12 traced."),
]
RegisterOption = Annotated[
    str | None,
    typer.Option(
        "--register",
        metavar="NAME",
        help="Register of spacetime (default: one of the program's variables), and of field (default: the wheels' "
        "speed).",
    ),
]
AnimateOption = Annotated[
    Path | None,
    typer.Option(
        "--animate",
        metavar="FILE",
        help="Write an animation of the view from above instead: MP4 or GIF by its suffix. With --kind field, cells "
        "have the colour of their wheels' speed, or of a --register.",
    ),
]


def plot(
    recording: RecordingArgument,
    output: OutputOption = None,
    kind: KindOption = Kind.overview,
    at: AtOption = None,
    cells: CellsOption = None,
    ticks: TicksOption = None,
    register: RegisterOption = None,
    animate: AnimateOption = None,
) -> None:
    """Plot a recording, complete or truncated.

    A plot beside the recording; a PDF for print; loads at an instant; an animation:

      [cyan]mdms plot runs/NAME[/cyan]
      [cyan]mdms plot runs/NAME --output figure.pdf[/cyan]
      [cyan]mdms plot runs/NAME --kind loads --at 1.5 --output loads.svg[/cyan]
      [cyan]mdms plot runs/NAME --kind field --register firmware.speed_m_s --at 1.5[/cyan]
      [cyan]mdms plot runs/NAME --animate run.mp4[/cyan]
      [cyan]mdms plot runs/NAME --kind field --register firmware.speed_m_s --animate field.gif[/cyan]

    Messages between three cells, and how a register spreads along a row:

      [cyan]mdms run heat --duration 1 --registers --trace-messages 2,2-2,4 --output traced[/cyan]
      [cyan]mdms plot traced --kind sequence --ticks 40-50[/cyan]
      [cyan]mdms plot traced --kind spacetime --cells 2,0-2,9 --register firmware.speed_m_s[/cyan]
    """
    from deploy.plots.theme import format_of
    from deploy.recordings.reader import load

    if at is not None and kind not in (Kind.loads, Kind.field):
        raise InputError(f"--at: goes with --kind loads or field, not {kind.value}")
    if cells and kind not in (Kind.sequence, Kind.spacetime):
        raise InputError(f"--cells: goes with --kind sequence or spacetime, not {kind.value}")
    if ticks is not None and kind is not Kind.sequence:
        raise InputError(f"--ticks: goes with --kind sequence, not {kind.value}")
    if register is not None and kind not in (Kind.spacetime, Kind.field):
        raise InputError(f"--register: goes with --kind spacetime or field, not {kind.value}")
    between = None if ticks is None else _ticks(ticks)
    if animate is not None:
        if output is not None or kind not in (Kind.overview, Kind.field) or at is not None:
            raise InputError("--animate: goes without --output and --at, and with --kind field alone")
        _animate(recording, animate, kind, register)
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
        from deploy.plots.kinds import PlotSelection, draw_kind

        named = None if not cells else " ".join(cells)
        draw_kind(run, kind.value, path, PlotSelection(at, named, between, register))
    print(path)


def _animate(recording: Path, path: Path, kind: Kind, register: str | None) -> None:
    """Write an animation and print its path."""
    from deploy.plots.animation import check_animation, draw_animation
    from deploy.plots.cell_values import RegisterValues, WheelSpeedValues
    from deploy.recordings.reader import load

    check_animation(path)  # a wrong suffix is refused before a long recording is read
    run = load(recording)
    values = None
    if kind is Kind.field:
        values = WheelSpeedValues(run) if register is None else RegisterValues(run, register)
    draw_animation(run, path, values)
    print(path)


def _ticks(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,12})-(\d{1,12})", text)
    if match is None or int(match[1]) > int(match[2]):
        raise InputError(f"--ticks {text}: must be a first and a last tick, such as 40-50")
    return int(match[1]), int(match[2])
