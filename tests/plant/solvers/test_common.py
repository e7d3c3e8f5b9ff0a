"""What holds of every solver that is there to compare with ``exact``: same scenes, same names, same ends."""

from __future__ import annotations

import numpy as np
import pytest

from plant.effects.motors import MotorsSpec
from plant.errors import PlantUnstable
from plant.plant import Plant
from tests.plant.scenes import SECOND, TICK_NS, Floats, cells_of, elliptic, parcel, solved, spec
from tests.plant.test_laws import drive

BODY = parcel(position_m=(0.05, 0.03), angle_rad=0.4, velocity_m_s=(0.1, -0.05), angular_velocity_rad_s=0.5)
OFF_THE_EDGE = parcel(position_m=(0.6, 0.0), angle_rad=0.0, velocity_m_s=(1.0, 0.0))
GAP = [(row, column) for row in range(20) for column in (18, 19)]

SOLVERS: dict[str, dict[str, object]] = {
    "euler": {"name": "fixed_step", "method": "euler", "step_s": 1e-5},
    "rk4": {"name": "fixed_step", "step_s": 1e-4},
    "scipy": {"name": "scipy", "method": "RK45", "tolerance": 1e-10},
    "heyoka": {"name": "heyoka", "tolerance": 1e-12},
}
OFF = {"euler": 1e-5, "rk4": 1e-5, "scipy": 1e-8, "heyoka": 1e-10}
"""How far any entry of the state may be off."""


@pytest.fixture(params=SOLVERS)
def name(request: pytest.FixtureRequest) -> str:
    if request.param == "heyoka":
        pytest.importorskip("heyoka")
    return request.param


def test_motors_and_coasting_cells_are_those_of_the_exact_solver(name: str) -> None:
    motors = MotorsSpec(time_constant_s=0.05)
    ends: list[Floats] = []
    for plant in (Plant(spec(BODY, motors=motors)), solved(SOLVERS[name], BODY, motors=motors)):
        plant.release_wheels(cells_of(plant, [(9, 9), (10, 11)]), "coast")
        volts = 10.0 * elliptic(plant)
        for tick in range(1, 101):
            plant.advance(volts if tick < 50 else -volts, tick * TICK_NS)
        ends.append(plant.state[0])
    assert ends[1] == pytest.approx(ends[0], abs=OFF[name])


def test_a_trajectory_passes_through_the_states_of_ticks(name: str) -> None:
    whole, ticks = solved(SOLVERS[name], BODY), solved(SOLVERS[name], BODY)
    trajectory = whole.trajectory(elliptic(whole), 60 * TICK_NS, TICK_NS)
    for tick in range(1, 61):
        ticks.advance(elliptic(ticks), tick * TICK_NS)
        assert trajectory.state[tick, 0] == pytest.approx(ticks.state[0], abs=1e-9)
    assert whole.support_changes == ticks.support_changes >= 5


def test_presence_and_events_are_those_of_the_exact_solver(name: str) -> None:
    outcomes = []
    for plant in (Plant(spec(parcel())), solved(SOLVERS[name], parcel())):
        sense, events = plant.advance(elliptic(plant), SECOND // 2)
        outcomes.append((sense.presence.tolist(), [(event.kind, event.cells) for event in events]))
    assert outcomes[0] == outcomes[1]
    assert len(outcomes[0][1]) > 10


def test_a_parcel_does_not_change_another_s_bits_and_the_same_scene_gives_the_same_bytes(name: str) -> None:
    other = parcel(position_m=(-0.6, -0.6), angle_rad=0.1)
    states = []
    for bodies in ((BODY,), (BODY, other), (BODY, other)):
        plant = solved(SOLVERS[name], *bodies)
        plant.advance(elliptic(plant), SECOND // 5)
        states.append(plant.state)
    assert np.array_equal(states[0][0], states[1][0])
    assert states[1].tobytes() == states[2].tobytes()


def test_a_parcel_tips_where_and_when_it_does_with_the_exact_solver(name: str) -> None:
    outcomes = []
    for plant in (
        Plant(spec(OFF_THE_EDGE, missing=GAP)),
        solved(SOLVERS[name], OFF_THE_EDGE, missing=GAP),
    ):
        plant.advance(drive(plant, 1.0), SECOND)
        outcomes.append((plant.status[0], plant.state[0]))
    (known, place), (status, ended) = outcomes
    assert known.state == "off_array"
    assert (status.state, status.detail) == (known.state, known.detail)
    assert status.time_s == pytest.approx(known.time_s, abs=2e-4)
    assert ended == pytest.approx(place, abs=2e-4)


def test_a_parcel_on_a_single_row_of_cells_stands_until_the_row_ends(name: str) -> None:
    body = parcel(size_m=(0.25, 0.08), position_m=(0.0, 0.0), angle_rad=0.0, velocity_m_s=(1.0, 0.0))
    array = {"rows": 1, "columns": 5}
    outcomes = []
    for plant in (Plant(spec(body, **array)), solved(SOLVERS[name], body, **array)):
        plant.advance(drive(plant, 1.0), SECOND)
        outcomes.append((plant.status[0].state, plant.status[0].detail, plant.status[0].time_s))
    assert outcomes[0][2] == pytest.approx(0.2, abs=1e-6)
    assert outcomes[1][:2] == outcomes[0][:2]
    assert outcomes[1][2] == pytest.approx(outcomes[0][2], abs=2e-4)


def test_a_blow_up_ends_the_run_and_says_where_and_when(name: str) -> None:
    plant = solved(SOLVERS[name])
    wheels = elliptic(plant)
    plant.advance(wheels, SECOND // 4)
    wheels[plant._solver.covered_cells(0)[3]] = np.nan
    with pytest.raises(
        PlantUnstable, match=r"parcel 0 at t = 0\.25 s, x = \S+ m, y = \S+ m: the motion is no longer finite"
    ):
        plant.advance(wheels, SECOND)
