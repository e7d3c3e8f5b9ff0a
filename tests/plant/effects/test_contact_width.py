"""Wheels with a width: their share of the load by hand, and the captured motion as they become points."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from plant.kernels.common import layout
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.laws import VISCOUS
from tests.plant.scenes import SECOND, Floats, G, elliptic, parcel, solved, spec

pytestmark = pytest.mark.slow

CHATTERS = parcel(size_m=(0.68, 0.42))
"""It meets 60,958 support changes in 20 s where each is located, and rests with a cell on its edge."""


def wide(
    width_m: float,
    body: ParcelSpec,
    effects: dict[str, object] | None = None,
    solver: dict[str, object] | None = None,
    **array: object,
) -> Plant:
    """A plant under the viscous law whose wheels have a width."""
    values = dict(spec(body, **array))  # type: ignore[arg-type]
    values |= {
        "friction": VISCOUS,
        "solver": solver or {"name": "implicit", "tolerance": 1e-9},
        "effects": {"contact_width": {"width_m": width_m}} | (effects or {}),
    }
    return Plant(PlantSpec.model_validate(values))


def members_in_order(plant: Plant) -> list[int]:
    """Cells that the plant takes to lie under its parcel, as its kernels list them."""
    inner = plant._solver.parcels[0]
    return inner.mem[: inner.ctl[layout.N_MEMBERS], layout.CELL].tolist()


def row_of_three(outer: float, effects: dict[str, object] | None = None) -> Floats:
    """Load shares of three cells in a row under a parcel whose ends are ``outer`` beyond the outer cells' middles."""
    body = parcel(size_m=(0.2 + 2.0 * outer, 0.09), position_m=(0.0, 0.0), angle_rad=0.0)
    shares = []
    for cell in range(3):
        # seen from outside: what one wheel gives a parcel at rest
        fresh = wide(0.04, body, effects, rows=1, columns=3)
        drives = np.zeros((3, 2))
        drives[cell] = (1.0, 0.0)
        fresh.advance(drives, 1000)
        shares.append(fresh.state[0, 3] / (0.2 * G * 1e-6))
    return np.array(shares)


@pytest.mark.parametrize(
    ("outer", "part"), [(0.0, 0.5), (0.01, 27.0 / 32.0), (-0.01, 5.0 / 32.0), (0.02, 1.0)]
)
def test_a_cell_carries_in_proportion_to_how_far_its_wheel_is_under_the_parcel(
    outer: float, part: float
) -> None:
    # u = 1/2 + d / width counts by u^2 (3 - 2 u)
    known = np.array([part, 1.0, part]) / (1.0 + 2.0 * part)
    assert row_of_three(outer) == pytest.approx(known, abs=1e-5)


def test_a_wheel_beyond_a_corner_counts_by_both_edges() -> None:
    """One 0.055 m beyond the corner of a square on its point, farther than half a width, is 0.039 m outside both."""
    corner = 0.2 * np.sqrt(2.0)
    place = (0.35 - 0.055 - corner, 0.05)
    plant = wide(0.1, parcel(size_m=(0.4, 0.4), position_m=place, angle_rad=0.25 * np.pi))
    plant.advance(np.zeros_like(plant.array.positions_m), 1)
    (cell,) = np.flatnonzero(np.all(np.abs(plant.array.positions_m - (0.35, 0.05)) < 1e-9, axis=1))
    listed = members_in_order(plant)
    assert cell in listed
    u = 0.5 - 0.055 / np.sqrt(2.0) / 0.1
    share = plant._solver._edges.share[0][listed.index(cell)]  # type: ignore[attr-defined]
    assert share == pytest.approx((u * u * (3.0 - 2.0 * u)) ** 2, rel=1e-6)


def test_no_wheel_that_a_corner_just_brushes_is_missed() -> None:
    """The parcel moves as its wheels do: steps are long, and a wheel's edge is under the corner for 40 microseconds."""
    width, clipped, speed = 1e-3, 1e-5, 0.5
    tip = 0.2 * np.sqrt(2.0) + 0.5 * width * np.sqrt(2.0)
    place = (0.02, 0.55 - tip + clipped)
    body = parcel(size_m=(0.4, 0.4), position_m=place, angle_rad=0.25 * np.pi, velocity_m_s=(speed, 0.0))
    plant = wide(width, body, solver={"name": "implicit", "tolerance": 1e-4})
    _, events = plant.advance(np.tile((speed, 0.0), (400, 1)), SECOND // 2)
    for cell in np.flatnonzero(np.abs(plant.array.positions_m[:, 1] - 0.55) < 1e-9).tolist():
        middle = (plant.array.positions_m[cell, 0] - place[0]) / speed
        if 0.0 < middle < 0.5:
            found = [(event.kind, event.time_s) for event in events if divmod(cell, 20) in event.cells]
            known = [("support_gained", middle - clipped / speed), ("support_lost", middle + clipped / speed)]
            assert [kind for kind, _ in found] == [kind for kind, _ in known]
            assert [time for _, time in found] == pytest.approx([time for _, time in known], abs=1e-9)


def test_on_uneven_supports_width_and_height_count_together() -> None:
    # stiffness (1/2, 1, 1/2), the middle higher by h: its share is (1 + K h / W) / 2
    high = {"stiffness_n_per_m": 1e4, "cells": [{"cell": (0, 1), "height_m": 4e-4}]}
    middle = 0.5 * (1.0 + 1e4 * 4e-4 / (2.0 * G))
    known = [0.5 * (1.0 - middle), middle, 0.5 * (1.0 - middle)]
    assert row_of_three(0.0, {"uneven_supports": high}) == pytest.approx(known, abs=1e-5)


def test_as_wheels_become_points_the_motion_tends_to_the_captured_one_at_first_order() -> None:
    exact = Plant(spec(CHATTERS))
    wheels, widths = elliptic(exact), np.array([2e-3, 1e-3, 5e-4, 2.5e-4])
    # at 1e-9 m the chatter of the narrowest differs by a percent with the length of steps
    fine: dict[str, object] = {"name": "implicit", "tolerance": 1e-10}
    plants = [wide(width, CHATTERS, solver=fine) for width in widths]
    for time_s, bound in ((6, 0.25), (20, 1.0)):
        exact.advance(wheels, time_s * SECOND)
        off = []
        for plant in plants:
            plant.advance(wheels, time_s * SECOND)
            off.append(abs(plant.state[0, 2] - exact.state[0, 2]))
        slope = np.polyfit(np.log(widths), np.log(off), 1)[0]
        assert 0.9 < slope < 1.1
        assert np.all(off < bound * widths)
    # in a linear field the centre of mass moves alike on any springs
    for plant in plants:
        assert plant.state[0, :2] == pytest.approx(exact.state[0, :2], abs=1e-8)
        assert plant._solver.parcels[0].ctl[layout.N_STEPS] < 20_000


def test_fixed_steps_come_to_the_motion_of_implicit_sooner_than_on_wheels_that_are_points() -> None:
    """There each change is as wrong as its force jumps, whatever the method; here nothing jumps."""
    fine, points = wide(0.05, parcel()), Plant(spec(parcel()))
    for plant in (fine, points):
        plant.advance(elliptic(plant), SECOND // 2)
    assert min(fine.support_changes, points.support_changes) > 4
    settings = {"name": "fixed_step", "step_s": 1e-3}
    smooth, jumps = wide(0.05, parcel(), solver=settings), solved(settings, parcel())
    for plant in (smooth, jumps):
        plant.advance(elliptic(plant), SECOND // 2)
    off = np.abs(smooth.state - fine.state).max()
    assert off < 1e-7
    assert off < 0.01 * np.abs(jumps.state - points.state).max()


def test_without_inertia_too_a_cell_on_its_edge_carries_its_part_and_nothing_chatters() -> None:
    """The parcel comes to the angle at which ``implicit`` rests it."""
    plants = [wide(1e-2, CHATTERS), wide(1e-2, CHATTERS, solver={"name": "quasi_static", "tolerance": 1e-9})]
    for plant in plants:
        plant.advance(elliptic(plant), 30 * SECOND)
    slow, quasi = plants
    assert quasi.state[0, :3] == pytest.approx(slow.state[0, :3], abs=1e-6)
    # on wheels that are points its changes never end
    before = quasi.support_changes
    quasi.advance(elliptic(quasi), 60 * SECOND)
    assert before == quasi.support_changes < 200


def test_a_parcel_comes_to_rest_on_wheels_with_a_width_and_stays() -> None:
    plant = wide(1e-2, CHATTERS)
    plant.trajectory(elliptic(plant), 60 * SECOND, SECOND // 10)
    assert plant.status[0].state == "at_rest"
    before = plant.state[0]
    plant.advance(elliptic(plant), 120 * SECOND)
    assert plant.state[0] == pytest.approx(before, abs=1e-6)


def test_the_effect_is_refused_where_it_does_not_fit() -> None:
    values = dict(spec(CHATTERS))
    with pytest.raises(
        ValidationError,
        match=r"solver\.name exact leaves out effects\.contact_width; use implicit or fixed_step or quasi_static",
    ):
        PlantSpec.model_validate(values | {"effects": {"contact_width": {"width_m": 1e-3}}})
    with pytest.raises(ValidationError, match=r"width_m 0\.2: must be at most the array's pitch_m, 0\.1"):
        wide(0.2, CHATTERS)
