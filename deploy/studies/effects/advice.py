"""Advice on effects: removable effects of a scene, and missing effects that would change the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from deploy.runs.headless import needs_cells
from deploy.studies.effects.ablation import VariantRejected, dependents, tables, variant

if TYPE_CHECKING:
    from deploy.studies.effects.sensitivity import Sensitivity
    from deploy.studies.effects.study import AblationRow, Cost, EffectStudy


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Together:
    """Result of leaving out several effects at once.

    Attributes:
        influence: Difference from the scene.
        cost: Wall time of the effects, with and without all of them.
    """

    influence: Sensitivity
    cost: Cost


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """Recommended changes of a scene's effects.

    Attributes:
        tolerance_m: Largest displacement of a corner at any time of the run for two results to count as equal, m.
        can_go: Rows of the scene's effects whose individual influence is within the tolerance.
        together: Result of leaving out all of ``can_go`` at once; None if ``can_go`` is empty or no result was found.
        missing: Rows of the effects that the scene lacks and whose influence, with typical settings, is beyond the
            tolerance.
        unclear: Names of effects whose influence is unknown because the solver's own error is beyond the tolerance.
    """

    tolerance_m: float
    can_go: tuple[AblationRow, ...]
    together: Together | None
    missing: tuple[AblationRow, ...]
    unclear: tuple[str, ...]


def advise(study: EffectStudy, rows: Sequence[AblationRow], tolerance_m: float) -> Advice:
    """Sort a scene's effects by whether they change its answer at any time.

    Args:
        study: Of the scene.
        rows: Its rows.
        tolerance_m: Greater than 0.
    """
    measured = [row for row in rows if row.influence is not None]
    unclear = tuple(row.name for row in measured if _off(row.error) >= tolerance_m)
    clear = [row for row in measured if row.name not in unclear]
    can_go = tuple(row for row in clear if row.on and _off(row.influence) < tolerance_m)
    return Advice(
        tolerance_m=tolerance_m,
        can_go=can_go,
        together=_together(study, [row.name for row in can_go]) if can_go else None,
        missing=tuple(row for row in clear if not row.on and _off(row.influence) >= tolerance_m),
        unclear=unclear,
    )


def _off(influence: Sensitivity | None) -> float:
    """How far the answer is off, m; a parcel that is there on one side only is off without bound."""
    if influence is None:
        return 0.0
    return float("inf") if influence.parcels else influence.displacement_m or 0.0


def _together(study: EffectStudy, names: Sequence[str]) -> Together | None:
    """Measure several effects and their dependents at once."""
    scene, own = study.scene, tables(study.scene)
    gone = {other for name in names for other in dependents(name, own)}
    study.notify(f"all of {', '.join(names)} ...")
    try:
        without = variant(
            scene,
            {name: table for name, table in own.items() if name not in gone},
            solver=scene.solver.model_dump(mode="json"),
        )
    except VariantRejected:
        return None
    cells = needs_cells(scene) or needs_cells(without)
    influence = study.influence(scene, without, cells=cells)
    if influence is None:
        return None
    (cost,) = study.costs([(scene, without, cells)])
    return Together(influence=influence, cost=cost)
