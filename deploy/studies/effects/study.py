"""Ablation study of effects, one at a time: additions to a scene, cost, and influence on the result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import TYPE_CHECKING, final

from deploy.errors import InputError
from deploy.scenes.memory_limit import too_many_paths
from deploy.studies.effects.ablation import (
    AblationPair,
    Table,
    VariantRejected,
    ablate,
    effect_types,
    refined,
    tables,
)
from deploy.studies.effects.run import TracedRun, run_variant
from deploy.studies.effects.sensitivity import Sensitivity, compare

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene

Notify = Callable[[str], None]
Key = tuple[bytes, bool]
"""Canonical text of a scene, and whether its cells run."""


@final
@dataclass(frozen=True, slots=True)
class Cost:
    """Wall time of an effect, from runs with and without it that took turns.

    Attributes:
        with_s: Wall times with the effect, s.
        without_s: Wall times without it, s, of the same rounds.
    """

    with_s: Sequence[float]
    without_s: Sequence[float]

    @property
    def ratio(self) -> float | None:
        """Median wall time with the effect over the median without."""
        return median(self.with_s) / median(self.without_s) if median(self.without_s) > 0.0 else None

    @property
    def _differences_s(self) -> list[float]:
        return [one - other for one, other in zip(self.with_s, self.without_s, strict=True)]

    @property
    def seconds(self) -> float:
        """Median over the rounds of what the effect costs, s."""
        return median(self._differences_s)

    @property
    def range_s(self) -> tuple[float, float] | None:
        """Least and largest cost over the rounds, s; None after a single round, which doesn't show its noise."""
        found = self._differences_s
        return (min(found), max(found)) if len(found) > 1 else None

    @property
    def is_noise(self) -> bool:
        """Whether rounds disagree on the sign, so that no cost can be seen."""
        return self.range_s is not None and self.range_s[0] <= 0.0 <= self.range_s[1]


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
        cost: Wall time of the effect; None where a run did not come to its end.
        influence: Difference between the runs with and without the effect; None where a run did not come to its end.
        error: Difference of a run from the same run under a finer solver: the solver's own error, the larger of both
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
    cost: Cost | None = None
    influence: Sensitivity | None = None
    error: Sensitivity | None = None
    reason: str = ""


@final
@dataclass(frozen=True, slots=True)
class _Measured:
    """A scene's first run, the solver's own error in it, and the wall times of all its runs, s."""

    run: TracedRun
    error: Sensitivity | None
    walls_s: list[float]


@final
@dataclass(frozen=True, slots=True)
class EffectStudy:
    """Ablation study of a scene; a scene that belongs to several comparisons is measured once.

    Each scene is run under a finer solver first, which also compiles what the scene needs. So its own first run is
    already a timed one.

    Args:
        scene: What is studied.
        repeats: Timed runs of each scene, at least 1. The scenes take turns, so that a slower machine is slower for
            all.
        notify: Called with one line at the start of each measurement.
    """

    scene: Scene
    repeats: int
    notify: Notify
    _known: dict[Key, _Measured] = field(default_factory=dict[Key, _Measured])

    def rows(self, names: Sequence[str] | None = None) -> list[AblationRow]:
        """Measure effects, a row each; in the order of the ladder, then those without a place in it.

        Args:
            names: Which effects; None: all.

        Raises:
            InputError: The runs' paths need more memory than there is.
        """
        wanted = [name for name in effect_types() if names is None or name in names]
        found = {name: AblationRow(name=name, on=name in tables(self.scene)) for name in wanted}
        rule = too_many_paths(2 * len(wanted), self.scene.ticks, self.scene.parcel_count)
        if rule:
            raise InputError(f"scene {self.scene.name}: duration_s = {self.scene.duration_s:g}: {rule}")
        pairs: dict[str, AblationPair] = {}
        for number, name in enumerate(wanted, start=1):
            self.notify(f"{name} ({number} of {len(wanted)}) ...")
            try:
                pairs[name] = ablate(self.scene, name)
                found[name] = self._measured(found[name], pairs[name])
            except (
                VariantRejected,
                InputError,
            ) as why:  # a scene may be valid, and its plant still refuse it
                found[name] = replace(found[name], reason=str(why))
        ended = [name for name in wanted if found[name].influence is not None]
        sides = [(pairs[name].on, pairs[name].off, pairs[name].cells) for name in ended]
        for name, cost in zip(ended, self.costs(sides), strict=True):
            found[name] = replace(found[name], cost=cost)
        return list(found.values())

    def row(self, name: str) -> AblationRow:
        """Measure one effect."""
        (row,) = self.rows([name])
        return row

    def influence(self, on: Scene, off: Scene, *, cells: bool) -> Sensitivity | None:
        """Measure the difference between two scenes; None where a run does not come to its end.

        Raises:
            InputError: The plant refuses one of them.
        """
        one, other = (self._measure(scene, cells=cells).run for scene in (on, off))
        return compare(one, other) if one.result.ok and other.result.ok else None

    def costs(self, sides: Sequence[tuple[Scene, Scene, bool]]) -> list[Cost]:
        """Time pairs of scenes that were measured before, with and without an effect.

        Args:
            sides: Scene with the effect, scene without it, and whether their cells run.
        """
        pairs = [((on.canonical(), cells), (off.canonical(), cells)) for on, off, cells in sides]
        scenes = {
            key: scene
            for pair, side in zip(pairs, sides, strict=True)
            for key, scene in zip(pair, side[:2], strict=True)
        }
        for turn in range(1, self.repeats):
            left = {key: scene for key, scene in scenes.items() if len(self._known[key].walls_s) <= turn}
            if left:
                seconds = sum(self._known[key].walls_s[0] for key in left)
                self.notify(f"timing, round {turn + 1} of {self.repeats} (about {seconds:.2g} s) ...")
            for (canonical, cells), scene in left.items():
                run = run_variant(scene, cells=cells, notify=self.notify)
                self._known[canonical, cells].walls_s.append(run.result.wall_s)
        return [Cost(self._known[on].walls_s, self._known[off].walls_s) for on, off in pairs]

    def _measured(self, row: AblationRow, pair: AblationPair) -> AblationRow:
        sides = [self._measure(scene, cells=pair.cells) for scene in (pair.on, pair.off)]
        row = replace(
            row,
            settings=pair.settings,
            beside=pair.beside,
            along=pair.along,
            solver=pair.on.solver.name,
            cells=pair.cells,
        )
        for side, word in zip(sides, ("with", "without"), strict=True):
            if not side.run.result.ok:
                return replace(row, reason=f"{word} it: {side.run.result.reason}")
        errors = [side.error for side in sides if side.error is not None]
        return replace(
            row,
            influence=compare(sides[0].run, sides[1].run),
            error=max(errors, key=lambda error: error.displacement_m or 0.0, default=None),
        )

    def _measure(self, scene: Scene, *, cells: bool) -> _Measured:
        """Run a scene under a finer solver and then as it is; once for all that is the same."""
        key = scene.canonical(), cells
        if key not in self._known:
            finer = refined(scene)
            check = run_variant(finer or scene, cells=cells, notify=self.notify)
            run = run_variant(scene, cells=cells, notify=self.notify)
            compared = finer is not None and check.result.ok and run.result.ok
            error = compare(run, check) if compared else None
            self._known[key] = _Measured(run, error, [run.result.wall_s])
        return self._known[key]
