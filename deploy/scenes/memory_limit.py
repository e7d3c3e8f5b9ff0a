"""Estimate of a run's minimum memory against the machine's, checked before allocation."""

from __future__ import annotations

from pathlib import Path
from typing import Final

CELL_BYTES: Final = 1_200
"""Of a cell in the simplest run; messages, boards and clocks come on top."""
PARCEL_BYTES: Final = 1_000
"""Of a parcel in the simplest run."""
WORKER_BYTES: Final = 4_000_000
"""Of a worker process, apart from what it shares with the others."""
SAMPLE_BYTES: Final = 150
"""Of a parcel at one instant, in a simulation that stores its whole trajectory: its state, and copies of it."""
PATH_BYTES: Final = 48
"""Of a parcel at one instant of a path."""

_MEMINFO = Path("/proc/meminfo")
_CGROUP = Path("/sys/fs/cgroup")


def available_bytes() -> int | None:
    """Return the memory available to this process, limited by machine and control group; None if unknown."""
    found = [bytes_ for bytes_ in (_of_machine(), _of_group()) if bytes_ is not None]
    return min(found, default=None)


def shortage(needed: int) -> str:
    """Say what is needed and what there is, where the first is more than the second; empty otherwise."""
    there = available_bytes()
    if there is None or needed <= there:
        return ""
    return f"about {_format_size(needed)} of memory at least, and {_format_size(there)} are available"


def too_many_cells(cells: int) -> str:
    """The rule that an array of so many cells breaks on this machine; empty: none."""
    lack = shortage(cells * CELL_BYTES)
    return f"{cells:,} cells need {lack}: the array must be smaller" if lack else ""


def too_many_parcels(parcels: int) -> str:
    """The rule that so many parcels break on this machine; empty: none."""
    lack = shortage(parcels * PARCEL_BYTES)
    return f"{parcels:,} parcels need {lack}: there must be fewer" if lack else ""


def too_many_workers(workers: int, cells: int) -> str:
    """The rule that so many worker processes break on this machine; empty: none."""
    lack = shortage(workers * WORKER_BYTES + cells * CELL_BYTES)
    return f"{workers:,} worker processes need {lack}: there must be fewer" if lack else ""


def too_many_samples(samples: int, parcels: int) -> str:
    """The rule that a trajectory of so many samples breaks on this machine; empty: none."""
    lack = shortage(samples * (parcels * SAMPLE_BYTES + 16))
    return (
        f"a simulation keeps its whole trajectory, and {samples:,} samples need {lack}: duration_s must be shorter"
        if lack
        else ""
    )


def too_many_paths(runs: int, samples: int, parcels: int) -> str:
    """The rule that comparing the paths of so many runs breaks on this machine; empty: none."""
    lack = shortage(runs * samples * parcels * PATH_BYTES)
    return (
        f"the paths of {runs:,} runs need {lack}: compare fewer effects, or a shorter duration_s"
        if lack
        else ""
    )


def _format_size(size: int) -> str:
    for unit, name in ((10**12, "TB"), (10**9, "GB"), (10**6, "MB")):
        if size >= unit:
            return f"{size / unit:,.3g} {name}"
    return f"{size:,} bytes"


def _of_machine() -> int | None:
    try:
        lines = _MEMINFO.read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    figures = {name: rest for name, _, rest in (line.partition(":") for line in lines)}
    available = figures.get("MemAvailable", "").split()
    return int(available[0]) * 1024 if available else None


def _of_group() -> int | None:
    """Memory left to the control group of version 2 that this process sees as the root, if it is limited."""
    try:
        limit = (_CGROUP / "memory.max").read_text(encoding="ascii").strip()
        used = int((_CGROUP / "memory.current").read_text(encoding="ascii"))
        return None if limit == "max" else max(int(limit) - used, 0)
    except (OSError, ValueError):
        return None
