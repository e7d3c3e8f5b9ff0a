"""Timed runs of a bundled scene's first parcel, and differences between two runs."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from deploy.runs.field_simulation import field_speeds
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.studies.accuracy.errors import displacement_m
from plant.errors import PlantUnstable
from plant.plant import Plant
from plant.specs import PlantSpec

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from plant.observations import Event
    from plant.wheels import Floats

SECOND = 1_000_000_000


@final
@dataclass(frozen=True, slots=True)
class ExperimentTrace:
    """Trace of a scene's first parcel.

    Attributes:
        time_s: ``(T,)``.
        state: ``(T, 6)`` x, y, angle, and their rates.
        footprint_m: ``(v, 2)`` corners about the centre of mass.
        events: all of them.
        changes: of supports.
        spent_s: median processor time, without building the plant and without compiling.
    """

    time_s: Floats
    state: Floats
    footprint_m: Floats
    events: Sequence[Event]
    changes: int
    spent_s: float


def scene_with(name: str, *sets: str) -> Scene:
    """A bundled scene with ``KEY=VALUE`` set in it, as ``--set`` does."""
    return load_scene(name, [Override.parse(text) for text in sets])


def run(
    scene: Scene, solver: Mapping[str, Any], *, sample_s: float | None = None, repeats: int = 1
) -> ExperimentTrace:
    """Simulate a scene from start to end.

    Args:
        scene: scene with firmware ``velocity_field``; the first parcel is observed.
        solver: settings that replace the scene's.
        sample_s: interval between samples, s; default: a control period.
        repeats: number of timed runs; the run that compiles kernels is additional.
    """
    spec = PlantSpec.model_validate(dict(scene.plant_spec()) | {"solver": dict(solver)})
    sample_ns = scene.cells.period_ns if sample_s is None else round(sample_s * SECOND)
    _once(scene, spec, min(20_000_000, scene.duration_ns), sample_ns)
    found, spent = None, list[float]()
    for _ in range(repeats):
        found, seconds = _once(scene, spec, scene.duration_ns, sample_ns)
        spent.append(seconds)
    assert found is not None
    plant, trace = found
    return ExperimentTrace(
        trace.time_ns * 1e-9,
        trace.state[:, 0],
        plant.footprints_m[0],
        trace.events,
        plant.support_changes,
        statistics.median(spent),
    )


def changes_at(scene: Scene, solver: Mapping[str, Any], times_s: Floats) -> NDArray[np.int64]:
    """How often supports have changed by each of the times ``(T,)``, in a run that stops at each.

    Returns:
        ``(k,)`` counts; k < T where the motion changes supports without end (``PlantUnstable``) before the last.
    """
    plant = Plant(PlantSpec.model_validate(dict(scene.plant_spec()) | {"solver": dict(solver)}))
    speeds = field_speeds(scene, plant.array.positions_m)
    counts: list[int] = []
    for until_ns in np.round(times_s * SECOND).astype(np.int64).tolist():
        try:
            plant.advance(speeds, until_ns)
        except PlantUnstable:
            break
        counts.append(plant.support_changes)
    return np.array(counts)


def _once(scene: Scene, spec: PlantSpec, until_ns: int, sample_ns: int) -> Any:
    """(plant and its trace, processor time); no garbage is collected meanwhile."""
    plant = Plant(spec)
    speeds = field_speeds(scene, plant.array.positions_m)
    gc.collect()
    gc.disable()
    begun = time.process_time()
    try:
        trace = plant.trajectory(speeds, until_ns, sample_ns)
    finally:
        spent = time.process_time() - begun
        gc.enable()
    return (plant, trace), spent


def max_displacement_m(one: ExperimentTrace, other: ExperimentTrace) -> Floats:
    """``(T,)`` the largest displacement of any corner between two runs that were looked at at the same times."""
    return displacement_m(one.state[:, None], other.state[:, None], [one.footprint_m])
