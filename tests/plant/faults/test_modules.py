"""Cells pulled out of the array and plugged in again, under parcels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from plant.effects.analogue_sensors.spec import AnalogueSensorsSpec
from plant.effects.contact_width import ContactWidthSpec
from plant.effects.motors import MotorsSpec
from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.effects.registry import PlantEffects
from plant.faults.base import WheelFaults
from plant.friction.coulomb_sliding import CoulombSliding
from plant.observations import Event
from plant.plant import Plant
from plant.sampling import Timing
from plant.solver_specs import ImplicitSpec
from plant.specs import PlantSpec
from tests.plant.scenes import (
    SECOND,
    TICK_NS,
    Floats,
    cells_of,
    elliptic,
    loads,
    members,
    parcel,
    solved,
    spec,
)

SOLVERS: dict[str, dict[str, object]] = {
    "exact": {"name": "exact"},
    "implicit": {"name": "implicit"},
    "rk4": {"name": "fixed_step", "step_s": 1e-3},
    "quasi_static": {"name": "quasi_static"},
    "scipy": {"name": "scipy", "method": "RK45", "tolerance": 1e-8},
    "heyoka": {"name": "heyoka"},
}
HOLES = [(9, 9), (10, 12), (12, 11), (13, 13), (14, 14), (9, 13), (11, 15), (15, 16)]
"""Cells under the parcel, at the start or on its way."""


@pytest.fixture(params=SOLVERS)
def solver(request: pytest.FixtureRequest) -> dict[str, object]:
    if request.param in ("heyoka", "scipy"):
        pytest.importorskip(request.param)
    return SOLVERS[request.param]


def pull(plant: Plant, cells: Sequence[tuple[int, int]], drives: Floats | None = None) -> None:
    """These cells, and no others, are not in the array from now on."""
    wheel_faults = WheelFaults.healthy(len(plant.array))
    wheel_faults.gone[cells_of(plant, cells)] = True
    plant.apply_faults(wheel_faults, np.zeros((len(plant.array), 2)) if drives is None else drives)


def named(events: Sequence[Event]) -> list[tuple[float, str, tuple[tuple[int, int], ...]]]:
    return [(event.time_s, event.kind, event.cells) for event in events]


def test_an_array_whose_cells_were_pulled_at_the_start_is_one_that_never_had_them(
    solver: dict[str, object],
) -> None:
    pulled, never = solved(solver, parcel()), solved(solver, parcel(), missing=HOLES)
    pull(pulled, HOLES)
    reported = [plant.advance(elliptic(plant), SECOND)[1] for plant in (pulled, never)]
    assert pulled.state == pytest.approx(never.state, abs=1e-12)
    assert not pulled.sense().presence[cells_of(pulled, HOLES)].any()
    there = cells_of(pulled, never.array.lattice.cells)
    assert np.array_equal(pulled.sense().presence[there], never.sense().presence)
    lost = [event for event in reported[0] if event.time_s == 0.0]
    assert {(event.kind, event.cells[0] in HOLES) for event in lost} == {("support_lost", True)}
    later = [(event.kind, event.cells) for event in reported[0] if event.time_s > 0.0]
    assert later == [(event.kind, event.cells) for event in reported[1]]
    assert pulled.support_changes == never.support_changes + len(lost)


def test_a_cell_pulled_and_plugged_in_at_one_instant_leaves_no_trace_on_the_motion(
    solver: dict[str, object],
) -> None:
    plain, meddled = solved(solver, parcel()), solved(solver, parcel())
    for plant in (plain, meddled):
        plant.advance(elliptic(plant), SECOND // 4)
    under = plain.array.lattice.cells[int(members(plain)[0])]
    pull(meddled, [under], elliptic(meddled))
    pull(meddled, [], elliptic(meddled))
    _, events = meddled.advance(elliptic(meddled), SECOND // 2)
    plain.advance(elliptic(plain), SECOND // 2)
    assert meddled.state == pytest.approx(plain.state, abs=1e-6)
    assert named(events)[:2] == [(0.25, "support_lost", (under,)), (0.25, "support_gained", (under,))]


def test_loads_are_those_of_the_cells_that_are_left() -> None:
    plant = solved({"name": "exact"}, parcel(size_m=(0.16, 0.16), position_m=(0.0, 0.0), angle_rad=0.0))
    under = [(9, 9), (9, 10), (10, 9), (10, 10)]
    pull(plant, [(10, 10)])
    plant.advance(np.zeros((400, 2)), TICK_NS)
    cells, share = loads(plant)
    assert dict(zip(cells.tolist(), share.tolist(), strict=True)) == pytest.approx(
        dict(zip(cells_of(plant, under[:3]), (0.0, 0.5, 0.5), strict=True)), abs=1e-12
    )


def test_a_parcel_tips_at_once_where_its_supports_are_pulled(solver: dict[str, object]) -> None:
    plant = solved(solver, parcel(size_m=(0.16, 0.16), position_m=(0.01, 0.0), angle_rad=0.0))
    plant.advance(np.zeros((400, 2)), SECOND // 10)
    pull(plant, [(9, 10), (10, 10)])
    _, events = plant.advance(np.zeros((400, 2)), SECOND // 5)
    assert [kind for _, kind, _ in named(events)] == ["support_lost", "support_lost", "tipped"]
    assert events[-1].time_s == 0.1
    assert set(events[-1].cells) == {(9, 9), (10, 9)}
    assert plant.status[0].state == "tipped"


@pytest.mark.parametrize(("columns", "outcome"), [((1,), "tipped"), ((1, 2, 3), "off_array")])
def test_a_parcel_falls_off_where_no_cell_is_left_beyond_its_edge(
    columns: Sequence[int], outcome: str
) -> None:
    body = parcel(size_m=(0.16, 0.16), position_m=(-0.09, 0.0), angle_rad=0.0)
    plant = solved({"name": "exact"}, body, rows=2, columns=4)
    pull(plant, [(row, column) for row in (0, 1) for column in columns])
    _, events = plant.advance(np.zeros((8, 2)), TICK_NS)
    assert (events[-1].kind, set(events[-1].cells)) == (outcome, {(0, 0), (1, 0)})


def test_a_parcel_with_nothing_under_it_is_off_the_array() -> None:
    plant = solved({"name": "exact"}, parcel(size_m=(0.16, 0.16), position_m=(0.0, 0.0), angle_rad=0.0))
    pull(plant, [(9, 9), (9, 10), (10, 9), (10, 10)])
    _, events = plant.advance(np.zeros((400, 2)), TICK_NS)
    assert (events[-1].kind, plant.status[0].state) == ("off_array", "off_array")


def test_wheels_of_a_pulled_cell_stand_and_start_again_from_rest() -> None:
    motors = MotorsSpec(time_constant_s=0.06)
    plant = Plant(spec(parcel(), motors=motors))
    volts = np.full((400, 2), 5.0)
    plant.advance(volts, SECOND // 10)
    (cell,) = cells_of(plant, [(2, 2)])
    read = plant.sense().encoder_m
    assert read is not None
    pull(plant, [(2, 2)], volts)
    assert plant.wheel_speed[cell].tolist() == [0.0, 0.0]
    sense, _ = plant.advance(volts, SECOND // 5)
    assert sense.encoder_m is not None
    assert np.array_equal(sense.encoder_m[cell], read[cell])
    pull(plant, [], volts)
    plant.advance(volts, SECOND // 5 + 60_000_000)
    assert plant.wheel_speed[cell] == pytest.approx(-0.5 * np.expm1(-1.0), rel=1e-12)


def test_a_pulled_cell_senses_nothing_whatever_it_has_for_sensors() -> None:
    effects = PlantEffects(analogue_sensors=AnalogueSensorsSpec(spot_radius_m=0.02))
    plant = Plant(PlantSpec.model_validate(dict(spec(parcel())) | {"effects": effects}))
    under = members(plant)[:2]
    cells = [plant.array.lattice.cells[int(cell)] for cell in under]
    before = plant.sense()
    assert before.presence[under].all()
    pull(plant, cells)
    for sense in (plant.last_readings, plant.sense()):
        assert not sense.presence[under].any()
        assert sense.level is not None
        assert np.all(sense.level[under] == 0.0)
        others = np.delete(np.arange(400), under)
        assert np.array_equal(sense.presence[others], before.presence[others])
    pull(plant, [])
    assert np.array_equal(plant.last_readings.presence, before.presence)


def test_cells_that_read_at_instants_of_their_own_read_nothing_while_they_are_removed() -> None:
    plant = Plant(spec(parcel()))
    under, reads_ns = members(plant)[:2], np.full(400, -1)
    timing = Timing(np.full(400, -1), reads_ns)
    pull(plant, [plant.array.lattice.cells[int(under[0])]])
    sense, _ = plant.advance(np.zeros((400, 2)), TICK_NS, timing)
    assert sense.presence[under, 0].tolist() == [False, True]
    pull(plant, [])
    # nobody reads: one that is plugged in knows what was there as it came
    sense, _ = plant.advance(np.zeros((400, 2)), 2 * TICK_NS, timing)
    assert sense.presence[under, 0].tolist() == [True, True]


def test_a_law_of_sliding_wheels_takes_pulled_cells_for_missing_ones() -> None:
    law = CoulombSliding(law="coulomb_sliding", coefficient=0.2)
    pulled, never = solved({"name": "exact"}, law=law), solved({"name": "exact"}, law=law, missing=HOLES)
    pull(pulled, HOLES)
    for plant in (pulled, never):
        plant.advance(elliptic(plant), SECOND // 4)
    assert pulled.state == pytest.approx(never.state, abs=1e-12)


@pytest.mark.parametrize(
    "effects",
    [
        pytest.param(PlantEffects(contact_width=ContactWidthSpec(width_m=0.03)), marks=pytest.mark.slow),
        PlantEffects(parcel_contact=ParcelContactSpec(mode="resolved")),
    ],
    ids=["contact_width", "parcel_contact"],
)
def test_with_effects_too_pulled_cells_are_as_missing_ones(effects: PlantEffects) -> None:
    bodies = parcel(), parcel(position_m=(-0.2, 0.5), angle_rad=0.2)
    still: list[Floats] = []
    for missing in ([], HOLES):
        base = spec(*bodies, missing=missing)
        solver = ImplicitSpec(name="implicit", step_s=1e-3)
        plant = Plant(PlantSpec.model_validate(dict(base) | {"effects": effects, "solver": solver}))
        if not missing:
            pull(plant, HOLES)
        plant.advance(elliptic(plant), SECOND // 4)
        still.append(plant.state)
    assert still[0] == pytest.approx(still[1], abs=1e-12)
