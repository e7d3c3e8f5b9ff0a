"""Single questions of the kernels that find and join crossings, put to them by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from plant.kernels.common import capture, events, layout
from plant.kernels.common.roots import NONE
from plant.kernels.common.surface import Surface
from plant.plant import Plant
from tests.plant.scenes import cells_of, parcel, spec

CAPTURE_M = 1e-6


@njit(error_model="numpy")
def _join(surface, body, work, c, s):  # type: ignore[no-untyped-def]
    return capture.join_last(surface, body, work, c, s)


@njit(error_model="numpy")
def _side(surface, body, work, group, i, c, s):  # type: ignore[no-untyped-def]
    return capture.side_in(surface, body, work, group, i, c, s)


@njit(error_model="numpy")
def _entry(ser, order, normal, offset, outside, px, py, curve, zero, end, g, p, start):  # type: ignore[no-untyped-def]
    return events.entry(ser, order, normal, offset, outside, px, py, curve, zero, end, g, p, start)


def _square(x: float) -> tuple[Plant, Surface]:
    """A square of 0.5 m at (x, 0); at x = 0 its edges lie on columns and rows of cells."""
    body = parcel(size_m=(0.5, 0.5), position_m=(x, 0.0), angle_rad=0.0)
    plant = Plant(spec(body, capture_m=CAPTURE_M))
    still = np.zeros((len(plant.array), 2))
    return plant, Surface(plant.array.positions_m, plant.array.grid, still, still, plant._moves.driven)


def _edge(plant: Plant, nx: float) -> int:
    return int(np.argmax(nx * plant._solver.parcels[0].normal[:, 0]))


@pytest.mark.parametrize(
    ("past_m", "speed", "joins"),
    [(0.5e-6, 0.1, True), (-0.5e-6, 0.1, True), (2e-6, 0.1, False), (0.5e-6, -0.1, False)],
    ids=["just in", "all but in", "too deep", "on its way back"],
)
def test_a_cell_joins_the_next_crossing_within_capture_m_of_its_edge_and_still_approaching(
    past_m: float, speed: float, joins: bool
) -> None:
    plant, surface = _square(past_m)
    body, work = plant._solver.parcels[0], plant._solver.workspace(0).work
    body.y[layout.UX] = speed
    (cell,) = cells_of(plant, [(10, 12)])
    work.last[0] = cell, _edge(plant, 1.0), 1
    body.ctl[layout.N_LAST], body.ctl[layout.N_CROSSED] = 1, 0
    assert bool(_join(surface, body, work, 1.0, 0.0)) is joins
    assert body.ctl[layout.N_CROSSED] == joins
    if joins:
        assert (work.cells[0], work.signs[0]) == (cell, 1)


def test_of_two_edges_of_one_group_a_cell_on_the_opposite_one_is_under_the_parcel_on_the_near_side() -> None:
    """What takes the parcel in over the one takes it off the other."""
    plant, surface = _square(0.0)
    body, work = plant._solver.parcels[0], plant._solver.workspace(0).work
    # the far side, a cell on the right edge being under the parcel, pulls the parcel back to the left
    work.reply[:3, 0], work.matrix[0, 0] = (-1.0, 0.0, 0.0), -1.0
    work.cells[:2] = cells_of(plant, [(8, 12), (8, 7)])
    work.edges[:2] = _edge(plant, 1.0), _edge(plant, -1.0)
    assert [_side(surface, body, work, 0, i, 1.0, 0.0) for i in (0, 1)] == [1, -1]


@pytest.mark.parametrize(("bend", "enters"), [(0.0, True), (0.03, True), (0.1, False)])
def test_a_cell_is_not_let_in_over_one_edge_where_a_bent_path_has_taken_it_out_over_the_next(
    bend: float, enters: bool
) -> None:
    """At the start the next edge is 0.01 m away, and not moving: only its second rate tells."""
    ser = np.zeros((layout.SER_ROWS, layout.SER_COLUMNS))
    ser[layout.S_C, 0] = 1.0
    ser[layout.S_E1, 1], ser[layout.S_E2, 2] = 0.2, -bend
    normal, offset = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]), np.full(4, 0.3)
    g, p, start = np.zeros((3, layout.SER_COLUMNS))
    # to the right of the parcel by 0.1 m, half a step's way: over its edge the cell comes at one half
    time, edge = _entry(ser, 2, normal, offset, 0.0, 0.4, 0.29, 1.000001 * bend, 1e-15, 1.0, g, p, start)
    if enters:
        assert (time, edge) == (pytest.approx(0.5, abs=1e-15), 0)
    else:
        assert time == NONE
