"""Contacts that are found and told, the motion being what it is without them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.contact.course import Course
from plant.contact.group import Group, make_work
from plant.contact.report import Told, telling
from plant.contact.search import Search
from plant.kernels import contact_layout as to

Floats = NDArray[np.float64]


def follow(
    course: Course, group: Group, wheels: float, known: tuple[Floats, Floats], met: bool
) -> tuple[Sequence[Told], bool]:
    """Contacts of one pair along its free course.

    Args:
        course: of the group.
        group: the pair, alone.
        wheels: m/s, the fastest wheel.
        known: instants ``(T,)`` and states ``(T, b, 6)``.
        met: whether it touches at the start, as told before.

    Returns:
        What is told, in the order of time, and whether the pair touches at the end.
    """
    from plant.kernels import contact_entry

    kernels: Any = contact_entry

    search = Search(course, group, wheels, *known)
    told: list[Told] = []
    work, only = make_work(group), np.zeros(1, dtype=np.int64)
    index = 0
    while True:
        if not met and search.gap(index, 0) <= to.TOUCH_M:
            found = index
        else:
            contact = search.parting(0, index) if met else search.contact(only, index)
            if contact is None:
                return told, met
            found = contact.known
        index, met = found, not met
        states, kind = search.states[index], "contact" if met else "apart"
        count = kernels.gather(group, work.marks, to.EVERY, states, to.BEYOND, work.rows, work.ends)
        rows, ends = work.rows[:count], work.ends[:count]
        told.append(telling(group, float(search.times[index]), kind, rows, ends, states[:, 3:]))
