"""Outputs of a run or a simulation: name, recording header, outcomes and plots."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deploy.errors import DeployError
from deploy.plots.overview import FILE_NAME as PICTURE
from deploy.plots.overview import draw_overview
from deploy.recordings.format import Header
from deploy.recordings.trace import Exit
from deploy.runs.summary import ParcelOutcome, Summary
from deploy.util.files import versions
from deploy.util.signals import Interrupted, Interruption

if TYPE_CHECKING:
    from deploy.recordings.recording import Recording
    from deploy.recordings.trace import RunTrace
    from deploy.scenes.scene import Scene
    from plant.array import CellArray
    from plant.plant import Plant


def run_name(scene: Scene, suffix: str) -> str:
    """Return a name for the run, valid in a key expression and in a file name."""
    return f"{default_run(scene)}-{suffix}"


def default_run(scene: Scene) -> str:
    """Return the name of a run whose processes are started by hand: that of the scene, valid in a key expression."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "-", Path(scene.name).stem).strip("-_")
    return stem[:40] or "scene"


def recording_header(
    run: str, scene: Scene, array: CellArray, footprints_m: Sequence[NDArray[np.float64]]
) -> Header:
    """Build the header of a run's recording.

    Args:
        run: Name of the run.
        scene: Scene of the run.
        array: Cells of the scene.
        footprints_m: Corners of every parcel, fed ones included, about its centre of mass, in its axes, ``(v, 2)``, m.
    """
    made = Header(
        run=run,
        title=scene.title,
        scene_name=scene.name,
        scene=scene.model_dump(mode="json"),
        versions=versions(),
        period_ns=scene.tick_ns,
        pitch_m=scene.array.pitch_m,
        cells=[list(cell) for cell in array.lattice.cells],
        positions_m=array.positions_m.tolist(),
        sensors_m=[list(point) for point in scene.array.sensors_m],
        footprints_m=[corners.tolist() for corners in footprints_m],
    )
    if scene.effects.feeders is not None:
        made["own_parcels"] = len(scene.parcels)
        made["exits"] = [{"name": name, "corners_m": corners.tolist()} for name, corners in exits(scene)]
    return made


def exits(scene: Scene) -> list[Exit]:
    """Return name and corners of every exit, in world coordinates."""
    feeders = scene.effects.feeders
    return [] if feeders is None else [(exit_.name, exit_.corners()) for exit_ in feeders.exits]


def parcel_outcomes(plant: Plant) -> list[ParcelOutcome]:
    """Return position, velocity and state of every parcel."""
    return [
        ParcelOutcome.of(numbers, status.state, status.time_s, status.detail)
        for numbers, status in zip(plant.state, plant.status, strict=True)
    ]


def validity(plant: Plant, scene: Scene) -> dict[str, Any]:
    """Return the known limits of a result's accuracy, as fields of a summary."""
    outrun = [
        (float(since_s), i) for i, since_s in enumerate(plant.outrun_s) if since_s <= plant.time_ns * 1e-9
    ]
    captured = np.flatnonzero(plant.captured).tolist()
    return {
        "events_left_out": plant.events_left_out,
        "law_not_valid": [{"parcel": i, "since_s": since_s} for since_s, i in sorted(outrun)],
        "captured": {"capture_m": getattr(scene.solver, "capture_m", 0.0), "parcels": captured}
        if captured
        else None,
    }


def write_or_fail(
    summary: Summary,
    folder: Path,
    leave: Callable[[Summary, Path], Summary],
    warn: Callable[[str], None],
) -> Summary:
    """Write an output into a run's folder; a write error is reported, and fails a run that was ok."""
    try:
        return leave(summary, folder)
    except DeployError as error:
        reason = str(error)
        warn(f"{reason}; the result of the run is printed nevertheless")
    if summary.status == "ok":
        summary = replace(summary, status="failed", reason=reason)
        with suppress(DeployError):
            summary.write(folder)
    return summary


def draw_run_overview(
    summary: Summary, run: Callable[[], Recording | RunTrace], folder: Path, interruption: Interruption
) -> Summary:
    """Draw the overview of a run into its folder.

    Args:
        summary: Summary of the run.
        run: Returns the run to draw.
        folder: Folder of the run.
        interruption: Cancels drawing.

    Returns:
        The summary; if drawing was cancelled, with status ``interrupted``, in its file too.

    Raises:
        DeployError: It can't be written.
    """
    return draw_or_interrupt(summary, lambda: draw_overview(run(), folder / PICTURE), folder, interruption)


def draw_or_interrupt(
    summary: Summary, draw: Callable[[], None], folder: Path, interruption: Interruption
) -> Summary:
    """Draw a plot of a run; see ``draw_run_overview``."""
    try:
        with interruption.interruptible():
            draw()
    except Interrupted:
        summary = replace(summary, status="interrupted", reason="interrupted while the plot was drawn")
        summary.write(folder)
    return summary
