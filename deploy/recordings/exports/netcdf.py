"""Export to netCDF: one file with everything, for xarray and others."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from deploy.recordings.exports.dataset import to_xarray
from deploy.recordings.exports.extra import library
from deploy.util.files import atomic_write

if TYPE_CHECKING:
    from deploy.recordings.exports.source import RecordingSource


def export_netcdf(recording: RecordingSource, path: Path) -> list[Path]:
    """Write a recording as a netCDF-4 file, compressed without loss.

    Raises:
        InputError: A library is not installed.
        DeployError: The file can't be written.
    """
    for name in ("h5netcdf", "h5py"):
        library(name, "the export to netcdf")
    dataset: Any = to_xarray(recording)
    numeric = [name for name, variable in dataset.variables.items() if variable.dtype.kind in "iufb"]
    compressed = {name: {"zlib": True, "complevel": 1} for name in numeric if dataset[name].size}
    with atomic_write(path) as draft:
        dataset.to_netcdf(draft, engine="h5netcdf", encoding=compressed)
    return [path]
