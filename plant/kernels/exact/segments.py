"""Segmented advance of one parcel through a call: one segment between successive wheel changes or sensor readings.

Only changes and readings within the parcel's reach end a segment. The present state of the wheels is kept in the
thread's workspace, because parcels in other threads reach the same change at other times.
"""

from __future__ import annotations

from math import cos, exp, inf, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.footprint import EDGE_SLACK, box, inside
from plant.kernels.common.surface import Surface

Floats = NDArray[np.float64]


class CallSchedule(NamedTuple):
    """Wheel changes and sensor readings scheduled within one call.

    Attributes:
        after: times of wheel changes, ``(c, n, 2)``, s; see ``plant.wheels.WheelChanges``.
        steady: ``(c, n, 2)``.
        decay: ``(c, n, 2)``.
        reads: times after the start at which cells read sensors, ``(n,)``, s; infinite: not within the call.
        margin: distance from each parcel's initial footprint within which a cell can be affected, ``(m,)``, m.
        sensors: sensor positions from a cell's centre, ``(s, 2)``, m.
        bits: set where a sensor is under a parcel when its cell reads, ``(n, s)``.
    """

    after: Floats
    steady: Floats
    decay: Floats
    reads: Floats
    margin: Floats
    sensors: Floats
    bits: NDArray[np.bool_]


class SegmentWorkspace(NamedTuple):
    """Workspace of one thread.

    Attributes:
        steady: ``(n, 2)``, of the wheels at the time of the current parcel; between parcels as at the start of the
            call.
        decay: ``(n, 2)``, as ``steady``.
        when: times of wheel changes within the parcel's reach, ascending, ``(2 c n,)``, s.
        which: flat indices of these changes in ``CallSchedule.after``.
        times: reading times of cells within the parcel's reach, ascending, ``(n,)``, s.
        cells: cells that read at ``times``, ``(n,)``.
        poses: states of the parcel at ``times``, ``(n, 1, 6)``.
    """

    steady: Floats
    decay: Floats
    when: Floats
    which: NDArray[np.int64]
    times: Floats
    cells: NDArray[np.int64]
    poses: Floats


@kernel
def sort(when, which, count):
    """Put pairs in the order of the first of them, and of the second where these are the same (Shell's sort)."""
    gap = count // 2
    while gap > 0:
        for i in range(gap, count):
            t, w, j = when[i], which[i], i
            while j >= gap and (when[j - gap] > t or (when[j - gap] == t and which[j - gap] > w)):
                when[j], which[j] = when[j - gap], which[j - gap]
                j -= gap
            when[j], which[j] = t, w
        gap //= 2


@kernel
def collect_changes(surface, schedule, hand, near):
    """Collect what happens in the rows and columns ``near``. Returns (how many changes, how many reads)."""
    changes, reads = at.ZERO, at.ZERO
    first_row, last_row, first_column, last_column = near
    cells = surface.steady.shape[0]
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            cell = surface.grid[row, column]
            if cell < 0:
                continue
            for k in range(schedule.after.shape[0]):
                for axis in range(2):
                    if schedule.after[k, cell, axis] < inf:
                        hand.when[changes] = schedule.after[k, cell, axis]
                        hand.which[changes] = 2 * (k * cells + cell) + axis
                        changes += 1
            if schedule.reads[cell] < inf:
                hand.times[reads], hand.cells[reads] = schedule.reads[cell], cell
                reads += 1
    sort(hand.when, hand.which, changes)
    sort(hand.times, hand.cells, reads)
    return changes, reads


@kernel
def change(schedule, hand, now, done, changes):
    """Apply the wheel changes due up to ``now``. Returns the number of changes applied so far."""
    cells = hand.steady.shape[0]
    while done < changes and hand.when[done] <= now:
        wheel = hand.which[done]
        k, cell, axis = wheel // (2 * cells), wheel // 2 % cells, wheel % 2
        hand.steady[cell, axis] = schedule.steady[k, cell, axis]
        hand.decay[cell, axis] = schedule.decay[k, cell, axis]
        done += 1
    return done


@kernel
def until(hand, now, end, seen, reads):
    """Count the reads up to ``end``, and have their times count from ``now``. Returns how many there are by then."""
    while seen < reads and hand.times[seen] <= end:
        hand.times[seen] -= now
        seen += 1
    return seen


@kernel
def decay_wheels(surface, hand, near, rate, span):
    """Let the wheels near turn for ``span`` seconds, as their motors have it."""
    if rate == 0.0:
        return
    left = exp(-rate * span)
    first_row, last_row, first_column, last_column = near
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            cell = surface.grid[row, column]
            if cell >= 0:
                hand.decay[cell, 0] *= left
                hand.decay[cell, 1] *= left


@kernel
def restore_wheels(surface, hand, near):
    """Have the wheels near as they were at the start."""
    first_row, last_row, first_column, last_column = near
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            cell = surface.grid[row, column]
            if cell >= 0:
                for axis in range(2):
                    hand.steady[cell, axis] = surface.steady[cell, axis]
                    hand.decay[cell, axis] = surface.decay[cell, axis]


@kernel
def local_surface(surface, hand):
    """Build the surface with the wheels' state for the parcel being moved."""
    return Surface(
        surface.pos,
        surface.grid,
        hand.steady,
        hand.decay,
        surface.grip,
        surface.springs,
        surface.edges,
        surface.rollers,
        surface.drag,
        surface.stiction,
        surface.factors,
        surface.transfer,
    )


@kernel
def shift_log(log, ctl, logged, now):
    """Have the events of a leg begun at ``now`` count from the call's start.

    Returns how many there have been by now, those that the log had no room for among them.
    """
    found = logged + ctl[at.N_LOGGED]
    for row in range(logged, min(found, log.shape[0])):
        log[row, at.EV_TIME] += now
    return found


@kernel
def sample_sensors(surface, schedule, hand, parcel, reads, seen):
    """Set the bits of the sensors that the parcel covers when their cells read; it stood from the ``seen`` first on."""
    slack = EDGE_SLACK * parcel.par[at.ON_SURFACE]
    for n in range(reads):
        y = hand.poses[n, 0] if n < seen else parcel.y
        c, s = cos(y[at.THETA]), sin(y[at.THETA])
        cell = hand.cells[n]
        for k in range(schedule.sensors.shape[0]):
            px, py = (
                surface.pos[cell, 0] + schedule.sensors[k, 0],
                surface.pos[cell, 1] + schedule.sensors[k, 1],
            )
            if inside(px, py, parcel.normal, parcel.offset, y, c, s, slack):
                schedule.bits[cell, k] = True


@kernel
def within(surface, schedule, parcel, i):
    """Rows and columns of the cells that the parcel can matter to on the way."""
    return box(parcel.vertices, parcel.y, parcel.par, surface.grid, schedule.margin[i])
