"""Registry of export formats: a new one is a file and a line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from deploy.errors import InputError
from deploy.recordings.exports.delimited import export_csv
from deploy.recordings.exports.foxglove import export_foxglove
from deploy.recordings.exports.names import DEFAULT
from deploy.recordings.exports.netcdf import export_netcdf
from deploy.recordings.exports.parquet import export_parquet

if TYPE_CHECKING:
    from deploy.recordings.exports.source import RecordingSource


class Export(NamedTuple):
    """One format.

    Attributes:
        write: Writes a recording to a path, and returns the files.
        name: Default name beside the recording; one without a suffix is a folder.
    """

    write: Callable[[RecordingSource, Path], list[Path]]
    name: str


EXPORTS: Final[Mapping[str, Export]] = {
    "netcdf": Export(export_netcdf, DEFAULT["netcdf"]),
    "parquet": Export(export_parquet, DEFAULT["parquet"]),
    "csv": Export(export_csv, DEFAULT["csv"]),
    "foxglove": Export(export_foxglove, DEFAULT["foxglove"]),
}
"""Every format."""


def export_recording(recording: RecordingSource, to: str, output: str | Path | None = None) -> list[Path]:
    """Write a recording in the format of other tools. Existing files are replaced, each as a whole.

    Args:
        recording: The recording.
        to: ``netcdf``, ``parquet``, ``csv`` or ``foxglove``.
        output: File, or folder for the formats of several files; None: beside the recording.

    Returns:
        The written files.

    Raises:
        InputError: There is no such format, ``output`` is the recording, or a library is not installed.
        DeployError: A file can't be written.
    """
    if to not in EXPORTS:
        raise InputError(f"--to {to}: must be one of {', '.join(EXPORTS)}")
    export = EXPORTS[to]
    path = recording.path.with_name(export.name) if output is None else Path(output)
    if path.exists() and path.samefile(recording.path):
        raise InputError(f"output {path}: is the recording itself")
    return export.write(recording, path)
