"""Evaluation of runs: success, parcels' errors, and completion times."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from deploy.errors import DeployError
from plant.errors import PlantError

if TYPE_CHECKING:
    from deploy.runs.result import RunResult
    from deploy.scenes.scene import Scene
    from deploy.studies.campaign.criterion import Criterion


Corners = tuple[tuple[float, float], ...]


@final
@dataclass(frozen=True, slots=True)
class ParcelEnd:
    """Final state of one parcel.

    Attributes:
        state: As ``plant.observations.ParcelStatus`` has it.
        time_s: Since when.
        place_m: Of its centre of mass, in world coordinates.
        corners_m: Of its footprint, in world coordinates.
    """

    state: str
    time_s: float
    place_m: tuple[float, float]
    corners_m: Corners

    @property
    def left(self) -> bool:
        """Whether the parcel left through an exit."""
        return self.state == "delivered"

    @property
    def there(self) -> bool:
        """Whether the parcel is on the array, tipped parcels included."""
        return self.state != "waiting" and not self.left


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CaseRecord:
    """Entry of the journal for one run: the part of its `RunResult` that the evaluation needs.

    Attributes:
        status: ``ok``, ``failed``, ``stalled`` or ``unstable``.
        reason: Why it isn't ``ok``; empty where it is.
        parcels: All of them, in the scene's order; none where the run did not come to its end.
        misrouted: How many left by another exit than theirs.
        cells_lost: Cells that were lost without a fault of their own: their program raised, or they did not answer in
            time. What follows from the latter is not repeatable.
        digest: Of all ticks, as ``mdms run`` has it; None where the run did not come to its end.
        wall_s: Of the run itself, without start-up.
    """

    status: str
    reason: str = ""
    parcels: tuple[ParcelEnd, ...] = ()
    misrouted: int = 0
    cells_lost: int = 0
    digest: str | None = None
    wall_s: float = 0.0


def run_case(scene: Scene, *, check: bool = False) -> CaseRecord:
    """Run a scene with the whole system in this process; errors are part of the result.

    Args:
        scene: The scene.
        check: Whether the run ends as failed where an invariant of its program is broken.
    """
    from cell_firmware.errors import FirmwareError
    from deploy.recordings.digest import Digest
    from deploy.runs.headless import run_headless

    digest = Digest(scene.canonical())
    try:
        result = run_headless(scene, digest=digest, check="stop" if check else None)
    except (DeployError, PlantError, FirmwareError) as error:
        return CaseRecord(status="failed", reason=str(error))
    if result.status != "ok":
        return CaseRecord(
            status=result.status, reason=result.reason, cells_lost=result.cells_lost, wall_s=result.wall_s
        )
    return CaseRecord(
        status="ok",
        parcels=_parcels(result),
        misrouted=result.misrouted,
        cells_lost=result.cells_lost,
        digest=digest.hexdigest,
        wall_s=result.wall_s,
    )


def _parcels(result: RunResult) -> tuple[ParcelEnd, ...]:
    from plant.geometry import placed

    return tuple(
        ParcelEnd(
            fate.state,
            fate.time_s,
            (float(result.state[number, 0]), float(result.state[number, 1])),
            tuple((float(x), float(y)) for x, y in placed(footprint, result.state[number])),
        )
        for number, (fate, footprint) in enumerate(
            zip(result.parcel_status, result.footprints_m, strict=True)
        )
    )


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class CaseOutcome:
    """Evaluated result of one run.

    Attributes:
        status: ``ok``, ``failed``, ``stalled`` or ``unstable``.
        reason: Reason for another status than ``ok``, or for a failure of the criterion; empty after a success.
        succeeded: See `evaluate`.
        error_m: See `evaluate`.
        time_s: See `evaluate`.
        cells_lost: Number of cells that were lost without a fault.
        digest: Digest of all ticks, as of ``mdms run``; None where the run did not come to its end.
        wall_s: Wall time of the run itself, without start-up, s.
    """

    status: str
    reason: str
    succeeded: bool
    error_m: float | None
    time_s: float | None
    cells_lost: int
    digest: str | None
    wall_s: float


def evaluate(ending: CaseRecord, baseline: CaseRecord | None, criterion: Criterion) -> CaseOutcome:
    """Judge a run.

    It has *succeeded* if its status is ``ok``; no parcel tipped, fell off the array (left it other than through an
    exit) or was misrouted; every parcel that rests in the baseline run rests here or has left, and every one that
    left there has left here; and what the criterion demands holds.

    The *error* is the largest distance, at the end, of any corner of a parcel's footprint from where it is in the
    baseline run, over the parcels that are there in both. Without a baseline run it is the largest distance of a
    parcel's centre of mass from the criterion's place. None where there is none. The *time* is when the last
    parcel came to rest or left; None unless every parcel did.

    Args:
        ending: Of the run.
        baseline: Of the run that it is compared with; None: with nothing.
        criterion: Demands on the run.
    """
    status, reason = ending.status, ending.reason
    if status == "ok" and baseline is not None and baseline.status != "ok":
        status, reason = "failed", f"the baseline run: {baseline.status}: {baseline.reason}"
    if status != "ok":
        return CaseOutcome(
            status=status,
            reason=reason,
            succeeded=False,
            error_m=None,
            time_s=None,
            cells_lost=ending.cells_lost,
            digest=ending.digest,
            wall_s=ending.wall_s,
        )
    if baseline is not None:
        error_m = error_of(ending, baseline)
    else:
        error_m = None if criterion.place_m is None else distance_of(ending, criterion.place_m)
    flaw = _failure_reason(ending, baseline) or _unmet(ending, error_m, criterion)
    return CaseOutcome(
        status=status,
        reason=flaw,
        succeeded=not flaw,
        error_m=error_m,
        time_s=time_of(ending),
        cells_lost=ending.cells_lost,
        digest=ending.digest,
        wall_s=ending.wall_s,
    )


def _failure_reason(ending: CaseRecord, baseline: CaseRecord | None) -> str:
    """Return why a completed run failed, as far as parcels' states show; empty if no state does."""
    for number, parcel in enumerate(ending.parcels):
        if parcel.state == "tipped":
            return f"parcel {number} tipped"
        if parcel.state == "off_array":
            return f"parcel {number} fell off the array"
    if ending.misrouted:
        return f"{ending.misrouted} misrouted"
    for number, (parcel, other) in enumerate(zip(ending.parcels, _of(baseline), strict=False)):
        if other.left and not parcel.left:
            return f"parcel {number} has not left"
        if other.state == "at_rest" and not _done(parcel):
            return f"parcel {number} is {parcel.state}"
    return ""


def _unmet(ending: CaseRecord, error_m: float | None, criterion: Criterion) -> str:
    """The criterion's demand that isn't met; empty: all are."""
    for number, parcel in enumerate(ending.parcels):
        if criterion.delivered and not parcel.left and parcel.state != "waiting":
            return f"parcel {number} is {parcel.state}, not delivered"
        if criterion.at_rest and not _done(parcel):
            return f"parcel {number} is {parcel.state}"
    if criterion.within_m is not None and error_m is not None and error_m > criterion.within_m:
        return f"{error_m:.3g} m from {criterion.reference}"
    return ""


def _of(ending: CaseRecord | None) -> tuple[ParcelEnd, ...]:
    return () if ending is None else ending.parcels


def _done(parcel: ParcelEnd) -> bool:
    """Whether the parcel came to rest or left."""
    return parcel.left or parcel.state == "at_rest"


def error_of(ending: CaseRecord, baseline: CaseRecord) -> float | None:
    """The largest distance of a corner from where it is in the baseline run, m; None where no parcel is in both."""
    pairs = zip(ending.parcels, baseline.parcels, strict=False)
    distances = [
        math.dist(corner, other)
        for one, there in pairs
        if one.there and there.there
        for corner, other in zip(one.corners_m, there.corners_m, strict=False)
    ]
    return max(distances, default=None)


def distance_of(ending: CaseRecord, place_m: tuple[float, float]) -> float | None:
    """The largest distance of a parcel's centre of mass from a place, m; None where no parcel is there."""
    return max((math.dist(one.place_m, place_m) for one in ending.parcels if one.there), default=None)


def time_of(ending: CaseRecord) -> float | None:
    """Return when the last parcel came to rest or left, s; None if some parcel didn't, or without parcels."""
    if not all(_done(parcel) for parcel in ending.parcels):
        return None
    return max((parcel.time_s for parcel in ending.parcels), default=None)
