"""What one run ends with: computed where the run is, told to where it is judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from deploy.errors import DeployError
from plant.errors import PlantError

if TYPE_CHECKING:
    from deploy.effect_study.course import Course
    from deploy.scene import Scene

Corners = tuple[tuple[float, float], ...]


@final
@dataclass(frozen=True, slots=True)
class ParcelEnd:
    """How one parcel ended.

    Attributes:
        state: As ``plant.reports.ParcelStatus`` has it.
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
        """Whether it left through an exit."""
        return self.state == "delivered"

    @property
    def there(self) -> bool:
        """Whether it has come and has not left; one that tipped lies where it tipped."""
        return self.state != "waiting" and not self.left


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """How one run ended.

    Attributes:
        status: ``ok``, ``failed``, ``stalled`` or ``unstable``.
        reason: Why it isn't ``ok``; empty where it is.
        parcels: All of them, in the scene's order; none where the run did not come to its end.
        misrouted: How many left by another exit than theirs.
        cells_lost: Cells that were lost though no fault struck them: their program raised, or they did not answer in
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


def ending_of(scene: Scene) -> Ending:
    """Run a scene, the whole system in this process; whatever goes wrong in it is how it ended."""
    from cell_firmware.errors import FirmwareError
    from deploy.digest import Digest
    from deploy.effect_study.course import follow

    digest = Digest(scene.canonical())
    try:
        course = follow(scene, cells=True, digest=digest)
    except (DeployError, PlantError, FirmwareError) as error:
        return Ending(status="failed", reason=str(error))
    if course.status != "ok":
        return Ending(
            status=course.status, reason=course.reason, cells_lost=course.cells_lost, wall_s=course.wall_s
        )
    return Ending(
        status="ok",
        parcels=_parcels(course),
        misrouted=course.misrouted,
        cells_lost=course.cells_lost,
        digest=digest.hexdigest,
        wall_s=course.wall_s,
    )


def _parcels(course: Course) -> tuple[ParcelEnd, ...]:
    from plant.geometry import placed

    return tuple(
        ParcelEnd(
            fate.state,
            fate.time_s,
            (float(course.states[number, 0]), float(course.states[number, 1])),
            tuple((float(x), float(y)) for x, y in placed(footprint, course.states[number])),
        )
        for number, (fate, footprint) in enumerate(zip(course.fates, course.footprints_m, strict=True))
    )
