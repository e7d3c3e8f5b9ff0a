"""Contact resolution of one group of bodies over a span.

Parcels that are apart move freely up to the instant at which a pair touches. There all touching points get an impact at
once (``plant.kernels.contact.impact``). Pairs that stay together go on in steps of at most ``step_s``: all move
freely, then
velocities lose what would take bodies into each other, with friction; what pushed them acts on their places as a force
even over the step would have; and what overlap is left is taken out of the places
(``plant.kernels.contact.resting``). Both
corrections are the least ones in the metric of the masses: the first takes energy and never adds any, and neither moves
the common centre of mass. Bodies shifted apart pass each other more slowly, so that angular momentum is kept
(``plant.kernels.contact.momentum``).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from plant import stop
from plant.effects.parcel_contact.bodies import Group, fastest, make_workspace
from plant.effects.parcel_contact.detect import ContactSearch
from plant.effects.parcel_contact.events import ContactEvent, contact_event
from plant.effects.parcel_contact.free_motion import STILL_THERE, FreeMotion, FreeMotionEnded, later
from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.errors import PlantStopped, PlantUnstable
from plant.kernels.contact import layout as to
from plant.solver_api import AdvanceResult, Rewindable
from plant.wheels import WheelIntegrator, WheelMotion, WheelRun

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SHORT_S: Final = 1e-6
"""No step is shortened below this for a second corner's sake."""
FEW: Final = 200
"""Impacts in a call and for each pair after which nothing bounces any more."""
MANY: Final = 10_000
"""Steps in a call and for each pair, beside those of ``step_s``, after which it is given up."""


class ContactDrive(NamedTuple):
    """Wheel motion and traction that act on the parcels of a call.

    Attributes:
        motion: motion of the wheels, from the start of the call; not changed.
        grip: as for ``Solver.advance``.
        wheels: speed of the fastest wheel, m/s.
        start_s: start of the call, s.
    """

    motion: WheelMotion
    grip: Floats
    wheels: float
    start_s: float


@final
class Resolution:
    """Contact resolution of a group in a single call.

    Args:
        solver: solver that moves parcels.
        group: bodies of the group.
        drive: wheel motion and traction.
        rules: contact settings of the scene.
        met: touching pairs at the start, by their numbers in the group.

    Attributes:
        group: bodies of the group; tipped bodies are stopped.
        met: touching pairs now.
        results: results of parcels with events, times from the start of the call.
        contacts: contacts that began or ended.
        displacement_m: length of each body's path, ``(b,)``, m.
        slowing: what the parcels have taken from the wheels, as ``WheelMotion.slowing``; None where they take nothing.
    """

    def __init__(
        self, solver: Rewindable, group: Group, drive: ContactDrive, rules: ParcelContactSpec, met: set[int]
    ) -> None:
        from plant.kernels.contact import entry as contact_entry

        self._kernels: Any = contact_entry
        self._solver, self._drive, self._rules = solver, drive, rules
        self._work = make_workspace(group)
        self._impacts = 0
        self.group = group
        self.met = met
        self.results: list[AdvanceResult] = []
        self.contacts: list[ContactEvent] = []
        self.displacement_m: Floats = np.zeros(len(group.names))
        slowing = drive.motion.slowing
        self.slowing: Floats | None = None if slowing is None else np.zeros_like(slowing)
        # the next free motion begins on wheels as slow as the last ones left them
        run = WheelRun(replace(drive.motion, slowing=self.slowing))
        self._loaded = None if slowing is None else WheelIntegrator(run)

    def run(self, span_s: float) -> None:
        """Take the group through the span.

        Raises:
            PlantUnstable: contacts follow each other without end.
            PlantStopped: the end of the call was requested.
        """
        now, steps = 0.0, MANY * len(self.group.pairs) + math.ceil(span_s / self._rules.step_s)
        while now < span_s:
            steps -= 1
            if steps < 0:
                raise PlantUnstable(f"contacts without end {self._where(now)}", self._drive.start_s + now)
            if stop.requested():
                raise PlantStopped(f"stopped {self._where(now)}", self._drive.start_s + now)
            self._apply_impacts(now)
            before = self._states()
            soonest = float(self._kernels.together(self.group, before, self._work))
            together = self._work.marks == to.TOGETHER
            longest = self._longest(soonest, span_s - now) if together.any() else span_s - now
            try:
                step = self._free(now, longest, np.flatnonzero(~together))
            except FreeMotionEnded as ended:
                self._take(ended.done, now)
                return
            if together.any():
                self._hold(before, step)
            now = span_s if step >= span_s - now else now + step
            self.displacement_m += np.hypot(*(self._states() - before)[:, :2].T)
            self._note_apart(now)
        states = self._states()
        count = self._kernels.meet(self.group, states, self._work)
        self._note_begun(now, count, states)
        self._note_left()

    # --- states -----------------------------------------------------------------------------------

    def _states(self) -> Floats:
        """``(b, 6)`` now; a copy."""
        states = self.group.still.copy()
        states[self.group.moving] = self._solver.state[self.group.parcels]
        return states

    def _put(self, states: Floats) -> None:
        """Write changed states of the group's moving parcels to the solver."""
        for body, parcel in zip(self.group.moving.tolist(), self.group.parcels.tolist(), strict=True):
            if not np.array_equal(states[body], self._solver.state[parcel]):
                self._solver.set_state(parcel, states[body])

    def _where(self, now: float) -> str:
        x, y = self._states()[self.group.moving, :2].mean(axis=0)
        named, at_s = self.group.parcels.tolist(), self._drive.start_s + now
        return f"among parcels {named} at t = {at_s:.6g} s near x = {x:.6g} m, y = {y:.6g} m"

    # --- impacts ----------------------------------------------------------------------------------

    def _apply_impacts(self, now: float) -> None:
        """Change velocities where bodies that touch close on each other."""
        states, work = self._states(), self._work
        count = self._kernels.meet(self.group, states, work)
        if count:
            self._note_begun(now, count, states)
            # past a limit bouncing ends: two walls that close on a parcel would never let it
            bounce = self._rules.restitution if self._impacts < FEW * len(self.group.pairs) else 0.0
            sequential = self._rules.impacts == "sequential"
            fastest = self._kernels.collide(
                self.group, count, states, bounce, self._rules.friction, sequential, work
            )
            self._impacts += fastest > self.group.slow
            self._note_bounced(now, count, states)
        self._put(states)

    # --- free motion ------------------------------------------------------------------------------

    def _longest(self, soonest: float, left: float) -> float:
        """How long a step may be while pairs stay together, up to when a second corner of one strikes."""
        # equal steps up to the end, none longer than said
        parts = math.ceil(left / self._rules.step_s - 1e-9)
        return min(left / max(parts, 1), max(soonest, SHORT_S))

    def _free(self, now: float, span: float, apart: Integers) -> float:
        """Move all freely until one of the pairs ``apart`` touches, or by ``span``. Returns how far."""
        if not len(self.group.moving):
            return span
        drive, loaded = self._drive, self._loaded
        motion = later(drive.motion, now) if loaded is None else loaded.begin()
        free_motion = FreeMotion(self._solver, self.group, motion, drive.grip)
        step = span
        if len(apart):
            times = np.array([0.0, span])
            states = np.stack([free_motion.start, free_motion.sample(times[1:])[0]])
            wheels = drive.wheels if loaded is None else fastest(motion)
            search = ContactSearch(free_motion, self.group, wheels, times, states)
            found = search.contact(apart)
            step = span if found is None else float(search.times[found.known])
        for one in free_motion.advance(step):
            self._take(one, now)
            if one.termination not in STILL_THERE:
                return span
        if loaded is not None:
            loaded.end(motion, now + step)
        return step

    def _take(self, one: AdvanceResult, now: float) -> None:
        """Note what happened to a parcel in a step that began at ``now``."""
        events = [event._replace(after_s=now + event.after_s) for event in one.events]
        self.results.append(one._replace(moved_s=now + one.moved_s, events=events))
        if one.termination == "tipped":
            state = self._solver.state[one.parcel]
            state[3:] = 0.0
            self.group = self.group.stopped(int(np.searchsorted(self.group.names, one.parcel)), state)

    def _hold(self, before: Floats, step: float) -> None:
        """Correct velocities and places after a free step of pairs that stay together."""
        states = self._states()
        self._kernels.hold(self.group, before, states, step, self._rules.friction, self._work)
        self._put(states)

    def _note_left(self) -> None:
        """Tell what contact problems of the call have left unsolved, and overlap that was taken out at once."""
        left, slippery = self._work.left, int(self._work.impulses.tally[to.SLIPPERY])
        if slippery or left[to.ERROR] > 0.0:
            self._tell(
                "contact_residual",
                f"{slippery} problems solved without friction; velocities miss by up to {left[to.ERROR]:.2g} m/s",
            )
        if left[to.OVERLAP] > 0.0:
            self._tell("contact_residual", f"overlap of up to {left[to.OVERLAP]:.2g} m left")
        if left[to.PARTED] > to.NEAR_M:
            self._tell("parted", f"overlap of up to {left[to.PARTED]:.4g} m taken out")

    def _tell(self, kind: str, detail: str) -> None:
        x, y = self._states()[self.group.moving, :2].mean(axis=0).tolist()
        parcels = self.group.parcels.tolist()
        self.contacts.append(
            ContactEvent(0.0, kind, (parcels[0], parcels[0]), (x, y), f"among parcels {parcels}: {detail}")
        )

    # --- events --------------------------------------------------------------------------------------

    def _record(self, now: float, kind: str, pair: int, count: int, states: Floats) -> None:
        mine = np.flatnonzero(self._work.ends[:count, to.PAIR] == pair)
        rows, ends = self._work.rows[mine], self._work.ends[mine]
        self.contacts.append(contact_event(self.group, now, kind, rows, ends, states[:, 3:]))

    def _note_begun(self, now: float, count: int, states: Floats) -> None:
        """Pairs that touch, the rows being in ``work``, and didn't."""
        for pair in np.unique(self._work.ends[:count, to.PAIR]).tolist():
            if pair not in self.met:
                self.met.add(pair)
                self._record(now, "contact", pair, count, states)

    def _note_bounced(self, now: float, count: int, states: Floats) -> None:
        """Pairs that touch, and open faster than what stays together."""
        self._kernels.opening(count, states, self._work)
        for pair in sorted(self.met):
            if self._work.opens[pair] > self.group.slow:
                self.met.remove(pair)
                self._record(now, "apart", pair, count, states)

    def _note_apart(self, now: float) -> None:
        """Pairs that touched and are apart."""
        if not self.met:
            return
        states, work = self._states(), self._work
        work.marks[:] = 0
        work.marks[sorted(self.met)] = to.TOGETHER
        count = self._kernels.build_rows(
            self.group,
            work.marks,
            to.TOGETHER,
            states,
            to.BEYOND,
            work.rows,
            work.ends,
        )
        nearest = np.full(len(work.marks), np.inf)
        np.minimum.at(nearest, work.ends[:count, to.PAIR], work.rows[:count, to.SPACE])
        for pair in sorted(self.met):
            if nearest[pair] > to.NEAR_M:
                self.met.remove(pair)
                if np.isfinite(nearest[pair]):
                    self._record(now, "apart", pair, count, states)
