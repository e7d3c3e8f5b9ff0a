"""Trace of one run under one solver: states, events, time, effort, and status."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from deploy.runs.field_simulation import field_speeds, iterate_field_motion
from deploy.runs.result import status_of
from plant.errors import PlantError

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from plant.observations import Event

Floats = NDArray[np.float64]

SAMPLES = 250
"""Samples a call of the plant: between two calls the time that a run may take is checked."""


class _OutOfTimeError(Exception):
    """A run takes longer than it may."""


@final
@dataclass(frozen=True, slots=True)
class RunTime:
    """Time of a run, without building the plant.

    Attributes:
        wall_s: Wall time of the whole simulation, with its samples, events and bookkeeping, s.
        solver_s: Processor time within calls of the solver, s. Other programs hardly change it.
    """

    wall_s: float
    solver_s: float


@final
@dataclass(frozen=True, slots=True)
class AccuracyTrace:
    """Trace of one run of a scene.

    Attributes:
        time_s: ``(T,)`` instants, a control period apart, as far as it came.
        state: ``(T, m, 6)``.
        events: of the plant.
        footprints_m: ``(v, 2)`` corners of each parcel about its centre of mass, in its axes.
        time: what the plant took, without being built.
        effort: of the solver: steps, or right-hand sides.
        status: ``ok``, ``unstable``, ``failed`` or ``stopped``: it took longer than it may.
        reason: why it is not ``ok``.
    """

    time_s: Floats
    state: Floats
    events: Sequence[Event]
    footprints_m: Sequence[Floats]
    time: RunTime
    effort: int
    status: str
    reason: str | None

    def samples_until(self, until_s: float) -> int:
        """How many of the instants come before a time, or at it."""
        return int(np.searchsorted(self.time_s, until_s + 1e-12, side="right"))


def run_trace(scene: Scene, limit_s: float = np.inf, poll: Callable[[], None] | None = None) -> AccuracyTrace:
    """Simulate a scene as ``mdms simulate`` does, from a plant built for it.

    Args:
        scene: With ideal wheels, and the solver to use.
        limit_s: Processor time after which it is given up.
        poll: Called now and then; may raise.

    Raises:
        PlantError: The plant refuses the scene, or a package is not installed.
    """
    from plant.plant import Plant

    plant = Plant(scene.plant_spec(), clock=time.process_time)
    speeds = field_speeds(scene, plant.array.positions_m)
    times: list[Floats] = [np.zeros(1)]
    states: list[Floats] = [plant.state[None]]
    events: list[Event] = []
    begun, worked = time.perf_counter(), time.process_time()

    def check() -> None:
        if poll is not None:
            poll()
        if time.process_time() - worked > limit_s:
            raise _OutOfTimeError

    status, reason = "ok", None
    try:
        for part in iterate_field_motion(scene, plant, speeds, check=check, samples=SAMPLES):
            times.append(part.time_ns[1:].astype(np.float64) * 1e-9)
            states.append(part.state[1:])
            events += part.events
    except _OutOfTimeError:
        status, reason = (
            "stopped",
            f"took longer than {limit_s:.3g} s, at {times[-1][-1]:.6g} s of simulated time",
        )
    except PlantError as error:
        status, reason = status_of(error), str(error)
    wall_s = time.perf_counter() - begun
    return AccuracyTrace(
        np.concatenate(times),
        np.concatenate(states),
        events,
        plant.footprints_m,
        RunTime(wall_s, plant.solver_s),
        plant.effort,
        status,
        reason,
    )


def time_run(scene: Scene, poll: Callable[[], None] | None = None) -> RunTime:
    """Time another run: the same calls of the plant, without storing results."""
    from plant.plant import Plant

    plant = Plant(scene.plant_spec(), clock=time.process_time)
    speeds = field_speeds(scene, plant.array.positions_m)
    begun = time.perf_counter()
    for _ in iterate_field_motion(scene, plant, speeds, check=poll or (lambda: None), samples=SAMPLES):
        pass
    return RunTime(time.perf_counter() - begun, plant.solver_s)
