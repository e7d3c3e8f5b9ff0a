"""Contact events of the plant's event log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant.effects.parcel_contact.bodies import Group
from plant.kernels.contact import layout as to
from plant.observations import Event

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class ContactEvent(NamedTuple):
    """A contact that began or ended, or what contact problems left.

    Attributes:
        after_s: seconds after the start of the call.
        kind: ``contact``, ``apart``, ``contact_residual`` or ``parted``.
        bodies: the two, by their numbers in the scene: parcels, then rails. The same twice where more are concerned.
        place_m: where; the middle of two points.
        detail: direction from the first to the second, and how fast they closed.
    """

    after_s: float
    kind: str
    bodies: tuple[int, int]
    place_m: tuple[float, float]
    detail: str


def contact_event(
    group: Group, after_s: float, kind: str, rows: Floats, ends: Integers, velocity: Floats
) -> ContactEvent:
    """A contact of one pair.

    Args:
        group: its bodies.
        after_s: seconds after the start of the call.
        kind: ``contact`` or ``apart``.
        rows: ``(n, ROW_SIZE)`` where it touches.
        ends: ``(n, 3)``.
        velocity: ``(b, 3)``.
    """
    first, second = group.names[ends[0, : to.PAIR]].tolist()
    x, y = rows[:, [to.PX, to.PY]].mean(axis=0).tolist()
    if kind == "apart":
        return ContactEvent(after_s, kind, (first, second), (x, y), "")
    u, v = velocity[ends[0, 0]], velocity[ends[0, 1]]
    ax, ay, bx, by = rows[:, to.AX : to.BY + 1].T
    nx, ny = rows[:, to.NORMAL_X], rows[:, to.NORMAL_Y]
    closing = nx * (u[0] - v[0] - u[2] * ay + v[2] * by) + ny * (u[1] - v[1] + u[2] * ax - v[2] * bx)
    nearest = int(np.argmin(rows[:, to.SPACE]))
    detail = f", normal [{nx[nearest]:.6g}, {ny[nearest]:.6g}], closing at {closing.max():.4g} m/s"
    return ContactEvent(after_s, kind, (first, second), (x, y), detail)


def events(contacts: Sequence[ContactEvent], parcels: int, start_s: float) -> list[Event]:
    """The plant's events, ordered by time.

    Args:
        contacts: what began or ended.
        parcels: how many there are; rails are numbered after them.
        start_s: when the call began.
    """
    listed: list[Event] = []
    for one in sorted(contacts, key=lambda one: (one.after_s, one.bodies)):
        first, second = one.bodies
        other = f"with parcel {second}" if second < parcels else f"with rail {second - parcels}"
        if first == second:
            other = ""
        listed.append(Event(start_s + one.after_s, one.kind, first, (), one.place_m, other + one.detail))
    return listed
