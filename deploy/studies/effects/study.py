"""Ablation study of effects, one at a time: additions to a scene, cost, and influence on the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING, final

from deploy.errors import InputError
from deploy.runs.headless import run_headless
from deploy.runs.result import RunResult
from deploy.studies.effects.ablation import (
    AblationPair,
    Table,
    VariantRejected,
    ablate,
    effect_types,
    refined,
    tables,
)
from deploy.studies.effects.sensitivity import Sensitivity, compare

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene

Notify = Callable[[str], None]


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class AblationRow:
    """Ablation result of one effect in a scene.

    Attributes:
        name: Name of the effect.
        on: Whether the scene has the effect.
        settings: Settings of the effect where it was on; None where it could not be toggled.
        beside: Effects required by ``name`` and missing in the scene, switched on in both runs.
        along: Effects that require ``name`` and were toggled with it.
        solver: Solver of both runs; None without runs.
        cells: Whether both runs included the cells, not the plant alone.
        wall_s: Median wall times with and without the effect, s.
        influence: Distance between the runs with and without the effect; None where a run did not come to its end.
        error: Distance of a run from the same run under a finer solver: the solver's own error, the larger of both
            runs. None where the solver can't be finer.
        reason: Reason for a missing influence; empty otherwise.
    """

    name: str
    on: bool
    settings: Table | None = None
    beside: Sequence[str] = ()
    along: Sequence[str] = ()
    solver: str | None = None
    cells: bool = False
    wall_s: tuple[float, float] | None = None
    influence: Sensitivity | None = None
    error: Sensitivity | None = None
    reason: str = ""

    @property
    def cost_ratio(self) -> float | None:
        """Wall time with it over wall time without."""
        return None if self.wall_s is None or self.wall_s[1] <= 0.0 else self.wall_s[0] / self.wall_s[1]


@final
@dataclass(frozen=True, slots=True)
class EffectStudy:
    """Ablation study of a scene; runs needed by several comparisons are executed once.

    Args:
        scene: What is studied.
        repeats: Timed runs of each side, at least 1, after one that is not timed.
        notify: Told what begins, one line.
    """

    scene: Scene
    repeats: int
    notify: Notify
    _known: dict[tuple[bytes, bool], RunResult] = field(default_factory=dict[tuple[bytes, bool], RunResult])

    def rows(self, names: Sequence[str] | None = None) -> list[AblationRow]:
        """A row an effect; in the order of the ladder, then those without a place in it.

        Args:
            names: Which effects; None: all.
        """
        return [self.row(name) for name in (effect_types() if names is None else names)]

    def row(self, name: str) -> AblationRow:
        """One effect's."""
        on = name in tables(self.scene)
        self.notify(f"{name} ...")
        try:
            return self._measured(name, on, ablate(self.scene, name))
        except (VariantRejected, InputError) as why:  # a scene may be valid, and its plant still refuse it
            return AblationRow(name=name, on=on, reason=str(why))

    def _measured(self, name: str, on: bool, pair: AblationPair) -> AblationRow:
        with_it, without = (self.result(scene, cells=pair.cells) for scene in (pair.on, pair.off))
        ended = [result for result in (with_it, without) if result.status != "ok"]
        whole = not ended
        return AblationRow(
            name=name,
            on=on,
            settings=pair.settings,
            beside=pair.beside,
            along=pair.along,
            solver=pair.on.solver.name,
            cells=pair.cells,
            wall_s=self._timed(pair) if whole else None,
            influence=compare(with_it, without) if whole else None,
            error=self._error(pair) if whole else None,
            reason="" if whole else f"{'with' if with_it in ended else 'without'} it: {ended[0].reason}",
        )

    def result(self, scene: Scene, *, cells: bool) -> RunResult:
        """The run of a scene; once for all that is the same."""
        key = (scene.canonical(), cells)
        if key not in self._known:
            self._known[key] = run_headless(scene, cells=cells)
        return self._known[key]

    def _timed(self, pair: AblationPair) -> tuple[float, float]:
        """Medians; the two take turns, so that a slower machine is slower for both."""
        spans = [
            (run_headless(pair.on, cells=pair.cells).wall_s, run_headless(pair.off, cells=pair.cells).wall_s)
            for _ in range(self.repeats)
        ]
        return median(span[0] for span in spans), median(span[1] for span in spans)

    def _error(self, pair: AblationPair) -> Sensitivity | None:
        """The solver's own error, of whichever side it is larger."""
        found = [self._against_finer(scene, pair.cells) for scene in (pair.on, pair.off)]
        known = [error for error in found if error is not None]
        return max(known, key=lambda error: error.displacement_m or 0.0, default=None)

    def _against_finer(self, scene: Scene, cells: bool) -> Sensitivity | None:
        finer = refined(scene)
        if finer is None:
            return None
        result = self.result(finer, cells=cells)
        return compare(self.result(scene, cells=cells), result) if result.status == "ok" else None
