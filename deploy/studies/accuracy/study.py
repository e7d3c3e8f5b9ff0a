"""Accuracy study: every solver that supports a scene, at every setting of its sweeps."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np

from deploy.errors import InputError
from deploy.runs.field_simulation import field_speeds, without_cells
from deploy.runs.setup import load_plant
from deploy.scenes.fault_schedule import cell_only_faults
from deploy.studies.accuracy.errors import (
    compare_events,
    corner_speeds,
    displacement_m,
    distribution_distance,
)
from deploy.studies.accuracy.reference import METHODS, Reference, ReferenceSolver
from deploy.studies.accuracy.report import AccuracyReport, AccuracyRow, Sampling, noise_s
from deploy.studies.accuracy.sampling_cost import sampling_cost
from deploy.studies.accuracy.sweep import Trial, lines, refusal, with_solver
from deploy.studies.accuracy.trace import AccuracyTrace, RunTime, run_trace, time_run
from plant.errors import PlantError

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene

SHORT_S = 0.02
"""A run this short is made ..."""
SHORT_RUNS = 5
"""... so many times in a round, and the shortest counts."""
LONG_S = 0.2
"""A run this long needs no other before it to be warm: it counts."""
QUICK_S = 20.0
"""Processor time after which a quick study begins no further run; coarse settings come first. The reference's time is
taken off, ..."""
QUICK_LEFT_S = 5.0
"""... but so much is left."""
QUICK_SAMPLING_S = 1.5
"""Wall time of a run of the whole system after which a quick study tries no shorter period."""
QUICK_PARCELS = 8
"""Parcels beyond which a quick study does without references that are made one parcel at a time."""
QUICK_REFERENCE_S = 8.0
"""Processor time for the reference of a quick study."""
FEWEST = 5
"""Samples of a distribution, at least."""
_Place = tuple[int, int]
"""Number of a line, and of a setting in it."""


@final
@dataclass(frozen=True, slots=True)
class StudyPlan:
    """Extent of a study: settings, repetitions and time limits.

    Attributes:
        quick: few settings, few runs, and no more than half a minute.
        repeats: runs that are timed, each setting.
        limit_s: processor time that one run may take.
        timing_s: wall time after which a setting is not repeated again.
        sampling: whether the whole system is run, too, at several control periods.
    """

    quick: bool = False
    repeats: int = 5
    limit_s: float = 60.0
    timing_s: float = 10.0
    sampling: bool = True

    @classmethod
    def of(cls, *, quick: bool, repeats: int | None = None) -> StudyPlan:
        """The usual ones; where repeats are requested, all of them are made."""
        if quick:
            return cls(True, repeats or 3, limit_s=3.0, timing_s=np.inf if repeats else 1.0)
        return cls(repeats=repeats or 5, timing_s=np.inf if repeats else 10.0)


def study(
    scene: Scene,
    plan: StudyPlan | None = None,
    *,
    say: Callable[[str], None] | None = None,
    poll: Callable[[], None] = lambda: None,
) -> AccuracyReport:
    """Run every solver on a scene and judge it.

    Args:
        scene: its firmware must be ``velocity_field``; motors are left out, as ``mdms simulate`` does.
        plan: how.
        say: receives a line before each step.
        poll: called now and then; may raise.

    Raises:
        InputError: The scene has no field or no parcels, the plant refuses it, or nobody gets through it.
    """
    return _Study(scene, plan or StudyPlan(), say or (lambda _: None), poll).report()


@final
class _Study:
    """One study."""

    def __init__(
        self, scene: Scene, plan: StudyPlan, say: Callable[[str], None], poll: Callable[[], None]
    ) -> None:
        self._named, self._plan, self._say, self._poll = scene, plan, say, poll
        self._scene = without_cells(scene)
        self._over_s = np.inf
        self._first: dict[tuple[str, float], RunTime] = {}

    def report(self) -> AccuracyReport:
        plan, scene = self._plan, self._scene
        plant = load_plant(scene, self._say)
        self._say("loading every solver (seconds for each solver whose kernels must be compiled) ...")
        field_speeds(scene, plant.array.positions_m)
        for fault in cell_only_faults(self._named):
            self._say(
                f"{fault} is left out except for the cost of sampling: solvers move parcels without cells"
            )
        if not len(plant.state):
            raise InputError(f"scene {scene.name}: has no parcels: accuracy needs at least one")
        self._say("the reference ...")
        many, begun_s = plan.quick and len(plant.state) > QUICK_PARCELS, time.process_time()
        referee = ReferenceSolver(
            scene,
            limit_s=2.0 * plan.limit_s,
            budget_s=QUICK_REFERENCE_S if plan.quick else np.inf,
            thorough=not plan.quick,
            poll=self._poll,
            methods=[one for one in METHODS if not (many and one["name"] in ("heyoka", "scipy"))],
        )
        reference = referee.solve()
        rows = self._rows(reference, time.process_time() - begun_s)
        sampling: list[Sampling] = []
        if plan.sampling:
            self._say("the whole system, at several control periods ...")
            sampling += sampling_cost(
                self._named,
                reference.trace,
                quick=plan.quick,
                limit_s=QUICK_SAMPLING_S if plan.quick else plan.limit_s,
                poll=self._poll,
            )
        return AccuracyReport(
            scene=self._named.name,
            title=scene.title or scene.name,
            duration_s=scene.duration_s,
            cells=len(plant.array),
            parcels=len(plant.state),
            period_s=scene.cells.period_ns * 1e-9,
            quick=plan.quick,
            reference=reference,
            rows=rows,
            sampling=sampling,
        )

    def _rows(self, reference: Reference, spent_s: float) -> list[AccuracyRow]:
        """All rows, line by line; coarse settings of every line are run before finer ones of any.

        ``spent_s`` is what the reference took.
        """
        swept = [
            tuple(trial for trial in line if trial.quick or not self._plan.quick)
            for line in lines(self._scene)
        ]
        done: dict[tuple[int, int], AccuracyRow] = {}
        first = [line[0] for line in lines(self._scene)]
        refused = {number: why for number, trial in enumerate(first) if (why := self._refusal(trial))}
        if self._plan.quick:  # all that had to be compiled is
            self._over_s = time.process_time() + max(QUICK_S - spent_s, QUICK_LEFT_S)
        for level in range(max(map(len, swept))):
            for number, line in enumerate(swept):
                if number not in refused and level < len(line):
                    done[number, level] = self._row(line[level], reference)
        done |= self._timed(
            {key: swept[key[0]][key[1]] for key, row in done.items() if row.status == "ok"}, done
        )
        rows: list[AccuracyRow] = []
        for number, line in enumerate(swept):
            if number in refused:
                rows.append(_bare(first[number], "omitted", refused[number], whole=True))
            elif not line:
                rows.append(_bare(first[number], "omitted", "not in a quick study", whole=True))
            rows += [done[number, level] for level in range(len(line)) if (number, level) in done]
        return rows

    def _refusal(self, trial: Trial) -> str | None:
        """Return why a solver is excluded: it doesn't support the scene, or its package is not installed."""
        why = refusal(self._scene, trial.settings)
        if why is not None:
            return why
        from plant.plant import Plant

        try:
            # what a solver needs is checked where its plant is built
            Plant(with_solver(self._scene, trial.settings).plant_spec())
        except PlantError as error:
            return str(error)
        return None

    def _row(self, trial: Trial, reference: Reference) -> AccuracyRow:
        """Run and evaluate a solver at a single setting."""
        if time.process_time() > self._over_s:
            return _bare(trial, "omitted", "not begun, for lack of time: the study is quick")
        self._say(f"{trial.solver} {trial.setting}")
        scene = with_solver(self._scene, trial.settings)
        judge, known = reference.judge(trial.solver)
        trace = run_trace(scene, self._plan.limit_s, self._poll)
        row = replace(_bare(trial, trace.status, trace.reason), judged_by=judge, effort=trace.effort)
        if trace.status != "ok":
            return replace(row, **_before(trace, known, reference))
        self._first[trial.line, trial.value] = trace.time
        return replace(row, **_judged(trace, known, reference))

    def _timed(
        self, trials: Mapping[_Place, Trial], rows: Mapping[_Place, AccuracyRow]
    ) -> dict[_Place, AccuracyRow]:
        """Time settings in turns, so that a slower machine is slower for all; return their rows with the times."""
        plan, found = self._plan, dict[_Place, list[RunTime]]()
        for key, trial in trials.items():
            first = self._first[trial.line, trial.value]
            found[key] = [first] if first.wall_s > LONG_S else []
        for turn in range(plan.repeats):
            self._say(f"times, round {turn + 1} of {plan.repeats} ...")
            for key, trial in trials.items():
                times = found[key]
                late = time.process_time() > self._over_s and turn > 0
                if len(times) <= turn and sum(one.wall_s for one in times) < plan.timing_s and not late:
                    times.append(self._time(with_solver(self._scene, trial.settings)))
        shortest = min((_median(times) for times in found.values()), default=0.0)
        return {
            key: replace(
                rows[key],
                **_times(times),
                speed=self._scene.duration_s / _median(times),
                relative=_median(times) / shortest,
            )
            for key, times in found.items()
        }

    def _time(self, scene: Scene) -> RunTime:
        """Time a run; of a short one, which another program easily doubles, the shortest of several."""
        found = [time_run(scene, self._poll)]
        while found[0].wall_s < SHORT_S and len(found) < SHORT_RUNS:
            found.append(time_run(scene, self._poll))
        return min(found, key=lambda one: one.wall_s)


def _median(times: Sequence[RunTime]) -> float:
    return statistics.median(one.wall_s for one in times)


def _times(times: Sequence[RunTime]) -> dict[str, Any]:
    """Fields of a row on its times."""
    walls, calls = [one.wall_s for one in times], [one.solver_s for one in times]
    noise_low_s, noise_high_s = noise_s(walls)
    return {
        "wall_s": statistics.median(walls),
        "wall_low_s": min(walls),
        "wall_high_s": max(walls),
        "noise_low_s": noise_low_s,
        "noise_high_s": noise_high_s,
        "solver_s": statistics.median(calls),
        "solver_low_s": min(calls),
        "solver_high_s": max(calls),
        "repeats": len(walls),
    }


def _bare(trial: Trial, status: str, reason: str | None, *, whole: bool = False) -> AccuracyRow:
    """A row without figures; of a whole line where none of its settings was tried."""
    return AccuracyRow(
        solver=trial.solver,
        line=trial.line,
        setting="all" if whole else trial.setting,
        key=trial.key,
        value=None if whole else trial.value,
        status=status,
        reason=reason,
        note=trial.note or None,
        library=trial.library or None,
    )


def _judged(trace: AccuracyTrace, known: AccuracyTrace, reference: Reference) -> dict[str, Any]:
    """Errors of a whole trace."""
    off = displacement_m(trace.state, known.state, known.footprints_m)
    events = compare_events(trace.events, known.events, reference.duration_s)
    found: dict[str, Any] = {
        "error_max": float(off.max()),
        "error_end": float(off[-1]),
        "event_time_error": events.time_error_s,
        "events_found": events.found,
        "events_missed": events.missed,
        "events_invented": events.invented,
        "order_until": events.order_until_s,
    }
    until = reference.chatter_s if events.order_until_s is None else events.order_until_s
    if until is not None:
        count = max(trace.samples_until(until), 1)
        found["error_before"] = float(off[:count].max())
        if len(off) - count >= FEWEST:
            found["speed_distance"] = distribution_distance(
                corner_speeds(trace.state[count:], known.footprints_m),
                corner_speeds(known.state[count:], known.footprints_m),
            )
    return found


def _before(trace: AccuracyTrace, known: AccuracyTrace, reference: Reference) -> dict[str, Any]:
    """Error before chatter of a trace that got that far, and no farther than into it."""
    if reference.chatter_s is None or trace.time_s[-1] < reference.chatter_s:
        return {}
    count = trace.samples_until(reference.chatter_s)
    off = displacement_m(trace.state[:count], known.state[:count], known.footprints_m)
    return {"error_before": float(off.max(initial=0.0))}
