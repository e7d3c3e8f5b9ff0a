"""Export to Parquet: a folder with one file a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deploy.recordings.exports.extra import library
from deploy.recordings.exports.tables import TABLES, columns
from deploy.util.files import atomic_write, made_folder

if TYPE_CHECKING:
    from deploy.recordings.exports.source import RecordingSource


def export_parquet(recording: RecordingSource, folder: Path) -> list[Path]:
    """Write parcels, events, faults and commands, each as a Parquet file.

    Raises:
        InputError: A library is not installed.
        DeployError: A file can't be written.
    """
    arrow = library("pyarrow", "the export to parquet")
    parquet = library("pyarrow.parquet", "the export to parquet")
    made_folder(folder)
    written: list[Path] = []
    for name in TABLES:
        path = folder / f"{name}.parquet"
        with atomic_write(path) as draft:
            parquet.write_table(arrow.table(columns(recording, name)), draft, compression="zstd")
        written.append(path)
    return written
