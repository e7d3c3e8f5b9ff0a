"""``mdms export``: a recording in the formats of other tools."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class Format(StrEnum):
    """Formats of an export."""

    netcdf = "netcdf"
    parquet = "parquet"
    csv = "csv"
    foxglove = "foxglove"


def export(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A recording, or its output folder.")
    ],
    *,
    to: Annotated[
        Format,
        typer.Option(
            "--to",
            help="netcdf: everything in a file for xarray; parquet, csv: tables of parcels, events, faults and "
            "commands; foxglove: transforms, parcels and cells as Foxglove draws them, with a layout.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            metavar="PATH",
            help="File to write, or folder with parquet and csv. Default: beside the recording.",
        ),
    ] = None,
) -> None:
    r"""Write a recording, complete or truncated, in the formats of other tools; print the files.

    No value is rounded, except in the pictures of foxglove. Existing files are replaced. All formats but csv need the
    extra export: pip install 'mdms-emulator\[export]'.

      [cyan]mdms export runs/NAME --to netcdf[/cyan]
      [cyan]mdms export runs/NAME --to parquet --output tables[/cyan]
      [cyan]mdms export runs/NAME --to foxglove[/cyan]
    """
    from deploy.recordings.exports.registry import export_recording
    from deploy.recordings.reader import load

    for path in export_recording(load(recording), to.value, output):
        print(path)
