"""A recording in a notebook: facts, and the parcels' paths with their last outlines."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from deploy.util.formatting import plural
from deploy.util.notebook import array_svg, facts_html
from plant.geometry import placed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from deploy.recordings.trace import RunTrace

_POINTS = 200


def recording_html(track: RunTrace, digest: str | None, control: Sequence[dict[str, Any]]) -> str:
    """Return the representation of a recording.

    Args:
        track: Trace of the run.
        digest: Digest of the run.
        control: Live commands.
    """
    seconds = float(track.time_s[-1]) if len(track.time_s) else 0.0
    facts = [
        ("scene", track.scene),
        ("array", f"{plural(len(track.cells), 'cell')}, {plural(len(track.footprints_m), 'parcel')}"),
        ("time", f"{seconds:g} s, {plural(len(track.time_s), 'instant')}"),
        ("status", track.status or "cut before the end of the run"),
        ("events", plural(len(track.events), "event")),
        ("faults", plural(len(track.faults), "fault")),
        ("commands", plural(len(control), "command")),
        ("digest", digest or "none"),
    ]
    rows = np.unique(np.linspace(0, max(len(track.time_s) - 1, 0), _POINTS).astype(np.int64))
    paths: list[NDArray[np.float64]] = []
    outlines: list[NDArray[np.float64]] = []
    if len(track.time_s):
        paths = [track.parcels[rows, parcel, :2] for parcel in range(len(track.footprints_m))]
        outlines = [placed(corners, track.parcels[-1, i]) for i, corners in enumerate(track.footprints_m)]
    return facts_html(
        track.title or track.scene, facts, array_svg(track.positions_m, track.pitch_m, outlines, paths)
    )
