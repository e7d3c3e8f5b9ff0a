"""Vehicles of wheels: cells under a parcel and just ahead of it carry it along a journey, and hand it on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, Final, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError, Problem
from cell_firmware.firmware import Bools, Cells, Firmware, Floats, Inbox, Inputs, Outbox, Outputs, State
from cell_firmware.program import Theory
from cell_firmware.specs import Finite, NotNegative, Positive, Spec, Vector
from cell_firmware.toolkit.hold import Ttl, age_ttl, hold_last
from cell_firmware.toolkit.portable_trig import direction
from cell_firmware.toolkit.trajectory import ReferenceTrajectory, Setpoint, TrajectorySegment, at_all

Integers = NDArray[np.int64]

NONE, CARRIES, GIVES_WAY, WAITS, ARRIVED = range(5)
"""Values of ``state``: status of the vehicle that a cell belongs to."""
_MOST_HOPS: Final = 255
_LONGEST: Final = 2**31


class Vehicle(Spec):
    """Specification of a vehicle: initial pose, radius, speeds and journey."""

    start_m: Vector
    """Initial reference: the target of the parcel's centre of mass."""
    angle_rad: Finite = 0.0
    """Initial angle of the reference."""
    radius_m: Positive
    """Radius of a circle about the reference that contains the parcel."""
    speed_m_s: Positive = 0.1
    """Speed of the moving reference."""
    turn_rate_rad_s: Positive = 0.5
    """Angular speed of the turning reference."""
    legs: Annotated[tuple[TrajectorySegment, ...], Field(min_length=1, max_length=1_000)]
    """Segments of the journey."""
    laps: Annotated[int, Field(ge=1, le=1_000)] = 1
    """Number of times that the reference runs through ``legs``."""

    def journey(self) -> ReferenceTrajectory:
        """Return the trajectory of the vehicle's reference."""
        legs = self.legs * self.laps
        return ReferenceTrajectory(
            (*self.start_m, self.angle_rad), legs, self.speed_m_s, self.turn_rate_rad_s
        )


class VirtualVehicleParameters(Spec):
    """Vehicles, and the control of their parcels."""

    vehicles: Annotated[tuple[Vehicle, ...], Field(min_length=1, max_length=100)]
    ahead: Annotated[int, Field(ge=1, le=20)] = 1
    """Distance, in cells, from a cell that senses the parcel up to which wheels run; and by how many pitches a vehicle
    is wider than its radius."""
    ttl_periods: Ttl = 4
    """Validity of a neighbour's message, periods."""
    centring_per_s: tuple[NotNegative, NotNegative] = (0.5, 1.5)
    """Speed towards the reference per distance from it, along the reference's x and y. Unequal values turn a long
    parcel along the axis of the smaller value."""
    hold_m: Positive | None = None
    """A vehicle advances while a cell within this distance of its reference senses the parcel; default 1.5 pitches."""


@final
@dataclass(frozen=True, slots=True)
class _Words:
    """Vehicles as known to cells: arrays ``(n, vehicles)``, or ``(n,)`` for each cell's own vehicle.

    Attributes:
        periods: The record: periods of the journey so far; -1 where the vehicle is unknown.
        reference: Reference of the vehicle after these periods.
        dx: Position of the cell from the reference along x, m.
        dy: Position of the cell from the reference along y, m.
        depth: Depth of the cell in the vehicle's circle, m.
        core: Whether the cell holds the record and advances it.
        hops: Range of messages within the vehicle, hops.
        life: Remaining hops of the core's sign of life; 0: no core is known.
        valid_periods: Remaining periods for which neighbouring cells of the vehicle are valid.
    """

    periods: Integers
    reference: Setpoint
    dx: Floats
    dy: Floats
    depth: Floats
    core: Bools
    hops: Integers
    life: Integers
    valid_periods: Integers


@final
class VirtualVehicle(Firmware):
    """A vehicle is a record that goes with its parcel from cell to cell.

    The record is a whole number: for how many periods the vehicle has been on its journey, from which every cell works
    out the reference pose. Cells near the reference (the core) that sense a parcel add one each period; all take over
    the greatest number that a neighbour sends. So there is one pace, that of the core, and where no cell of the core
    senses a parcel the vehicle waits.

    A cell belongs to the vehicle in whose circle it lies deepest, of those that it knows and whose core still
    gives signs of life (a number that falls by one a hop). It drives a rigid motion and draws to the reference,

        V = U + w J d - R diag(kx, ky) R' d        d its place from the reference, R the reference's angle

    while a parcel is sensed within ``ahead`` cells. For a parcel under which all wheels turn, the mean of the linear
    field over its supports is the field at its centre of mass, whatever the supports (docs/dynamics.md): with e its
    distance from the reference, ``e'' = -mu g (K e + e') - d/dt U``, K = R diag(kx, ky) R'.

    Vehicles whose circles, wider by ``ahead`` pitches, meet: cells that know both send word, and it goes from
    hop to hop. The one named later gives way, while going on as they do the two would pass within a pitch of each
    other's circles; the one named first only where they have come that near. Nobody gives way to who is behind it.

    Source: the idea is the demonstration of Luntz, Messner and Choset (parcels moved and turned independently by the
    cells that happen to be under them); the protocol is ours.
    """

    Parameters = VirtualVehicleParameters
    message = np.dtype(
        [("vehicle", "u1"), ("periods", "<u4"), ("level", "u1"), ("life", "u1"), ("halt", "u1")]
    )
    observable = "speed_m_s"

    def __init__(self, parameters: VirtualVehicleParameters) -> None:
        super().__init__(parameters)
        self._journeys = tuple(vehicle.journey() for vehicle in parameters.vehicles)
        self._radius_m: Floats = np.array([vehicle.radius_m for vehicle in parameters.vehicles])
        self._margin = 2.0 * parameters.ahead - 1.0
        self._numbers: Integers = np.arange(1, len(self._journeys) + 1)

    def check_geometry(self, lattice: Lattice, position_m: Floats, pitch_m: float) -> None:
        """Refuse journeys to places without a cell that can hold the record, and vehicles that start in one circle."""
        del lattice
        parameters: VirtualVehicleParameters = self.parameters
        problems: list[Problem] = []
        for v, (vehicle, journey) in enumerate(zip(parameters.vehicles, self._journeys, strict=True)):
            bare = _bare(journey, vehicle.speed_m_s, position_m, self._hold_m(pitch_m), pitch_m)
            if bare is not None:
                rule = f"leads to ({bare[0]:.4g}, {bare[1]:.4g}) m, where no cell is near enough to hold the vehicle"
                problems.append(Problem(("vehicles", v), rule, list(vehicle.start_m)))
            for other in range(v):
                between = np.subtract(vehicle.start_m, parameters.vehicles[other].start_m)
                if (
                    np.sqrt((between * between).sum())
                    < vehicle.radius_m + parameters.vehicles[other].radius_m
                ):
                    rule = f"begins within the circle of vehicles[{other}]"
                    problems.append(Problem(("vehicles", v), rule, list(vehicle.start_m)))
        if problems:
            raise ParametersError("virtual_vehicle", tuple(problems))

    def value_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Return the range of vehicles' numbers, 0 for none."""
        return {"vehicle": (0, len(self._journeys))}

    def theory(self, lattice: Lattice) -> Theory | None:
        """Predict the durations of the journeys without delays."""
        del lattice
        seconds = ", ".join(f"{journey.duration_s:.4g}" for journey in self._journeys)
        return Theory(f"journeys of {seconds} s of nominal periods, plus one period for each handover")

    def init(self, cells: Cells) -> State:
        """Return the initial state: cells in a vehicle's circle know its record; no messages, no presence."""
        n, vehicles = len(cells), self.parameters.vehicles
        start: Floats = np.array([vehicle.start_m for vehicle in vehicles])
        dx, dy = cells.position_m[:, 0, None] - start[:, 0], cells.position_m[:, 1, None] - start[:, 1]
        within = np.sqrt(dx * dx + dy * dy) <= self._radius_m + self.parameters.ahead * cells.pitch_m
        sides = {
            f"neighbour_{name}": np.zeros((n, 4), dtype=np.int64)
            for name in ("vehicle", "level", "life", "halt")
        }
        return {
            "position_m": cells.position_m,
            "pitch_m": np.full(n, cells.pitch_m),
            "period_s": np.full(n, cells.period_s),
            "periods": np.where(within, 0, -1),
            "valid_periods": np.zeros((n, len(vehicles)), dtype=np.int64),
            **sides,
            "counts": np.zeros((n, 4), dtype=np.int16),
            "vehicle": np.zeros(n, dtype=np.int64),
            "advances": np.zeros(n, dtype=np.bool_),
            "idle": np.zeros(n, dtype=np.int64),
            "state": np.zeros(n, dtype=np.int64),
            "speed_m_s": np.zeros((n, 2)),
        }

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Update the vehicles, choose the cell's own, drive its motion, and send its record."""
        inbox = inputs.inbox
        assert inbox is not None, "this is a bug: this firmware has messages"
        here = np.zeros(len(inputs.presence), dtype=np.bool_) | inputs.presence.any(axis=1)
        neighbour = self._update_neighbours(state, inbox)
        words = self._words(state, neighbour, inbox)
        own = _own(words)
        mine: _Words = _picked(words, np.maximum(own - 1, 0))
        level = _spread(neighbour, own, "level", here, self.parameters.ahead + 1)
        conflict = self._conflict(words, mine, own, state["pitch_m"])
        halt = _spread(neighbour, own, "halt", conflict, mine.hops)

        before = _picked(state["periods"], np.maximum(own - 1, 0))
        idle = np.where((own == 0) | (mine.periods > before), 0, np.minimum(state["idle"] + 1, _LONGEST))
        speed = self._speed(mine, (own > 0) & (level > 0), halt == 0)
        said = {"vehicle": own, "periods": mine.periods, "level": level, "life": mine.life, "halt": halt}
        after = {
            **state,
            **neighbour,
            "periods": words.periods,
            "valid_periods": words.valid_periods,
            "vehicle": own,
            "advances": mine.core & (own > 0) & here & (halt == 0) & ~mine.reference.ended,
            "idle": idle,
            "state": self._state(own, mine, halt, idle),
            "speed_m_s": speed,
        }
        return after, Outputs(speed, self._outbox(said, words, inbox))

    # --- reception --------------------------------------------------------------------------------

    def _update_neighbours(self, state: State, inbox: Inbox) -> dict[str, NDArray[Any]]:
        """Return each neighbour's last message while still valid, else zeros; and the remaining validity."""
        counts = age_ttl(inbox.received, state["counts"], self.parameters.ttl_periods)
        neighbour = {
            name: hold_last(
                inbox.received, counts, inbox.message[name.removeprefix("neighbour_")], state[name]
            )
            for name in ("neighbour_vehicle", "neighbour_level", "neighbour_life", "neighbour_halt")
        }
        return {**neighbour, "counts": counts}

    def _words(self, state: State, neighbour: Mapping[str, Integers], inbox: Inbox) -> _Words:
        """Update the state of all vehicles by received messages."""
        pitch_m = state["pitch_m"][:, None]
        come = np.where(inbox.received, inbox.message["vehicle"], 0)[:, :, None] == self._numbers
        received = np.where(come, inbox.message["periods"].astype(np.int64)[:, :, None], -1).max(axis=1)
        advances = state["advances"][:, None] & (state["vehicle"][:, None] == self._numbers)
        periods = np.maximum(state["periods"] + advances, received)

        reference = at_all(self._journeys, np.maximum(periods, 0) * state["period_s"][:, None])
        place = state["position_m"]
        dx, dy = place[:, 0, None] - reference.x, place[:, 1, None] - reference.y
        distance = np.sqrt(dx * dx + dy * dy)
        core = (periods >= 0) & (distance <= self._hold_m(pitch_m))
        outer_m = self._radius_m + self.parameters.ahead * pitch_m
        hops = np.minimum(2.0 * np.ceil(2.0 * outer_m / pitch_m), _MOST_HOPS).astype(np.int64)

        says = (neighbour["neighbour_vehicle"][:, :, None] == self._numbers) & (
            neighbour["neighbour_life"] > 0
        )[:, :, None]
        nearest: Integers = np.where(says, neighbour["neighbour_life"][:, :, None], 0).max(axis=1)
        life = np.where(core, hops, np.maximum(nearest - 1, 0))
        still = np.where(
            says.any(axis=1), self.parameters.ttl_periods, np.maximum(state["valid_periods"] - 1, 0)
        )
        return _Words(periods, reference, dx, dy, outer_m - distance, core, hops, life, still)

    # --- what is done -----------------------------------------------------------------------------

    def _conflict(self, words: _Words, mine: _Words, own: Integers, pitch_m: Floats) -> Bools:
        """Return which cells know a vehicle to which their own must give way."""
        here, there = mine.reference, words.reference
        apart_x, apart_y = there.x - here.x[:, None], there.y - here.y[:, None]
        apart = np.sqrt(apart_x * apart_x + apart_y * apart_y)
        near = self._radius_m + self._radius_m[np.maximum(own - 1, 0)][:, None] + pitch_m[:, None]
        towards = here.vx[:, None] * apart_x + here.vy[:, None] * apart_y > 0.0

        first = (self._numbers < own[:, None]) & (apart < near + self._margin * pitch_m[:, None])
        pace_x, pace_y = here.vx[:, None] - there.vx, here.vy[:, None] - there.vy
        closing, pace = pace_x * apart_x + pace_y * apart_y, pace_x * pace_x + pace_y * pace_y
        # as both go on, they pass each other at sqrt(apart^2 - closing^2 / pace)
        meet = (closing > 0.0) & ((apart * apart - near * near) * pace < closing * closing)

        others = (own > 0)[:, None] & (self._numbers != own[:, None]) & (words.valid_periods > 0)
        found: Bools = (others & towards & ((apart < near) | (first & meet))).any(axis=1)
        return found

    def _speed(self, mine: _Words, turns: Bools, goes: Bools) -> Floats:
        """The field of the vehicle's motion at the cell, ``(n, 2)`` m/s; 0 where wheels stand."""
        reference = mine.reference
        cosine, sine = direction(reference.angle)
        along, across = cosine * mine.dx + sine * mine.dy, cosine * mine.dy - sine * mine.dx
        kx, ky = self.parameters.centring_per_s
        back_x, back_y = kx * along, ky * across
        vx = np.where(goes, reference.vx - reference.turning * mine.dy, 0.0)
        vy = np.where(goes, reference.vy + reference.turning * mine.dx, 0.0)
        speed = np.stack(
            (vx - (cosine * back_x - sine * back_y), vy - (sine * back_x + cosine * back_y)), axis=1
        )
        return np.where(turns[:, None], speed, 0.0)

    def _state(self, own: Integers, mine: _Words, halt: Integers, idle: Integers) -> Integers:
        """Return the status of the vehicle, for display."""
        found = np.where(idle > self.parameters.ttl_periods, WAITS, CARRIES)
        found = np.where(halt > 0, GIVES_WAY, found)
        return np.where(own == 0, NONE, np.where(mine.reference.ended, ARRIVED, found))

    def _outbox(self, said: Mapping[str, Integers], words: _Words, inbox: Inbox) -> Outbox:
        """Send the record to all sides; to a side with an older record of another vehicle, send the newer record."""
        message = self.message
        assert message is not None
        outbox = Outbox.empty(len(said["vehicle"]), message)
        for name, values in said.items():
            outbox.message[name] = values[:, None]
        outbox.sent[:] = said["vehicle"][:, None] > 0
        vehicle = np.where(inbox.received, inbox.message["vehicle"], 0).astype(np.int64)
        known = np.take_along_axis(words.periods, np.maximum(vehicle - 1, 0), axis=1)
        behind = (vehicle > 0) & (vehicle != said["vehicle"][:, None]) & (inbox.message["periods"] < known)
        corrected = np.zeros(behind.shape, dtype=outbox.message.dtype)
        corrected["vehicle"], corrected["periods"] = vehicle, np.maximum(known, 0)
        return Outbox(outbox.sent | behind, np.where(behind, corrected, outbox.message))

    def _hold_m(self, pitch_m: Any) -> Any:
        """Return the distance from the reference within which a cell advances the vehicle, m."""
        given: float | None = self.parameters.hold_m
        return 1.5 * pitch_m if given is None else given


def _own(words: _Words) -> Integers:
    """Return the vehicle of each cell, from 1: the vehicle in whose circle the cell lies deepest; 0 for none."""
    alive = (words.periods >= 0) & (words.life > 0) & (words.depth >= 0.0)
    depth = np.where(alive, words.depth, -1.0)
    deepest = depth.argmax(axis=1)
    return np.where(_picked(alive, deepest), deepest + 1, 0)


def _spread(
    neighbour: Mapping[str, Integers], own: Integers, what: str, source: Bools, most: Integers | int
) -> Integers:
    """Propagate a number: ``most`` at its sources, less by 1 a hop, within cells of a vehicle."""
    same = (neighbour["neighbour_vehicle"] == own[:, None]) & (own > 0)[:, None]
    highest = np.where(same, neighbour[f"neighbour_{what}"], 0).max(axis=1)
    return np.where(source, most, np.maximum(highest - 1, 0))


def _picked(item: Any, index: Integers) -> Any:
    """Select by each cell's index from an array ``(n, vehicles)``, or from each array of a structure."""
    if isinstance(item, np.ndarray):
        return np.take_along_axis(item, index[:, None], axis=1)[:, 0]  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
    return type(item)(*(_picked(getattr(item, part.name), index) for part in fields(item)))


def _bare(
    journey: ReferenceTrajectory, speed_m_s: float, position_m: Floats, hold_m: float, pitch_m: float
) -> tuple[float, float] | None:
    """Return the first position of a journey without a cell near enough to hold the record; None if there is none."""
    steps = int(journey.duration_s * speed_m_s / (0.1 * pitch_m)) + 2
    path = journey.at(np.linspace(0.0, journey.duration_s, steps))
    for x, y in zip(path.x.tolist(), path.y.tolist(), strict=True):
        dx, dy = position_m[:, 0] - x, position_m[:, 1] - y
        if not (dx * dx + dy * dy <= hold_m * hold_m).any():
            return x, y
    return None
