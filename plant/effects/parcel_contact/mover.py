"""Mover of touching parcels, on top of a solver: the effect ``parcel_contact``.

Only parcels that may come near another, or a rail, within a call are looked at: their circles, widened by how far they
can get, overlap. All others are the solver's alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant.effects.parcel_contact.bodies import Bodies, Group, fastest
from plant.effects.parcel_contact.detect import detect_contacts
from plant.effects.parcel_contact.events import ContactEvent, events
from plant.effects.parcel_contact.free_motion import STILL_THERE, FreeMotion
from plant.effects.parcel_contact.resolve import ContactDrive, Resolution
from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.errors import PlantError
from plant.friction.law import Traction
from plant.geometry import close_pairs
from plant.kernels.contact import layout as to
from plant.observations import Event
from plant.parcel_spec import ParcelSpec
from plant.solver_api import AdvanceResult, Rewindable, Segment

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Pair = tuple[int, int]

MARGIN_M: Final = 1e-6
"""Circles are widened by this much more than motion explains: what contacts correct."""
REST_M_S: Final = 1e-9
"""Touching parcels no corner of which is faster are at rest on wheels that are no faster."""


@final
class ContactMover:
    """Advances parcels with contacts, on top of a solver for free motion.

    Args:
        parcels: parcels of the scene, including fed parcels.
        traction: the traction law.
        gravity: m/s².
        drag: drag of the rollers, s/m.
        pitch: pitch of the array, m.
        rules: contact settings.
        solver: solver that moves the parcels.

    Attributes:
        resolves: whether contacts change the motion.
    """

    state_fields: ClassVar[StateFields] = StateFields("_met")

    def __init__(
        self,
        parcels: Sequence[ParcelSpec],
        traction: Traction,
        gravity: float,
        drag: float,
        pitch: float,
        rules: ParcelContactSpec,
        solver: Rewindable,
    ) -> None:
        self._rules, self._solver = rules, solver
        self._bodies = Bodies(
            parcels, solver.bodies, rules.rails, traction, gravity, drag, pitch, rules.slow_m_s(pitch)
        )
        self.resolves = rules.mode == "resolved"
        self._met: set[Pair] = set()
        self._events: list[Event] = []

    def check_start(self, live: Integers) -> None:
        """Refuse parcels that overlap a rail.

        Raises:
            PlantError: one does.
        """
        states = self._states()
        pairs = self._near(live, live, np.zeros(len(states)))
        if not len(pairs):
            return
        from plant.kernels.contact import entry as contact_entry

        kernels: Any = contact_entry
        group = self._bodies.group(pairs, self._mask(live), states)
        still = group.still
        for (i, j), (first, second) in zip(group.pairs.tolist(), pairs.tolist(), strict=True):
            depth = -float(kernels.gap(group.shapes, i, j, still[i], still[j])[0])
            if second >= self._bodies.parcels and depth > to.TOUCH_M:
                raise PlantError(
                    f"parcels[{first}] and effects.parcel_contact.rails[{second - self._bodies.parcels}] overlap at "
                    f"the start by {depth:.3g} m"
                )

    def events(self) -> list[Event]:
        """Contacts that began or ended since the last call."""
        drained, self._events = self._events, []
        return drained

    def advance(self, live: Integers, fixed: Integers, leg: Segment, start_s: float) -> list[AdvanceResult]:
        """Move parcels, as ``Solver.advance`` does.

        Args:
            live: ``(b,)`` parcels to move, ascending.
            fixed: those that stand in the way.
            leg: how far, and on which wheels; no states are requested on it where contacts are resolved.
            start_s: when it begins.
        """
        drive = ContactDrive(leg.motion, leg.grip, fastest(leg.motion), start_s)
        move = self._resolve if self.resolves else self._watch
        results, contacts = move(live, fixed, drive, leg)
        self._events += events(contacts, self._bodies.parcels, start_s)
        return results

    # --- both ---------------------------------------------------------------------------------------

    def _states(self) -> Floats:
        return self._bodies.states(self._solver.state)

    def _mask(self, live: Integers) -> NDArray[np.bool_]:
        mask = np.zeros(len(self._bodies.radius), dtype=np.bool_)
        mask[live] = True
        return mask

    def _strides(self, wheels: float, span_s: float) -> Floats:
        """``(b,)`` m, how far traction can take each body in a span."""
        states, pull = self._states(), self._bodies.pull
        speed = np.hypot(states[:, 3], states[:, 4])
        slip = speed + pull[:, to.RADIUS] * np.abs(states[:, 5]) + wheels
        growth = 1.0 - np.minimum(0.5 * (pull[:, to.PER_SLIP] + pull[:, to.UNLIMITED]) * span_s, 0.5)
        gained = np.minimum(pull[:, to.PER_SLIP] * slip / growth, pull[:, to.LIMIT])
        gained = (gained + pull[:, to.PUSH] + pull[:, to.UNLIMITED] * slip / growth) * span_s
        # traction only draws towards the wheels' speed
        return span_s * np.minimum(speed + 0.5 * gained, 2.0 * (speed + wheels)) + MARGIN_M

    def _near(self, live: Integers, present: Integers, strides: Floats) -> Integers:
        """Find the pairs ``(k, 2)`` of bodies, including a moving body, whose strides can make contact."""
        names = np.concatenate([present, np.arange(self._bodies.parcels, len(strides))])
        mask, states = self._mask(live), self._states()
        reach = self._bodies.radius[names] + strides[names] * mask[names]
        pairs = names[close_pairs(states[names, :2], reach)]
        pairs = pairs[mask[pairs].any(axis=1)]
        # the circle about a rail holds much that is far from it
        close = np.ones(len(pairs), dtype=np.bool_)
        for rail in np.unique(pairs[pairs[:, 1] >= self._bodies.parcels, 1]).tolist():
            mine = np.flatnonzero(pairs[:, 1] == rail)
            parcel = pairs[mine, 0]
            distance = self._bodies.rail_distance(rail, states[parcel, :2])
            close[mine] = distance < self._bodies.radius[parcel] + strides[parcel]
        return pairs[close]

    def _forget(self, present: Integers) -> list[ContactEvent]:
        """Contacts of parcels that are gone."""
        here = set(present.tolist())
        gone = [
            pair
            for pair in sorted(self._met)
            if not all(i in here or i >= self._bodies.parcels for i in pair)
        ]
        self._met.difference_update(gone)
        state = self._solver.state
        return [
            ContactEvent(0.0, "apart", pair, (float(state[pair[0], 0]), float(state[pair[0], 1])), "")
            for pair in gone
        ]

    # --- reported only --------------------------------------------------------------------------------

    def _watch(
        self, live: Integers, fixed: Integers, drive: ContactDrive, leg: Segment
    ) -> tuple[list[AdvanceResult], list[ContactEvent]]:
        span_s, times_s, out = leg.span_s, leg.times_s, leg.out
        present = np.union1d(live, fixed)
        contacts = self._forget(present)
        pairs = self._near(live, present, self._strides(drive.wheels, span_s))
        mask, states = self._mask(live), self._states()
        involved = np.intersect1d(live, pairs)
        start = self._solver.snapshot(involved)
        results = self._solver.advance(live, leg)
        if any(one.termination not in STILL_THERE for one in results):
            return results, contacts
        end = self._solver.snapshot(involved)
        if len(times_s):
            pairs = self._crossing(pairs, drive.wheels, times_s, out, states, mask)
        self._solver.restore(start)
        for pair in pairs.tolist():
            group = self._bodies.group(np.array([pair]), mask, states)
            free_motion = FreeMotion(self._solver, group, drive.motion, drive.grip)
            known = _known(free_motion, span_s, times_s)
            new, met = detect_contacts(free_motion, group, drive.wheels, known, tuple(pair) in self._met)
            free_motion.rewind()
            contacts += new
            (self._met.add if met else self._met.discard)((pair[0], pair[1]))
        self._solver.restore(end)
        return results, contacts

    def _crossing(
        self,
        pairs: Integers,
        wheels: float,
        times_s: Floats,
        out: Floats,
        states: Floats,
        mask: NDArray[np.bool_],
    ) -> Integers:
        """Select the pairs whose bounding boxes along their sampled paths overlap."""
        low, high = states[:, :2].copy(), states[:, :2].copy()
        moving = np.flatnonzero(mask)
        low[moving] = np.minimum(low[moving], out[:, moving, :2].min(axis=0))
        high[moving] = np.maximum(high[moving], out[:, moving, :2].max(axis=0))
        speed = np.abs(out[:, moving, 3:5]).sum(axis=2).max(axis=0)
        margin = self._bodies.radius.copy()
        # twice what it does at the instants known, and what wheels can make of it
        margin[moving] += 2.0 * (speed + wheels) * float(np.diff(times_s, prepend=0.0).max()) + MARGIN_M
        i, j = pairs.T
        low, high = low - margin[:, None], high + margin[:, None]
        return pairs[np.all((low[i] < high[j]) & (low[j] < high[i]), axis=1)]

    # --- resolved -------------------------------------------------------------------------------------

    def _resolve(
        self, live: Integers, fixed: Integers, drive: ContactDrive, leg: Segment
    ) -> tuple[list[AdvanceResult], list[ContactEvent]]:
        span_s = leg.span_s
        present = np.union1d(live, fixed)
        contacts = self._forget(present)
        mask, states = self._mask(live), self._states()
        strides = self._strides(drive.wheels, span_s)
        while True:
            pairs = self._near(live, present, strides)
            involved = np.intersect1d(live, pairs)
            start = self._solver.snapshot(involved)
            groups = [group for group in self._groups(pairs, mask, states) if not self._sleeps(group, drive)]
            done = [self._through(group, drive, span_s) for group in groups]
            came = np.zeros(len(strides))
            for one in done:
                came[one.group.names] = one.displacement_m
            far = came > strides
            if not far.any():
                break
            # hit by something faster: it may have come to others than were thought of
            strides[far] = 2.0 * came[far]
            self._solver.restore(start)
        # those asleep are as those alone: a support may have gone from below them
        others = np.setdiff1d(live, [parcel for group in groups for parcel in group.parcels.tolist()])
        results = self._solver.advance(others, Segment.through(drive.motion, drive.grip, span_s, len(states)))
        for one in done:
            if one.slowing is not None and drive.motion.slowing is not None:
                drive.motion.slowing[:] += one.slowing
            results += one.results
            contacts += one.contacts
            names = _named(one.group)
            self._met.difference_update(names)
            self._met.update(names[k] for k in one.met)
        results.sort(key=lambda one: one.parcel)
        return results, contacts

    def _groups(self, pairs: Integers, mask: NDArray[np.bool_], states: Floats) -> Iterator[Group]:
        """Group pairs that are connected through moving parcels."""
        leader = np.arange(len(mask))
        both = pairs[mask[pairs].all(axis=1)]
        before = np.zeros(0)
        while not np.array_equal(before, leader):
            before = leader.copy()
            np.minimum.at(leader, both[:, 0], before[both[:, 1]])
            np.minimum.at(leader, both[:, 1], before[both[:, 0]])
            leader = leader[leader]
        chosen = leader[np.where(mask[pairs[:, 0]], pairs[:, 0], pairs[:, 1])]
        order = np.argsort(chosen, kind="stable")
        for group in np.split(pairs[order], np.flatnonzero(np.diff(chosen[order])) + 1):
            if len(group):
                yield self._bodies.group(group, mask, states)

    def _sleeps(self, group: Group, drive: ContactDrive) -> bool:
        """Whether a group rests on standing wheels, no pair overlapping or newly touching. If so, its motion ends."""
        states, motion = self._solver.state[group.parcels], drive.motion
        speed = np.hypot(states[:, 3], states[:, 4]) + self._bodies.radius[group.parcels] * np.abs(
            states[:, 5]
        )
        if speed.max(initial=0.0) > REST_M_S:
            return False
        for parcel in group.parcels.tolist():
            under = self._solver.covered_cells(parcel)
            if (np.abs(motion.steady[under]) + np.abs(motion.decay[under])).max(initial=0.0) > REST_M_S:
                return False
        from plant.kernels.contact import entry as contact_entry

        kernels: Any = contact_entry
        here = group.still.copy()
        here[group.moving] = states
        for (i, j), pair in zip(group.pairs.tolist(), _named(group), strict=True):
            gap = kernels.gap(group.shapes, i, j, here[i], here[j])[0]
            if gap < -to.TOUCH_M or (gap <= to.TOUCH_M and pair not in self._met):
                return False
        self._solver.state[group.parcels, 3:] = 0.0
        return True

    def _through(self, group: Group, drive: ContactDrive, span_s: float) -> Resolution:
        met = {k for k, pair in enumerate(_named(group)) if pair in self._met}
        one = Resolution(self._solver, group, drive, self._rules, met)
        one.run(span_s)
        return one


def _named(group: Group) -> list[Pair]:
    """The group's pairs by the bodies' numbers in the scene."""
    return [(first, second) for first, second in group.names[group.pairs].tolist()]


def _known(free_motion: FreeMotion, span_s: float, times_s: Floats) -> tuple[Floats, Floats]:
    """Instants of a free motion that are sampled in any case, and states there."""
    times = times_s if len(times_s) and times_s[-1] == span_s else np.append(times_s, span_s)
    return np.insert(times, 0, 0.0), np.concatenate([free_motion.start[None], free_motion.sample(times)])
