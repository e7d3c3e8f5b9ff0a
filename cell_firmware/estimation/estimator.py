"""Distributed estimator of a parcel's pose, for protocols to embed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.estimation import election as group
from cell_firmware.estimation import occupancy as pattern
from cell_firmware.estimation.leader import FIELDS, SHOWN, UNKNOWN, EstimatorParameters, Leader, followed
from cell_firmware.firmware import Bools, Cells, Floats, Inbox, Inputs, Outbox, State, put_rows, take_rows

MESSAGE: Final = np.dtype([*group.FIELDS, *pattern.FIELDS, *FIELDS])
"""Type of the cells' messages: 95 bytes."""
_GROUP: Final = np.dtype(group.FIELDS)


@final
@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimates of n cells: pose and motion of the parcel over or near each cell.

    Attributes:
        known: ``(n,)``, whether the cell has a pose.
        leads: ``(n,)``, whether the cell is the leader, which computes the estimate.
        covered: ``(n,)``, whether one of the cell's sensors senses a parcel.
        centre_m: ``(n, 2)``.
        direction: ``(n, 2)``, unit vector along the parcel's x; which way round is left open.
        motion: ``(n, 3)``, velocity, m/s, and angular velocity, rad/s.
        shift_m: ``(n, 2)``, from the centre to the mean, by load, of the living cells that carry the parcel.
    """

    known: Bools
    leads: Bools
    covered: Bools
    centre_m: Floats
    direction: Floats
    motion: Floats
    shift_m: Floats


@final
class Estimator:
    """Estimator that elects a leader, gathers sensor readings, tracks the parcel, and distributes the pose.

    Cells that sense a parcel, and cells up to ``halo`` links around them, form a tree. Its root, the leader, senses the
    parcel: it is the current leader, or else the cell with the least row, then column. Readings go up the tree; the
    pose that the leader computes goes down. Every cell extrapolates the pose from period to period, so that it is
    current, and for ``memory`` periods without an update; a new leader starts from it.

    Args:
        parameters: Parameters of the protocol.
        halo: Width of the group around the cells that sense a parcel, links.
        ttl_periods: Validity of a neighbour's message, periods.
        memory: Validity of a pose without confirmation, periods; at most 254.
    """

    def __init__(
        self, parameters: EstimatorParameters, halo: int = 2, ttl_periods: int = 6, memory: int = 200
    ) -> None:
        self._parameters = parameters
        self._halo, self._patience, self._memory = halo, ttl_periods, memory

    def init(self, cells: Cells) -> State:
        """Return the initial state, without an estimate.

        Raises:
            ValueError: Groups of cells under such parcels would be wider than the map of their sensors.
        """
        wide, high = self._parameters.size_m
        across = np.sqrt(wide * wide + high * high) / cells.pitch_m + 1.0 + 2.0 * self._halo
        if across > pattern.WINDOW:
            raise ValueError(
                f"size_m = [{wide:g}, {high:g}]: with {self._halo} around them up to {across:.1f} cells in a row would "
                f"contribute; at most {pattern.WINDOW} can, with a pitch of {cells.pitch_m:g} m"
            )
        n, words = len(cells), (cells.sensors, pattern.WORDS)
        nothing, nobody = np.zeros(n, dtype=np.int64), np.full(n, group.NOBODY)
        site = np.concatenate(([cells.pitch_m, cells.period_s], cells.sensors_m.ravel()))
        return {
            "row": cells.row,
            "column": cells.column,
            "position_m": cells.position_m,
            "site": np.tile(site, (n, 1)),
            "neighbour": np.zeros((n, 4), dtype=_GROUP),
            "counts": np.zeros((n, 4), dtype=np.int16),
            "level": nothing,
            "leader": nobody,
            "hops": nothing,
            "parent": np.full(n, group.ROOT),
            "blocked_leader": nobody,
            "block_ticks": nothing,
            "neighbour_known": np.zeros((n, 4, *words), dtype=np.uint64),
            "neighbour_covered": np.zeros((n, 4, *words), dtype=np.uint64),
            "sent_known": np.zeros((n, *words), dtype=np.uint64),
            "sent_covered": np.zeros((n, *words), dtype=np.uint64),
            "turn": nothing,
            "leads": np.zeros(n, dtype=np.bool_),
            "covered": np.zeros(n, dtype=np.bool_),
            "centre_m": np.zeros((n, 2)),
            "direction": np.zeros((n, 2)),
            "motion": np.zeros((n, 3)),
            "grip": np.ones(n),
            "shift_m": np.zeros((n, 2)),
            "age": np.full(n, UNKNOWN),
            "young": nothing,
            "strange": nothing,
            "doubt": nothing,
            "spread": np.zeros((n, 3, 3)),
        }

    def step(self, state: State, inputs: Inputs, command: Floats) -> tuple[State, Outbox]:
        """One control period.

        Args:
            state: What ``init`` or the last step returned.
            inputs: The protocol's; its messages have the fields of ``MESSAGE`` and perhaps others.
            command: ``(n, 3)``, the rigid motion that each cell wants of the parcel and has driven in the last period,
                velocity, m/s, and angular velocity, rad/s: a leader takes its own to be everybody's.
        """
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: this firmware has messages"
        presence = inputs.presence
        awake = presence.any(axis=1) | inbox.received.any(axis=1) | (state["counts"] > 0).any(axis=1)
        awake = awake | (state["level"] > 0) | (state["age"] < UNKNOWN)
        outbox = Outbox.empty(len(awake), MESSAGE)
        rows = np.flatnonzero(awake)
        if not len(rows):
            return state, outbox
        some = {name: take_rows(array, rows) for name, array in state.items()}
        mail = Inbox(take_rows(inbox.received, rows), take_rows(inbox.message, rows))
        changed, sent, message = self._step(some, take_rows(presence, rows), mail, command[rows])
        put_rows(outbox.sent, rows, np.repeat(sent[:, None], 4, axis=1))
        put_rows(outbox.message, rows, np.repeat(message[:, None], 4, axis=1))
        after = dict(state)
        for name, new in changed.items():
            after[name] = state[name].copy()
            put_rows(after[name], rows, new.astype(state[name].dtype, copy=False))
        return after, outbox

    def plausible(self) -> dict[str, tuple[float, float]]:
        """Return plausible ranges of the fields of a pose: within 1,000 in SI units, far beyond any array."""
        return dict.fromkeys(SHOWN, (-1000.0, 1000.0))

    def estimate(self, state: State) -> Estimate:
        """Return the current estimates of the cells."""
        return Estimate(
            state["age"] < UNKNOWN,
            state["leads"],
            state["covered"],
            state["centre_m"],
            state["direction"],
            state["motion"],
            state["shift_m"],
        )

    def _step(
        self, state: State, presence: Bools, inbox: Inbox, command: Floats
    ) -> tuple[dict[str, NDArray[Any]], Bools, NDArray[Any]]:
        """Compute a control period of active cells: changed arrays, which cells send, and the messages."""
        counts = np.where(inbox.received, self._patience, np.maximum(state["counts"], 1) - 1)
        valid, neighbour = counts > 0, state["neighbour"].copy()
        neighbour[inbox.received] = inbox.message[list(_GROUP.names or ())][inbox.received]
        covered: Bools = np.any(presence, axis=1)
        place = self._place(state, covered, neighbour, valid)

        theirs = pattern.update_neighbours(
            pattern.OccupancyMap(state["neighbour_known"], state["neighbour_covered"]),
            inbox.message,
            inbox.received,
            valid,
        )
        mine = pattern.own(state["row"], state["column"], presence, place.level > 0)
        whole = pattern.merge(mine, theirs, group.children(place, neighbour, valid))
        sent = pattern.OccupancyMap(state["sent_known"], state["sent_covered"])
        turn = pattern.next_sensor(whole, sent, state["turn"])
        sent = pattern.mark_sent(sent, whole, turn)

        views = self._pose(state, place, inbox, whole, command)
        changed: dict[str, NDArray[Any]] = {
            **place._asdict(),
            **views,
            "neighbour": neighbour,
            "counts": counts,
            "neighbour_known": theirs.known,
            "neighbour_covered": theirs.covered,
            "sent_known": sent.known,
            "sent_covered": sent.covered,
            "turn": turn + 1,
            "covered": covered,
        }
        return changed, (place.level > 0) | (state["level"] > 0), _message(place, whole, turn, views)

    def _place(
        self, state: State, covered: Bools, neighbour: NDArray[Any], valid: Bools
    ) -> group.ElectionState:
        before = group.ElectionState(*(state[name] for name in group.ElectionState._fields))
        level = group.levels(covered, neighbour, valid, self._halo)
        own = group.keys(state["row"], state["column"], state["leads"])
        return group.elect(own, covered, level, neighbour, valid, before, self._patience + 2)

    def _pose(
        self,
        state: State,
        place: group.ElectionState,
        inbox: Inbox,
        whole: pattern.OccupancyMap,
        command: Floats,
    ) -> dict[str, NDArray[Any]]:
        """Return the pose estimates after a period, by name of the state's array."""
        views = followed(state, place, inbox, float(state["site"][0, 1]))
        lost = views["age"] > self._memory
        views["age"] = np.where(lost | (place.level == 0), UNKNOWN, views["age"])
        leads = (place.parent == group.ROOT) & (place.leader != group.NOBODY)
        views["leads"] = leads
        rows = np.flatnonzero(leads)
        if len(rows):
            before = {name: take_rows(array, rows) for name, array in state.items()}
            leader = Leader(self._parameters, state["site"][0])
            mine = leader.step(before, whole.take(rows), command[rows])
            for name, new in mine.items():
                views[name] = views[name].copy() if name in views else state[name].copy()
                put_rows(views[name], rows, new.astype(views[name].dtype, copy=False))
        return views


def _message(
    place: group.ElectionState,
    whole: pattern.OccupancyMap,
    turn: NDArray[np.int64],
    views: dict[str, NDArray[Any]],
) -> NDArray[Any]:
    """Return the messages of cells, ``(n,)`` of ``MESSAGE``."""
    message = np.zeros(len(turn), dtype=MESSAGE)
    for name in ("level", "leader", "hops", "parent"):
        message[name] = getattr(place, name)
    pattern.write_message(message, whole, turn)
    for name, (array, column) in SHOWN.items():
        message[name] = views[array][:, column]
    message["age"] = views["age"]
    return message
