from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.errors import ParametersError
from cell_firmware.protocols.virtual_vehicle import (
    ARRIVED,
    CARRIES,
    GIVES_WAY,
    WAITS,
    VirtualVehicle,
    VirtualVehicleParameters,
)
from tests.cell_firmware.protocols.floor import PERIOD_S, PITCH_M, Disc, Floor

EAST = {"start_m": [0.4, 0.5], "radius_m": 0.2, "speed_m_s": 0.2, "legs": [{"to_m": [1.2, 0.5]}]}


def vehicles(*several: dict[str, Any], **others: Any) -> VirtualVehicle:
    return VirtualVehicle(VirtualVehicleParameters.model_validate({"vehicles": several, **others}))


def floor(*several: dict[str, Any], rows: int = 11, columns: int = 17, **others: Any) -> Floor:
    lattice = Lattice((row, column) for row in range(rows) for column in range(columns))
    return Floor(vehicles(*several, **others), lattice, [Disc(np.array(v["start_m"])) for v in several])


def record(on: Floor, v: int = 0) -> int:
    """The farthest that anybody knows a vehicle to be, in periods."""
    return int(on.state["periods"][~on.dead, v].max())


def members(on: Floor, v: int = 0) -> Any:
    return (on.state["vehicle"] == v + 1) & ~on.dead


def reference(on: Floor, v: int = 0) -> Any:
    at = on.firmware.parameters.vehicles[v].journey().at(np.array([record(on, v) * PERIOD_S]))
    return np.array([at.x[0], at.y[0]])


# --- one vehicle ------------------------------------------------------------------------------------------


def test_the_parcel_is_carried_to_the_end_and_the_journey_takes_as_long_as_its_legs():
    on = floor(EAST)
    on.step(199)
    assert 198 - 8 <= record(on) <= 198  # a period for each of 8 pitches, in which the next cell takes over
    assert set(on.state["state"][members(on)]) == {CARRIES}
    on.step(300)
    assert record(on) == 200
    assert set(on.state["state"][members(on)]) == {ARRIVED}
    np.testing.assert_allclose(on.discs[0].place, [1.2, 0.5], atol=1e-3)


def test_cells_belong_to_it_while_they_are_in_its_circle_and_one_record_is_handed_on():
    on = floor(EAST)
    for _ in range(20):
        on.step(10)
        own = members(on)
        away = np.hypot(*(on.cells.position_m - reference(on)).T)
        edge = 6 * 0.2 * PERIOD_S  # of the periods that a message takes to the rim
        assert own[away <= 0.3 - edge].all()
        assert not own[away > 0.3 + edge].any()
        assert np.ptp(on.state["periods"][own]) <= 5  # hops across half of it


def test_wheels_turn_where_the_parcel_is_sensed_and_the_requested_number_of_cells_ahead():
    for ahead in (1, 2):
        on = floor(EAST, ahead=ahead)
        on.step(100)
        sensed = np.flatnonzero(on.under(on.discs[0]))
        row, column = on.lattice.rows, on.lattice.columns
        steps = abs(row[:, None] - row[sensed]) + abs(column[:, None] - column[sensed])
        awake = members(on) & (steps.min(axis=1) <= ahead)
        np.testing.assert_array_equal(on.drive.any(axis=1), awake)


def test_a_wheel_drives_the_rigid_motion_and_draws_to_the_reference():
    turned = {
        **EAST,
        "angle_rad": 0.5,
        "legs": [{"to_m": [0.4, 0.5001], "turn_rad": 1.0}],
        "turn_rate_rad_s": 0.2,
    }
    on = floor(turned, centring_per_s=[0.4, 1.0])
    on.step(3)
    angle = 0.5 + 0.2 * 2 * PERIOD_S
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    d = on.cells.position_m[on.lattice.index((6, 4))] - [0.4, 0.5 + 2 * PERIOD_S * 0.0001 / 5.0]
    wanted = (
        np.array([0.0, 0.0001 / 5.0])
        + 0.2 * np.array([-d[1], d[0]])
        - turn @ np.diag([0.4, 1.0]) @ turn.T @ d
    )
    np.testing.assert_allclose(on.drive[on.lattice.index((6, 4))], wanted, atol=1e-12)


def test_without_its_parcel_it_waits_says_so_and_goes_on_when_it_is_back():
    on = floor(EAST)
    on.step(50)
    (parcel,) = on.discs
    on.discs.clear()
    on.step(1)
    at = record(on)
    on.step(20)
    assert record(on) == at
    assert not on.drive.any()
    assert set(on.state["state"][members(on)]) == {WAITS}
    on.discs.append(parcel)
    on.step(400)
    assert set(on.state["state"][members(on)]) == {ARRIVED}
    np.testing.assert_allclose(parcel.place, [1.2, 0.5], atol=1e-3)


def test_it_does_not_leave_a_parcel_that_is_held_back():
    """Only cells near the reference pace it: it stops when none of those is over the parcel any more."""
    on = floor(EAST)
    for _ in range(300):
        on.step(1)
        on.discs[0].place = np.array([0.4, 0.5])
    assert reference(on)[0] - 0.4 <= 0.15 + 0.16  # ``hold_m``, and the parcel's radius
    assert set(on.state["state"][members(on)]) == {WAITS}


def test_cells_that_are_cut_off_from_the_core_stop_within_the_hops_across():
    """All cells that can pace it die: no one adds to the record, and nobody goes on believing in it."""
    on = floor(EAST)
    on.step(50)
    on.dead |= np.hypot(*(on.cells.position_m - reference(on)).T) <= 0.15
    on.step(2 * 6 + 4 + 12)  # from 2 · ceil(2 · 0.3 / 0.1) down to 0, and a word counts for four periods
    assert not members(on).any()
    assert not on.drive.any()


@pytest.mark.parametrize("loss", [0.05, 0.2, 0.5])
def test_lost_messages_cost_time_and_nothing_else(loss: float):
    chance = np.random.default_rng(5)
    on = floor(EAST)
    on.step(500, lambda shape: chance.uniform(size=shape) < loss)
    assert set(on.state["state"][members(on)]) == {ARRIVED}
    np.testing.assert_allclose(on.discs[0].place, [1.2, 0.5], atol=2e-3)


def test_dead_cells_on_the_path_are_passed_as_long_as_some_are_alive():
    on = floor(EAST)
    chance = np.random.default_rng(11)
    on.dead = chance.uniform(size=len(on.lattice)) < 0.2
    on.step(600)
    assert set(on.state["state"][members(on)]) == {ARRIVED}
    assert abs(on.discs[0].place - [1.2, 0.5]).max() < 0.05


def test_a_cell_that_forgets_at_the_start_does_not_begin_the_journey_again():
    on = floor(EAST)
    on.step(190)
    at = on.lattice.index((5, 4))
    on.forget(at)
    on.discs.append(Disc(np.array([0.4, 0.5])))  # another parcel, which is nobody's
    on.step(1)
    assert on.state["vehicle"][at] == 1  # it believes that it all begins
    on.step(3)
    assert on.state["vehicle"][at] == 0
    assert on.state["periods"][at, 0] > 100
    on.step(50)
    np.testing.assert_allclose(on.discs[1].place, [0.4, 0.5], atol=1e-3)


# --- several ------------------------------------------------------------------------------------------------

NORTH = {"start_m": [0.8, 0.1], "radius_m": 0.2, "speed_m_s": 0.2, "legs": [{"to_m": [0.8, 1.4]}]}
ACROSS = {"start_m": [0.2, 0.7], "radius_m": 0.2, "speed_m_s": 0.2, "legs": [{"to_m": [1.4, 0.7]}]}


@pytest.mark.parametrize(("first", "second"), [(ACROSS, NORTH), (NORTH, ACROSS)])
def test_where_two_paths_cross_the_later_named_yields_and_both_arrive(first: Any, second: Any):
    on = floor(first, second, rows=16, columns=17, ahead=2)
    nearest, yielded = 9.0, [False, False]
    for _ in range(200):
        on.step(5)
        nearest = min(nearest, float(np.hypot(*(reference(on, 0) - reference(on, 1)))))
        for v in (0, 1):
            yielded[v] |= bool((on.state["state"][members(on, v)] == GIVES_WAY).any())
    assert yielded == [False, True]
    assert nearest > 0.4
    for v, vehicle in enumerate((first, second)):
        assert set(on.state["state"][members(on, v)]) == {ARRIVED}
        np.testing.assert_allclose(on.discs[v].place, vehicle["legs"][0]["to_m"], atol=2e-3)


def test_two_that_come_towards_each_other_stop_and_say_so():
    west = {**EAST, "start_m": [1.3, 0.5], "legs": [{"to_m": [0.2, 0.5]}]}
    on = floor(EAST, west)
    on.step(500)
    for v in (0, 1):
        assert (on.state["state"][members(on, v)] == GIVES_WAY).all()
    assert np.hypot(*(reference(on, 0) - reference(on, 1))) > 0.4
    assert np.hypot(*(on.discs[0].place - on.discs[1].place)) > 0.4


@pytest.mark.parametrize("shards", [2, 23])
def test_vehicles_are_the_same_to_the_last_bit_however_the_array_is_cut(
    grid: Callable[..., Lattice], run: Callable[..., Any], shards: int
):
    lattice = grid(8, 9, missing=[(3, 4)])
    chance = np.random.default_rng(2)
    place = np.stack((lattice.columns, lattice.rows), axis=1) * PITCH_M
    presence = np.hypot(*(place - [0.35, 0.3]).T)[None, :, None] < chance.uniform(0.1, 0.4, (30, 1, 1))
    firmware = vehicles(
        {"start_m": [0.2, 0.3], "radius_m": 0.2, "legs": [{"to_m": [0.6, 0.5], "turn_rad": 1.0}]},
        {"start_m": [0.7, 0.6], "radius_m": 0.15, "legs": [{"turn_rad": -1.0}, {"to_m": [0.5, 0.4]}]},
    )
    whole = run(firmware, Partition.even(lattice, 1), 30, presence=presence).drives
    cut = run(firmware, Partition.even(lattice, shards), 30, presence=presence).drives
    assert whole.any()
    assert cut.tobytes() == whole.tobytes()


# --- what is refused ------------------------------------------------------------------------------------------


def test_a_journey_over_a_hole_that_no_cell_could_hold_is_refused():
    lattice = Lattice((0, column) for column in range(12) if column not in (5, 6, 7))
    place = np.stack((lattice.columns, lattice.rows), axis=1) * PITCH_M
    firmware = vehicles({**EAST, "start_m": [0.2, 0.0], "legs": [{"to_m": [1.0, 0.0]}]})
    with pytest.raises(ParametersError) as caught:
        firmware.check_geometry(lattice, place, PITCH_M)
    (problem,) = caught.value.problems
    assert problem.path == ("vehicles", 0)
    assert problem.message == "leads to (0.56, 0) m, where no cell is near enough to hold the vehicle"


def test_two_vehicles_may_not_begin_in_one_place():
    with pytest.raises(ParametersError, match=r"vehicles\[1\]: begins within the circle of vehicles\[0\]"):
        floor(EAST, {**EAST, "start_m": [0.7, 0.5]})
