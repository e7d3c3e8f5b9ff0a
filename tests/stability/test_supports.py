"""Supports that determine too little, too much or nothing; parcels larger and smaller than what carries them."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from plant.array import CellArray
from plant.errors import PlantError
from plant.observations import Event
from plant.parcel_spec import ArraySpec
from plant.plant import Plant
from tests.plant.reference import is_least_norm
from tests.plant.scenes import MU, SECOND, TICK_NS, G, bench, elliptic, loads, members, parcel
from tests.stability.solvers import Claim, Solver, claiming

KAPPA = MU * G


def _balance(plant: Plant) -> tuple[float, float]:
    """By how much force (in weights) and moment (in weights times the farthest lever) are out of balance."""
    cells, share = loads(plant)
    lever = plant.array.positions_m[cells] - plant.state[0, :2]
    return abs(float(share.sum()) - 1.0), float(np.abs(share @ lever).max() / np.abs(lever).max())


def _triangle(plant: Plant) -> list[float]:
    """Shares of three supports: the barycentric coordinates of the centre of mass, in exact arithmetic."""
    cells, _ = loads(plant)
    corners = [[Fraction(float(v)) for v in plant.array.positions_m[cell]] for cell in cells]
    x = [Fraction(float(v)) for v in plant.state[0, :2]]

    def area(a: list[Fraction], b: list[Fraction], c: list[Fraction]) -> Fraction:
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    whole = area(*corners)
    parts = [area(*(x if i == k else corner for k, corner in enumerate(corners))) for i in range(3)]
    return [float(part / whole) for part in parts]


@claiming(Claim.LOADS)
@pytest.mark.parametrize("flat", [(1, 1, 2), (5, 3, 8), (13, 8, 21), (55, 34, 89)])
def test_three_supports_nearly_on_a_line_share_as_the_lever_rule_says(
    solver: Solver, flat: tuple[int, int, int]
) -> None:
    """H12, nearly deficient: cannon.js #274, GEOS PR #2970 (singular Jacobian); here down to a height of 1 in 11,000.

    The digits lost are those that the second moments' inverse must lose, the square of that.
    """
    # neighbouring Fibonacci numbers: triangles of half a pitch squared, however long
    a, b, c = flat
    cells = ((0, 0), (b, a), (a, c))
    size = max(max(cell) for cell in cells) + 1
    corners = np.array([(column, row) for row, column in cells], dtype=float)
    place = (np.array([0.2, 0.3, 0.5]) @ corners - 0.5 * (size - 1)) * 0.1
    body = parcel(size_m=(0.4 * size, 0.4 * size), position_m=(float(place[0]), float(place[1])))
    plant = solver.plant(body, rows=size, columns=size, cells=cells)
    cells_under, share = loads(plant)
    assert len(cells_under) == 3
    assert share == pytest.approx(_triangle(plant), abs=1e-16 * size**4)
    assert max(_balance(plant)) < 1e-16 * size**4


class BentArray(CellArray):
    """A row of cells whose middle one lies ``off_m`` beside it."""

    off_m = 0.0

    def __init__(self, spec: ArraySpec) -> None:
        super().__init__(spec)
        self.positions_m[len(self.positions_m) // 2, 1] += self.off_m


@claiming(Claim.LOADS)
@pytest.mark.parametrize("off_m", [1e-15, 1e-12, 1e-9, 1e-6, 1e-3])
def test_a_row_of_which_one_cell_is_a_hair_beside_it_carries_by_the_lever_rule(
    solver: Solver, off_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """H12, nearly deficient: 1e-9 m off a line of supports; one load is wanted, and the inverse has ten digits less."""
    monkeypatch.setattr(BentArray, "off_m", off_m)
    monkeypatch.setattr("plant.plant.CellArray", BentArray)
    # between the outer two, on their line: the third carries nothing where the three are a triangle
    body = parcel(size_m=(0.35, 0.05), position_m=(0.02, 0.0), angle_rad=0.0)
    plant = solver.plant(body, rows=1, columns=3)
    cells, share = loads(plant)
    assert cells.tolist() == [0, 1, 2]
    # what lies nearer than 1e-8 of the pitch is on the line: the moment about it is what that leaves out
    on_line = off_m <= 1e-9
    assert max(_balance(plant)) < 1e-12 + (off_m / 0.3 if on_line else 0.0)
    by_rule = [0.4, 0.0, 0.6] if not on_line else [1.0 / 3.0 - 0.1, 1.0 / 3.0, 1.0 / 3.0 + 0.1]
    assert share == pytest.approx(by_rule, abs=1e-8)
    plant.advance(np.zeros((3, 2)), SECOND)
    assert plant.status[0].state == "at_rest"


@claiming(Claim.LOADS)
@pytest.mark.parametrize(("beside_m", "stands"), [(0.0, True), (5e-10, True), (2e-9, False), (1e-6, False)])
@pytest.mark.parametrize("count", [1, 2, 7])
@pytest.mark.parametrize("slanting", [False, True], ids=["row", "diagonal"])
def test_supports_on_a_line_or_point_carry_what_stands_on_it_and_name_what_does_not(
    solver: Solver, slanting: bool, count: int, beside_m: float, stands: bool
) -> None:
    """H12, rank-deficient: consim #34 (four feet, not full rank); never a singular matrix, never a NaN.

    On a diagonal the sums that vanish on a row do so only to rounding.
    """
    cells = tuple((k if slanting else 0, k) for k in range(count))
    angle = np.pi / 4.0 if slanting else 0.0
    across = np.array([-np.sin(angle), np.cos(angle)])
    body = parcel(
        size_m=(0.15 * count + 0.02, 0.05),
        position_m=tuple((beside_m * across).tolist()),
        angle_rad=angle,
    )
    array = {"rows": count if slanting else 1, "columns": count, "cells": cells}
    if not stands:
        under = "one cell" if count == 1 else f"{count} cells"
        with pytest.raises(
            PlantError, match=f"would tip: its centre of mass lies outside the {under} under it"
        ):
            solver.plant(body, **array)
        return
    plant = solver.plant(body, **array)
    assert loads(plant)[1] == pytest.approx([1.0 / count] * count, abs=1e-8)
    plant.advance(np.zeros((count, 2)), 60 * SECOND)
    assert plant.status[0].state == "at_rest"
    _, events = plant.advance(np.tile(0.01 * across, (count, 1)), 61 * SECOND)
    assert events[-1].kind == "off_array"
    assert events[-1].time_s < 60.02
    assert np.all(np.isfinite(plant.state))


@claiming(Claim.LOADS, Claim.MOTION)
@pytest.mark.parametrize("outwards_m", [0.0, -1e-9, -1e-5])
def test_a_centre_of_mass_carried_along_the_very_rim_does_not_fall_off(
    solver: Solver, outwards_m: float
) -> None:
    """H12, where the supports' plane degenerates to their outermost row, all others lifted, over the whole way."""
    body = parcel(size_m=(0.52, 0.52), position_m=(-0.3, 0.95 + outwards_m), angle_rad=0.0)
    plant = solver.plant(body)
    _, events = plant.advance(np.tile((0.3, 0.0), (400, 1)), 2 * SECOND)
    assert plant.status[0].state == "moving"
    assert plant.state[0, 1] == pytest.approx(0.95 + outwards_m, abs=solver.within(1e-12, 2.0))
    assert plant.state[0, 2] == pytest.approx(0.0, abs=solver.within(1e-9, 2.0))
    assert "support_gained" in {event.kind for event in events}


@claiming(Claim.LOADS, Claim.MOTION)
def test_ten_thousand_supports_balance_and_move_as_one_parcel(solver: Solver) -> None:
    """H12, hyperstatic: ten thousand loads for three balances, in closed form."""
    body = parcel(size_m=(30.0, 30.0), position_m=(0.37, -0.21), angle_rad=0.3)
    plant = solver.plant(body, rows=100, columns=100)
    cells, share = loads(plant)
    assert len(cells) == 10_000
    places = plant.array.positions_m[cells]
    spread = float(np.sum(places[:, 0] ** 2))
    assert share == pytest.approx(1e-4 + places @ plant.state[0, :2] / spread, abs=1e-17)
    assert max(_balance(plant)) < 1e-12
    start = plant.state[0]
    plant.advance(elliptic(plant, -0.1, -0.2), SECOND)
    for axis, k in ((0, 0.1), (1, 0.2)):
        slow, fast = np.roots([1.0, KAPPA, KAPPA * k]).real
        way = start[axis] * (fast * np.exp(slow) - slow * np.exp(fast)) / (fast - slow)
        assert plant.state[0, axis] == pytest.approx(way, abs=solver.within(1e-12))


def _leaning(solver: Solver, x: float, speed: float) -> tuple[Plant, np.ndarray]:
    """A long parcel on two rows of five cells, its centre of mass at ``x``, carried at ``speed``."""
    body = parcel(size_m=(2.0, 0.15), position_m=(x, 0.0), angle_rad=0.0, velocity_m_s=(speed, 0.0))
    plant = solver.plant(body, rows=2, columns=5)
    return plant, np.tile((speed, 0.0), (10, 1))


LIFTS_AT = {0: 0.1, 1: 0.4 / 3.0, 2: 0.5 / 3.0}
"""Where the centre of mass is when a column's load vanishes: with four, five and three columns the plane ends there."""


@claiming(Claim.LOADS, Claim.EVENTS)
@pytest.mark.parametrize("ticked", [False, True])
def test_a_support_that_was_dropped_comes_back_where_it_was_dropped(solver: Solver, ticked: bool) -> None:
    """H12, negative loads: dropped for good, they leave the parcel leaning on two columns (FCLIB has such problems)."""
    plant, drives = _leaning(solver, 0.05, 0.1)
    for start, speed, kind in ((0.05, 0.1, "load_vanished"), (0.18, -0.1, "load_returned")):
        plant, drives = _leaning(solver, start, speed)
        events: list[Event] = []
        for until in range(TICK_NS, 1_300_000_000, TICK_NS) if ticked else [1_300_000_000]:
            events += plant.advance(drives, until)[1]
        assert [event.kind for event in events] == [kind] * 6
        assert sorted(event.cells[0] for event in events) == [(r, c) for r in (0, 1) for c in (0, 1, 2)]
        for event in events:
            place = start + speed * event.time_s
            assert place == pytest.approx(LIFTS_AT[event.cells[0][1]], abs=1e-10)
        plant.advance(drives, plant.time_ns)  # no further: finds the loads of this very instant
        cells, share = loads(plant)
        assert is_least_norm(plant.array.positions_m[cells], plant.state[0, :2], share) == ""


@claiming(Claim.MOTION)
def test_a_parcel_larger_than_the_array_moves_on_all_of_it(solver: Solver) -> None:
    """Larger than the array: one support set for ever, no edge ever near, the cells in its middle only."""
    body = parcel(size_m=(5.0, 4.0), position_m=(0.02, -0.03), angle_rad=0.4, angular_velocity_rad_s=0.5)
    plant = solver.plant(body, rows=3, columns=3)
    reference = bench(plant, elliptic(plant))
    expected = reference.run(plant.state[0], 2.0)
    _, events = plant.advance(elliptic(plant), 2 * SECOND)
    assert events == []
    assert len(members(plant)) == 9
    assert plant.state[0] == pytest.approx(expected, abs=solver.within(1e-11, 2.0))


@claiming(Claim.LOADS, Claim.REST, Claim.MOTION)
def test_a_parcel_smaller_than_the_pitch_is_carried_to_the_rim_of_its_only_cell(solver: Solver) -> None:
    """Smaller than the pitch: it stands on one cell exactly, tips off it at once, and not before the wheel turns."""
    plant = solver.plant(parcel(size_m=(0.05, 0.05), position_m=(0.0, 0.0)), rows=3, columns=3)
    plant.advance(np.zeros((9, 2)), HALF_A_MINUTE)
    assert plant.status[0].state == "at_rest"
    _, events = plant.advance(np.tile((0.1, 0.0), (9, 1)), 2 * HALF_A_MINUTE)
    (tip,) = events
    assert (tip.kind, tip.cells) == ("tipped", ((1, 1),))
    assert tip.time_s == pytest.approx(30.0, abs=1e-3)
    assert tip.position_m == pytest.approx((0.0, 0.0), abs=1e-8)


HALF_A_MINUTE = 30 * SECOND


@claiming(Claim.LOADS)
def test_a_parcel_smaller_than_the_pitch_between_cells_is_refused(solver: Solver) -> None:
    """Smaller than the pitch, and nothing under it."""
    with pytest.raises(PlantError, match="stands on nothing"):
        solver.plant(parcel(size_m=(0.05, 0.05), position_m=(0.05, 0.05)), rows=3, columns=3)


@claiming(Claim.LOADS, Claim.MOTION)
def test_a_parcel_crosses_a_hole_narrower_than_itself_as_in_the_plain_plant(solver: Solver) -> None:
    """Crossing a hole: supports lift at the gap, and the motion is that of the reference."""
    hole = tuple((r, c) for r in range(20) for c in (9, 10))
    body = parcel(size_m=(0.69, 0.25), position_m=(-0.4, 0.02), angle_rad=0.05)
    plant = solver.plant(body, missing=hole, solver=solver.located)
    drives = np.tile((0.5, 0.0), (len(plant.array), 1))
    reference = bench(plant, drives)
    expected = reference.run(plant.state[0], 1.6)
    _, events = plant.advance(drives, 1_600_000_000)
    assert plant.status[0].state == "moving"
    assert plant.state[0, 0] > 0.0
    assert "load_vanished" in {event.kind for event in events}
    if solver.claims(Claim.EVENTS):
        assert len(events) == len(reference.events)
    assert plant.state[0] == pytest.approx(expected, abs=solver.within(1e-9, 1.6))
