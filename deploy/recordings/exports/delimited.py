"""Export to CSV: a folder with one file a table. Needs no library."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deploy.recordings.exports.tables import TABLES, columns
from deploy.util.files import atomic_write, made_folder

if TYPE_CHECKING:
    from deploy.recordings.exports.source import RecordingSource


def export_csv(recording: RecordingSource, folder: Path) -> list[Path]:
    """Write parcels, events, faults and commands, each as a CSV file with a heading.

    A number has the fewest digits that give back the same number. An absent value is an empty field.

    Raises:
        DeployError: A file can't be written.
    """
    made_folder(folder)
    written: list[Path] = []
    for name in TABLES:
        path, found = folder / f"{name}.csv", columns(recording, name)
        with atomic_write(path) as draft, draft.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(found)
            writer.writerows(zip(*map(_values, found.values()), strict=True))
        written.append(path)
    return written


def _values(column: Any) -> Iterable[Any]:
    """Python's own numbers, which ``csv`` writes by ``repr``."""
    return column.tolist() if isinstance(column, np.ndarray) else column  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
