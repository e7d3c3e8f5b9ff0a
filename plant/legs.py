"""Where a call is divided: where wheels change their motion, or cells read, that a parcel may be near to."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from plant.array import CellArray
from plant.solvers.solver import Body
from plant.wheels import Floats, WheelRun


def reach_m(body: Body, fastest_m_s: float, span_s: float) -> float:
    """How far from where its centre is now a parcel's corners can be within a span.

    Traction only draws a parcel towards the wheels' speed. Its centre gains no more speed than its corners and the
    fastest wheels have together; twice that leaves room for what turns it on the way.
    """
    vx, vy, turn = body.state[3:].tolist()
    speed = (vx * vx + vy * vy) ** 0.5 + body.radius_m * abs(turn)
    return body.radius_m + 2.0 * (speed + fastest_m_s) * span_s


def cells_near(
    array: CellArray, bodies: Iterable[Body], fastest_m_s: float, span_s: float
) -> NDArray[np.bool_]:
    """``(n,)`` which cells, or their sensors, may come under one of the parcels within a span.

    Args:
        array: the cells.
        bodies: the parcels.
        fastest_m_s: of the wheels.
        span_s: how long.
    """
    beside = array.pitch_m + float(np.hypot(*array.sensors_m.T).max())
    near: NDArray[np.bool_] = np.zeros(len(array), dtype=np.bool_)
    for body in bodies:
        near[array.within(body.state[:2], reach_m(body, fastest_m_s, span_s) + beside)] = True
    return near


def ends_s(run: WheelRun, reads_s: Floats, near: NDArray[np.bool_], span_s: float) -> list[float]:
    """When the legs of a call end, s after its start, ascending; the last at ``span_s``.

    Args:
        run: of all wheels.
        reads_s: ``(n,)`` when cells read; infinite: not before the end.
        near: ``(n,)`` the cells that matter.
        span_s: of the call.
    """
    change = run.changes
    changed = np.zeros(0) if change is None else change.after_s[:, near].ravel()
    found = np.unique(np.concatenate([changed, reads_s[near]]))
    return [*found[(found > 0.0) & (found < span_s)].tolist(), span_s]
