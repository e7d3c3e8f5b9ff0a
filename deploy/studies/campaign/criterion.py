"""The criterion of success of a campaign's runs: demanded by the command line or by the scene's goal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from deploy.errors import InputError
from deploy.util.formatting import format_point

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from deploy.studies.campaign.spec import CampaignSpec


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """Success criterion of a completed run.

    Attributes:
        within_m: Largest error of a success, m; None: any.
        place_m: Place that errors are measured from where there is no baseline run, m; None: no error then.
        at_rest: Whether every parcel must rest or have been delivered.
        delivered: Whether every parcel that was fed must have been delivered.
        by: Origin of the demands: ``--within``, the scene's ``goal``, or both.
        compared: Whether there is a baseline run.
    """

    within_m: float | None = None
    place_m: tuple[float, float] | None = None
    at_rest: bool = False
    delivered: bool = False
    by: str = "--within"
    compared: bool = True

    def words(self) -> str:
        """Return the demands in one line, with where they come from."""
        demands: list[str] = []
        if self.within_m is not None:
            demands.append(f"error at most {self.within_m:g} m from {self.reference}")
        if self.at_rest:
            demands.append("every parcel at rest or delivered")
        if self.delivered:
            demands.append("every parcel that was fed delivered")
        return f"{', '.join(demands)} ({self.by})"

    @property
    def reference(self) -> str:
        """Description of the reference of errors."""
        if self.compared or self.place_m is None:
            return "where the baseline run ends"
        return f"{format_point(self.place_m)} m"


def criterion_of(spec: CampaignSpec, scene: Scene, *, compared: bool) -> Criterion:
    """Return the criterion for the runs of a scene.

    Args:
        spec: The campaign.
        scene: The scene of a case.
        compared: Whether there is a baseline run.

    Raises:
        InputError: Neither the command line nor the scene demands anything, or the demand can't be judged.
    """
    goal = scene.goal
    measured = compared or (goal is not None and goal.place_m is not None)
    if spec.within_m is not None and not measured:
        raise InputError(
            f"--within {spec.within_m:g}: no reference for errors: without --fault and --against there is no "
            f"baseline run to compare with, and scene {spec.scene} has no goal.place_m; give one of them"
        )
    if goal is None:
        if spec.within_m is None:
            raise InputError(_nothing_demanded(spec, compared=compared))
        return Criterion(within_m=spec.within_m, compared=compared)
    demands = goal.at_rest or goal.delivered
    if spec.within_m is None and not measured and not demands:
        raise InputError(_nothing_demanded(spec, compared=compared))
    by = "the scene's goal"
    if spec.within_m is not None:
        by = f"--within and {by}" if demands else "--within"
    return Criterion(
        within_m=(spec.within_m or goal.within_m) if measured else None,
        place_m=goal.place_m,
        at_rest=goal.at_rest,
        delivered=goal.delivered,
        by=by,
        compared=compared,
    )


def _nothing_demanded(spec: CampaignSpec, *, compared: bool) -> str:
    if compared:
        return (
            f"campaign: no criterion of success for {spec.scene}: give --within METRES, the largest "
            "distance of a parcel from where the baseline run ends, or give the scene a [goal]"
        )
    return (
        f"campaign: no criterion of success for {spec.scene}: without --fault and --against there is no "
        "baseline run to compare with; give the scene a [goal], such as "
        "--set 'goal={ place_m = [0.0, 0.0], within_m = 0.05 }' or --set goal.at_rest=true"
    )
