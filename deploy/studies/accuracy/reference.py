"""Reference solutions of the accuracy study, checked against another method and a closed form.

Methods are tried in order, from the finest on. Where chatter is too dense for these methods, the reference is ``exact``
with every crossing located from the onset of chatter on, and a note says so.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np

from deploy.errors import InputError
from deploy.runs.field_simulation import field_speeds
from deploy.studies.accuracy.closed_form import closed_form
from deploy.studies.accuracy.errors import displacement_m
from deploy.studies.accuracy.sweep import Settings, refusal, with_solver
from deploy.studies.accuracy.trace import AccuracyTrace, run_trace
from plant.errors import PlantError

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene

METHODS: tuple[Settings, ...] = (
    {"name": "heyoka", "tolerance": 1e-14},
    {"name": "scipy", "method": "DOP853", "tolerance": 1e-13, "max_step_s": 2e-3},
    {"name": "implicit", "tolerance": 1e-11},
)
"""Methods that are not the one in question, the finest first; SciPy's is held to steps that lose no longer crossing."""
FINEST: Settings = {"name": "exact", "tolerance": 1e-14}
CRUDE: Settings = {"name": "fixed_step", "method": "rk4", "step_s": 1e-4}
"""Asked only where nobody else can be: some check is better than none."""
LOCATED_M = 1e-12
"""Chatter is followed crossing by crossing down to this swing."""


@final
@dataclass(frozen=True, slots=True)
class Agreement:
    """Difference between a check and the reference.

    Attributes:
        method: of the check.
        what: what of it was compared.
        apart_m: the largest distance.
        until_s: up to then.
    """

    method: str
    what: str
    apart_m: float
    until_s: float


@final
@dataclass(frozen=True, slots=True)
class Reference:
    """Reference solution of a scene, which solvers' errors are measured from.

    Attributes:
        method: in words.
        solver: name of the solver that computed the reference.
        trace: its states and events.
        second: name and trace of the reference for rows of ``solver`` itself; None: no second reference.
        agreement: differences from every check.
        chatter_s: time before which no chatter is captured, s; None without chatter.
        notes: further remarks, a sentence each.
    """

    method: str
    solver: str
    trace: AccuracyTrace
    second: tuple[str, AccuracyTrace] | None
    agreement: Sequence[Agreement]
    chatter_s: float | None
    notes: Sequence[str]

    @property
    def confirmed_m(self) -> float | None:
        """Difference from the check that agrees best, m, over corners where one was compared; None without a check."""
        corners = [one.apart_m for one in self.agreement if one.what == "corners"]
        return min(corners or [one.apart_m for one in self.agreement], default=None)

    def judge(self, solver: str) -> tuple[str, AccuracyTrace]:
        """Return name and trace of the reference that a solver is compared with."""
        if solver == self.solver and self.second is not None:
            return self.second
        return self.solver, self.trace

    @property
    def duration_s(self) -> float:
        """Up to when events are compared."""
        return float(self.trace.time_s[-1]) if self.chatter_s is None else self.chatter_s


def describe_method(settings: Settings) -> str:
    """``heyoka, tolerance 1e-14``."""
    rest = ", ".join(f"{key} {value}" for key, value in settings.items() if key != "name")
    return f"{settings['name']}, {rest}"


@final
class ReferenceSolver:
    """Finds the reference of a scene.

    Args:
        scene: with ideal wheels.
        limit_s: processor time that one run may take.
        budget_s: processor time that all of them may take.
        thorough: whether to ask a further method where a closed form has answered.
        poll: called now and then; may raise.
        methods: what to try, in order.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        limit_s: float,
        budget_s: float = np.inf,
        thorough: bool = True,
        poll: Callable[[], None] = lambda: None,
        methods: Sequence[Settings] = METHODS,
    ) -> None:
        self._scene, self._limit_s, self._thorough, self._poll = scene, limit_s, thorough, poll
        self._methods = list(methods)
        self._notes: list[str] = []
        self._exact: AccuracyTrace | None = None
        self._located: AccuracyTrace | None = None
        self._over_s = time.process_time() + budget_s

    def solve(self) -> Reference:
        """Compute it, and check it.

        Raises:
            InputError: No solver gets through the scene.
        """
        self._exact = self._try(FINEST)
        onset = self._onset()
        if onset is not None:
            self._notes.append(
                f"Chatter is captured from {onset:.6g} s on: events are compared before it. After it, captured chatter "
                "is beside chatter followed crossing by crossing by up to capture_m, whatever the tolerance."
            )
            self._located = self._try({**FINEST, "capture_m": LOCATED_M})
        first, others = self._first(onset)
        if first is None:
            trace = self._located or self._exact
            if trace is None:
                raise InputError(f"scene {self._scene.name}: no reference: {' '.join(self._notes)}")
            self._notes.append("No other method gets through: exact is judged against itself, finer.")
            return self._checked(FINEST, trace, [], onset)
        return self._checked(*first, others, onset)

    # --- traces ---------------------------------------------------------------------------------------------------

    def _try(self, settings: Settings, until_s: float | None = None) -> AccuracyTrace | None:
        """Run a method and return its trace, or None and a note if that fails."""
        why = refusal(self._scene, settings)
        left_s = min(self._limit_s, self._over_s - time.process_time())
        if why is None and left_s <= 0.0:
            why = "not begun, for lack of time"
        if why is None:
            try:
                trace = run_trace(with_solver(self._scene, settings, until_s), left_s, self._poll)
            except PlantError as error:
                why = str(error)
            else:
                if trace.status == "ok":
                    return trace
                why = trace.reason
        self._notes.append(f"{describe_method(settings)}: {(why or 'no reason is known').rstrip('.')}.")
        return None

    def _onset(self) -> float | None:
        """The last sample but one before chatter is first captured."""
        if self._exact is None:
            return None
        first = min((event.time_s for event in self._exact.events if event.kind == "captured"), default=None)
        if first is None:
            return None
        before = self._exact.samples_until(first) - 2
        return float(self._exact.time_s[max(before, 0)])

    def _first(self, onset_s: float | None) -> tuple[tuple[Settings, AccuracyTrace] | None, list[Settings]]:
        """The first method that gets to the end, or else to the onset of chatter; and those that are left."""
        left = list(self._methods)
        while left:
            settings = left.pop(0)
            trace = self._try(settings)
            if trace is None and onset_s:
                before = self._try(settings, onset_s)
                trace = None if before is None else self._through_chatter(settings, before, onset_s)
            if trace is not None:
                return (settings, trace), left
        return None, left

    def _through_chatter(self, settings: Settings, trace: AccuracyTrace, onset_s: float) -> AccuracyTrace:
        """A trace up to the onset of chatter, and from there on that of ``exact``, every crossing located."""
        after = self._located or self._exact
        assert after is not None, "this is a bug: chatter without a course of exact"
        how = f"every crossing located down to {LOCATED_M:g} m" if self._located else "chatter captured"
        self._notes.append(
            f"From {onset_s:.6g} s on the reference is not {settings['name']} but exact at 1e-14, {how}."
        )
        return replace(
            trace,
            time_s=after.time_s,
            state=np.concatenate([trace.state, after.state[len(trace.time_s) :]]),
            events=[*trace.events, *(event for event in after.events if event.time_s > onset_s)],
        )

    # --- checks ---------------------------------------------------------------------------------------------------

    def _checked(
        self, settings: Settings, trace: AccuracyTrace, others: Sequence[Settings], onset: float | None
    ) -> Reference:
        until = float(trace.time_s[-1]) if onset is None else onset
        agreement: list[Agreement] = [*self._closed(trace)]
        second: tuple[str, AccuracyTrace] | None = None
        finest = self._located or self._exact
        if finest is not None and settings["name"] != "exact":
            second = "exact", finest
            agreement.append(_apart(describe_method(FINEST), trace, finest, until))
            if self._located is not None:
                located = describe_method({**FINEST, "capture_m": LOCATED_M})
                agreement.append(_apart(located, trace, finest, float(trace.time_s[-1])))
        if others and (self._thorough or not agreement or second is None):
            third = next(
                ((one, found) for one in others if (found := self._try(one, onset)) is not None), None
            )
            if third is not None:
                agreement.append(_apart(describe_method(third[0]), trace, third[1], until))
                if second is None:
                    second = str(third[0]["name"]), third[1]
        if not agreement:
            crude = self._try(CRUDE, onset)
            if crude is not None:
                agreement.append(_apart(describe_method(CRUDE), trace, crude, until))
        name = str(settings["name"])
        if second is None and name != "exact":
            self._notes.append(
                f"No other method of its digits solves the scene: {name} is judged against itself, finer."
            )
        return Reference(describe_method(settings), name, trace, second, agreement, onset, tuple(self._notes))

    def _closed(self, trace: AccuracyTrace) -> Sequence[Agreement]:
        """How far centres of mass are from the closed form, where there is one and every parcel stands to the end."""
        fallen = min(
            (event.time_s for event in trace.events if event.kind in ("tipped", "off_array")), default=np.inf
        )
        upright = trace.time_s < fallen
        from plant.array import CellArray

        speeds = field_speeds(self._scene, CellArray(self._scene.array).positions_m)
        times = trace.time_s[upright]
        known = closed_form(self._scene, speeds, trace.state[0], times)
        if known is None or not np.isfinite(known).all():
            return ()
        off = trace.state[upright, :, :2] - known
        apart = float(np.hypot(off[..., 0], off[..., 1]).max(initial=0.0))
        return (Agreement("closed form", "centre of mass", apart, float(times[-1])),)


def _apart(method: str, trace: AccuracyTrace, other: AccuracyTrace, until_s: float) -> Agreement:
    count = min(trace.samples_until(until_s), other.samples_until(until_s))
    off = displacement_m(trace.state[:count], other.state[:count], trace.footprints_m)
    return Agreement(method, "corners", float(off.max(initial=0.0)), until_s)


def as_json(reference: Reference) -> dict[str, Any]:
    """Convert a reference to JSON types for a report."""
    return {
        "method": reference.method,
        "agreement": [
            {"method": one.method, "what": one.what, "apart_m": one.apart_m, "until_s": one.until_s}
            for one in reference.agreement
        ],
        "chatter_s": reference.chatter_s,
        "notes": list(reference.notes),
    }
