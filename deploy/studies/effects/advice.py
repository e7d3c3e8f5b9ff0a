"""Advice on effects: removable effects of a scene, and missing effects that would change the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from deploy.runs.headless import needs_cells
from deploy.studies.effects.ablation import VariantRejected, dependents, tables, variant
from deploy.studies.effects.sensitivity import Sensitivity, compare

if TYPE_CHECKING:
    from deploy.studies.effects.study import AblationRow, EffectStudy


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """Recommended changes of a scene's effects.

    Attributes:
        tolerance_m: Largest displacement of a corner at the end for two results to count as equal, m.
        can_go: Effects of the scene whose individual influence is within the tolerance.
        together: Influence of leaving out all of ``can_go`` at once; None if ``can_go`` is empty or no result was
            found.
        missing: Effects that the scene lacks and whose influence, with typical settings, is beyond the tolerance.
        unclear: Effects whose influence is unknown because the solver's own error is beyond the tolerance.
    """

    tolerance_m: float
    can_go: tuple[str, ...]
    together: Sensitivity | None
    missing: tuple[str, ...]
    unclear: tuple[str, ...]


def advise(study: EffectStudy, rows: Sequence[AblationRow], tolerance_m: float) -> Advice:
    """Sort a scene's effects by whether they change its answer.

    Args:
        study: Of the scene.
        rows: Its rows.
        tolerance_m: Greater than 0.
    """
    measured = [row for row in rows if row.influence is not None]
    unclear = {row.name for row in measured if _off(row.error) >= tolerance_m}
    clear = [row for row in measured if row.name not in unclear]
    can_go = tuple(row.name for row in clear if row.on and _off(row.influence) < tolerance_m)
    return Advice(
        tolerance_m=tolerance_m,
        can_go=can_go,
        together=_together(study, can_go) if can_go else None,
        missing=tuple(row.name for row in clear if not row.on and _off(row.influence) >= tolerance_m),
        unclear=tuple(row.name for row in measured if row.name in unclear),
    )


def _off(influence: Sensitivity | None) -> float:
    """How far the answer is off, m; a parcel that is there on one side only is off without bound."""
    if influence is None:
        return 0.0
    return float("inf") if influence.parcels else influence.displacement_m or 0.0


def _together(study: EffectStudy, names: Sequence[str]) -> Sensitivity | None:
    """Compute the joint influence of several effects and their dependents."""
    scene, own = study.scene, tables(study.scene)
    gone = {other for name in names for other in dependents(name, own)}
    try:
        without = variant(
            scene,
            {name: table for name, table in own.items() if name not in gone},
            solver=scene.solver.model_dump(mode="json"),
        )
    except VariantRejected:
        return None
    cells = needs_cells(scene) or needs_cells(without)
    results = [study.result(one, cells=cells) for one in (scene, without)]
    return compare(*results) if all(result.status == "ok" for result in results) else None
