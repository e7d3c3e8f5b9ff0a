"""Warnings about allowed but improbable values of a scene."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from cell_firmware.errors import dotted

if TYPE_CHECKING:
    from deploy.scenes.errors import KeyPath
    from deploy.scenes.scene import Scene
    from plant.parcel_spec import PolygonSpec

_MARGIN_USED: Final = 0.5
"""Share of the delay margin from which dead time is worth a warning."""
_LONG_PERIOD_S: Final = 1.0
"""Control period from which it is taken for one in other units."""


def scene_warnings(scene: Scene) -> Iterator[str]:
    """Yield a line for each value that looks like a mistake: its key, the value and why."""
    yield from _degrees(scene)
    yield from _large_parcels(scene)
    yield from _late_faults(scene)
    yield from _dead_time(scene)
    period_s = scene.cells.period_s
    if period_s >= _LONG_PERIOD_S:
        yield f"cells.period_s = {period_s:g}: a control period of seconds; an HC11's real-time interrupt is 0.004096 s"
    if scene.ticks <= 1:
        yield (
            f"duration_s = {scene.duration_s:g}: the run is over after one tick, which takes {scene.tick_ns * 1e-9:g} s"
        )


def _dead_time(scene: Scene) -> Iterator[str]:
    """Drives that act so late that the speed loops oscillate."""
    ticks, loop, motors = scene.bus.sense_to_drive_ticks, scene.speed_loop, scene.effects.motors
    if not ticks or loop is None or motors is None:
        return
    from cell_firmware.delay_margin import delay_margin_s

    motor = motors.first_order
    margin_s = delay_margin_s(loop, motor.speed_per_volt_m_s, motor.time_constant_s)
    # The drive is held for a tick, which delays it by half a tick on average.
    dead_s = (ticks + 0.5) * scene.tick_ns * 1e-9
    if dead_s > _MARGIN_USED * margin_s:
        told = (
            "the loops are unstable" if dead_s >= margin_s else "the wheels' speeds overshoot and oscillate"
        )
        yield (
            f"bus.sense_to_drive_ticks = {ticks}: {dead_s * 1e3:.0f} ms of dead time in every speed loop, whose delay "
            f"margin is {margin_s * 1e3:.0f} ms: {told}; lower cells.speed_loop's gains"
        )


def _degrees(scene: Scene) -> Iterator[str]:
    """Angles of more than a turn."""
    parts = {
        "parcels": [parcel.model_dump() for parcel in scene.parcels],
        "effects": scene.effects.model_dump(),
        "cells.parameters": scene.cells.parameters,
    }
    for path, value in _leaves(parts):
        key = dotted(path)
        if key.endswith("_rad") and isinstance(value, int | float) and abs(value) > math.tau:
            yield (
                f"{key} = {value:g}: more than a turn, and angles are in radians: {value:g} degrees are "
                f"{math.radians(value):.4g}"
            )


def _leaves(value: object, path: KeyPath = ()) -> Iterator[tuple[KeyPath, object]]:
    """Yield the path and value of everything in nested tables and lists."""
    if isinstance(value, Mapping):
        inside: list[tuple[str | int, object]] = [*cast("Mapping[str, object]", value).items()]
    elif isinstance(value, list | tuple):
        inside = [*enumerate(cast("Sequence[object]", value))]
    else:
        yield path, value
        return
    for key, item in inside:
        yield from _leaves(item, (*path, key))


def _large_parcels(scene: Scene) -> Iterator[str]:
    """Parcels that lie on the array in no direction along its rows or columns."""
    lattice = scene.lattice()
    array = [scene.array.pitch_m * (int(np.ptp(index)) + 1) for index in (lattice.columns, lattice.rows)]
    feeders = scene.effects.feeders
    named: list[tuple[str, PolygonSpec]] = [
        (f"parcels[{number}]", parcel) for number, parcel in enumerate(scene.parcels)
    ]
    named += [
        (f"effects.feeders.feed[{number}]", feed)
        for number, feed in enumerate(() if feeders is None else feeders.feed)
    ]
    for key, spec in named:
        size = _extent(spec)
        if any(one > other for one, other in zip(sorted(size), sorted(array), strict=True)):
            footprint, cells = (" × ".join(f"{side:.4g}" for side in sides) for sides in (size, array))
            yield f"{key}: {footprint} m, larger than the array, which is {cells} m"


def _extent(spec: PolygonSpec) -> Sequence[float]:
    if spec.size_m is not None:
        return spec.size_m
    corners: Any = np.asarray(spec.vertices_m)
    return [float(side) for side in np.ptp(corners, axis=0)]


def _late_faults(scene: Scene) -> Iterator[str]:
    """Faults that begin when the run is over."""
    late = [
        (number, fault.at_s)
        for number, fault in enumerate(scene.faults)
        if scene.tick_at(fault.at_s) >= scene.ticks
    ]
    if late:
        listed = ", ".join(f"faults[{number}].at_s = {at_s:g}" for number, at_s in late)
        yield f"{listed}: after the end of the run (duration_s = {scene.duration_s:g}): never active"
