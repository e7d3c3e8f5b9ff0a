"""Continuous collision detection: no contact is stepped over, however short.

An interval between two instants is free of contact for a pair if a line separates its bodies throughout
(``plant.kernels.contact.polygons``). Any other interval is divided until it is free of contact or its end is a contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from plant.effects.parcel_contact.bodies import Group, make_workspace
from plant.effects.parcel_contact.events import ContactEvent, contact_event
from plant.effects.parcel_contact.free_motion import FreeMotion
from plant.kernels.contact import layout as to
from plant.kernels.contact.layout import TOUCH_M

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LOCATED_S: Final = 1e-9
"""An instant is located to this, where the gap isn't below `TOUCH_M` before."""
BEFORE_S: Final = 1e-12
"""Length of an interval before an overlap whose start is taken as the contact: nothing overlaps there yet."""
SHORTEST_S: Final = 1e-13
"""No interval is divided that is as short as this."""
PARTS: Final = 8
"""Into how many an interval is divided."""


class Turn(NamedTuple):
    """Instant at which a pair begins to touch, or parts.

    Attributes:
        known: index of the instant among the known instants.
        pair: index of the pair in the group.
    """

    known: int
    pair: int


@final
class ContactSearch:
    """Search for contacts of a group along its free motion.

    Args:
        free_motion: free motion of the group.
        group: bodies of the group.
        wheels: speed of the fastest wheel, m/s.
        times: known instants, ``(T,)``, s, the first being 0.
        states: states at the known instants, ``(T, b, 6)``.

    Attributes:
        times: instants known so far.
        states: states at ``times``.
    """

    def __init__(
        self, free_motion: FreeMotion, group: Group, wheels: float, times: Floats, states: Floats
    ) -> None:
        from plant.kernels.contact import entry as contact_entry

        self._entry: Any = contact_entry
        self._free_motion, self._group, self._wheels = free_motion, group, wheels
        self.times, self.states = times, states

    def gap(self, index: int, pair: int) -> float:
        """Free space of a pair at a known instant, m; negative where they overlap."""
        i, j = self._group.pairs[pair].tolist()
        states = self.states[index]
        return float(self._entry.gap(self._group.shapes, i, j, states[i], states[j])[0])

    def contact(self, pairs: Integers, start: int = 0) -> Turn | None:
        """The first contact of some pairs, apart at the instant ``start``; None where there is none.

        Instants before it are forgotten.
        """
        group = self._group
        while len(pairs):
            start, which = self._entry.first_uncertain(
                group.shapes, group.pairs[pairs], group.pull, self._wheels, self.times, self.states, start
            )
            if which < 0:
                return None
            # earlier instants are of no use any more, and would be copied at each division
            self.times, self.states, start = self.times[start:], self.states[start:], 0
            pair, span = int(pairs[which]), self.times[1] - self.times[0]
            space = self.gap(1, pair)
            if 0.0 < space <= TOUCH_M and span <= LOCATED_S:
                return Turn(1, pair)
            if (
                space <= 0.0
                and span <= BEFORE_S
                and self.times[0] > 0.0
                and 0.0 < self.gap(0, pair) <= TOUCH_M
            ):
                return Turn(0, pair)
            if space <= TOUCH_M and span <= SHORTEST_S:
                return Turn(1, pair)
            if span <= SHORTEST_S:
                start += 1  # nothing that lasts
            else:
                self._divide(start)
        return None

    def parting(self, pair: int, start: int) -> Turn | None:
        """Find when a pair that touches at the instant ``start`` parts; only known instants are examined."""
        index = start + 1
        while index < len(self.times):
            if self.gap(index, pair) <= 2.0 * TOUCH_M:
                index += 1
            elif self.times[index] - self.times[index - 1] > LOCATED_S:
                index -= 1
                self._divide(index)
                index += 1
            else:
                return Turn(index, pair)
        return None

    def _divide(self, index: int) -> None:
        """Divide the interval that begins at a known instant."""
        a, b = self.times[index], self.times[index + 1]
        inner = a + (b - a) * np.arange(1, PARTS) / PARTS
        self.times = np.insert(self.times, index + 1, inner)
        self.states = np.insert(self.states, index + 1, self._free_motion.sample(inner), axis=0)


def detect_contacts(
    free_motion: FreeMotion, group: Group, wheels: float, known: tuple[Floats, Floats], met: bool
) -> tuple[Sequence[ContactEvent], bool]:
    """Detect the contacts of one pair in its free motion.

    Args:
        free_motion: free motion of the group.
        group: group that holds the pair alone.
        wheels: speed of the fastest wheel, m/s.
        known: instants ``(T,)`` and states ``(T, b, 6)``.
        met: whether the pair touches at the start, as last reported.

    Returns:
        Contact events by ascending time, and whether the pair touches at the end.
    """
    from plant.kernels.contact import entry as contact_entry

    kernels: Any = contact_entry

    search = ContactSearch(free_motion, group, wheels, *known)
    reported: list[ContactEvent] = []
    work, only = make_workspace(group), np.zeros(1, dtype=np.int64)
    index = 0
    while True:
        if not met and search.gap(index, 0) <= to.TOUCH_M:
            found = index
        else:
            contact = search.parting(0, index) if met else search.contact(only, index)
            if contact is None:
                return reported, met
            found = contact.known
        index, met = found, not met
        states, kind = search.states[index], "contact" if met else "apart"
        count = kernels.build_rows(group, work.marks, to.EVERY, states, to.BEYOND, work.rows, work.ends)
        rows, ends = work.rows[:count], work.ends[:count]
        reported.append(contact_event(group, float(search.times[index]), kind, rows, ends, states[:, 3:]))
