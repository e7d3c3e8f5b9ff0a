"""Sampling cost: the whole system, including cells and messages, as the control period shrinks."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from deploy.errors import DeployError
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.scene import Scene
from deploy.studies.accuracy.errors import displacement_m
from deploy.studies.accuracy.report import Sampled, Sampling
from deploy.util.signals import Interrupted
from deploy.workers.plan import RunOptions
from plant.effects.motors import MotorsSpec

if TYPE_CHECKING:
    from deploy.studies.accuracy.trace import AccuracyTrace

Floats = NDArray[np.float64]

COARSEST = 8
"""The longest period is so many of the scene's own."""
HALVINGS = 5
"""Of the longest; a quick study makes ..."""
FEW_HALVINGS = 3
"""... so many."""


def sampling_cost(
    scene: Scene, reference: AccuracyTrace, *, quick: bool, limit_s: float, poll: Callable[[], None]
) -> list[Sampling]:
    """Run the whole system in this process, over the memory transport, at periods that halve.

    Ideal wheels run at the field's speed, and nothing that a cell senses changes it: sampling costs time, and errors,
    measured from the reference, are rounding. With motors the speed loop closes once a period: errors are measured from
    the run at the shortest. A scene without motors is also run with them at their defaults, if it may have them and
    the study isn't quick. Cells step at once, whatever clocks the scene gives them: else periods would not end
    together, and there would be no instants to compare.

    Args:
        scene: as the cells have it, motors included.
        reference: the field without cells.
        quick: whether to spare the short periods.
        limit_s: no shorter period is tried after a run longer than this.
        poll: called before every run; may raise.

    Raises:
        Interrupted: a signal came during a run.
    """
    if scene.effects.clock is not None:
        together = scene.effects.model_copy(update={"clock": None})
        scene = scene.model_copy(update={"effects": together})
    with_motors = scene.effects.motors is not None
    wheels = "motors" if with_motors else "ideal wheels"
    found = [_series(scene, wheels, reference, quick=quick, limit_s=limit_s, poll=poll)]
    if not with_motors and not quick:
        effects = scene.effects.model_copy(update={"motors": MotorsSpec()})
        try:
            driven = Scene.model_validate(dict(scene) | {"effects": effects}).named(scene.name)
        except ValidationError:  # its law, an effect or its solver doesn't go with them
            return found
        found.append(
            _series(driven, "motors at their defaults", reference, quick=quick, limit_s=limit_s, poll=poll)
        )
    return found


def _series(
    scene: Scene,
    wheels: str,
    reference: AccuracyTrace,
    *,
    quick: bool,
    limit_s: float,
    poll: Callable[[], None],
) -> Sampling:
    """All periods, the longest first."""
    periods = [COARSEST * scene.cells.period_ns]
    for _ in range(FEW_HALVINGS if quick else HALVINGS):
        if periods[-1] % 2 == 0:
            periods.append(periods[-1] // 2)
    found: list[tuple[Sampled, Floats | None]] = []
    for period_ns in periods:
        poll()
        slow = next((row for row, _ in found if (row.wall_s or 0.0) > limit_s), None)
        if slow is not None:
            why = f"the run at {slow.period_s:g} s took {slow.wall_s:.3g} s"
            found.append((Sampled(period_ns * 1e-9, None, None, "omitted", why), None))
            continue
        found.append(_whole(scene, period_ns, periods[0]))
    known, against = _common(reference, periods[0]), "the reference"
    if scene.effects.motors is not None:
        ended = [k for k, (_, states) in enumerate(found) if states is not None]
        if len(ended) < 2:
            return Sampling(wheels, "nothing: too few runs came to their end", [row for row, _ in found])
        row, finest = found[ended[-1]]
        assert finest is not None
        known, against = finest, f"the run at {row.period_s * 1e3:g} ms"
        found[ended[-1]] = row, None  # nothing judges it
    return Sampling(wheels, against, [_judged(row, states, known, reference) for row, states in found])


def _judged(row: Sampled, states: Floats | None, known: Floats, reference: AccuracyTrace) -> Sampled:
    if states is None:
        return row
    count = min(len(states), len(known))
    off = displacement_m(states[:count], known[:count], reference.footprints_m)
    return replace(row, error_max=float(off.max()))


def _common(trace: AccuracyTrace, every_ns: int) -> Floats:
    """States at the instants that are whole multiples of the longest period."""
    time_ns = np.rint(trace.time_s * 1e9).astype(np.int64)
    return trace.state[time_ns % every_ns == 0]


def _whole(scene: Scene, period_ns: int, every_ns: int) -> tuple[Sampled, Floats | None]:
    """One run of the whole system: its row, without an error yet, and its states at the common instants."""
    period_s = period_ns / 1e9
    changed = scene.model_copy(update={"cells": scene.cells.model_copy(update={"period_s": period_s})})
    with tempfile.TemporaryDirectory(prefix="mdms-accuracy-") as folder:
        options = RunOptions(processes=0, transport="memory", output=Path(folder) / "run", picture=False)
        try:
            summary = run(changed, options, quiet=True).summary
            track = load(Path(folder) / "run").run_trace()
        except DeployError as error:
            return Sampled(period_s, None, None, "failed", str(error)), None
    if summary.status == "interrupted":  # the run has taken the signal for itself
        raise Interrupted
    row = Sampled(period_s, None, summary.wall_s, summary.status, summary.reason)
    if summary.status != "ok":
        return row, None
    time_ns = np.rint(track.time_s * 1e9).astype(np.int64)
    return row, np.nan_to_num(track.parcels[time_ns % every_ns == 0])
