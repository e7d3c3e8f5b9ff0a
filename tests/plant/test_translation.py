"""In a linear field the centre of mass moves as a damped oscillator, whatever carries the parcel."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from plant.effects.motors import MotorsSpec
from plant.plant import Plant
from tests.plant.scenes import MU, SECOND, TICK_NS, G, parcel, spec

KAPPA = MU * G


def oscillator(field: np.ndarray, start: np.ndarray, time_s: float, kappa: float = KAPPA) -> np.ndarray:
    """Exact ``(x, y, vx, vy)`` of ``X'' = kappa (K X - X')``, by the exponential of its matrix."""
    motion = np.block([[np.zeros((2, 2)), np.eye(2)], [kappa * field, -kappa * np.eye(2)]])
    return expm(motion * time_s) @ start


FIELDS = {
    "elliptic, underdamped": [[-1.0, 0.0], [0.0, -2.0]],
    "overdamped": [[-0.1, 0.0], [0.0, -0.4]],
    "critically damped": [[-KAPPA / 4.0, 0.0], [0.0, -KAPPA / 4.0]],
    "stiff": [[-15.0, 0.0], [0.0, -6.0]],
    "saddle": [[-0.5, 0.0], [0.0, 0.05]],
    "vortex": [[-0.4, -0.8], [0.8, -0.4]],
    "shear": [[-0.6, 0.9], [0.0, -1.1]],
}


@pytest.mark.parametrize("name", FIELDS)
def test_translation_is_the_closed_form_through_every_support_change(name: str) -> None:
    field = np.array(FIELDS[name])
    plant = Plant(spec(parcel(position_m=(0.45, 0.35), velocity_m_s=(-0.2, 0.1)), tolerance=1e-12))
    start = plant.state[0, [0, 1, 3, 4]]
    drives = plant.array.positions_m @ field.T
    trajectory = plant.trajectory(drives, 5 * SECOND, 50_000_000)
    assert plant.support_changes >= 20
    expected = np.array([oscillator(field, start, t * 1e-9) for t in trajectory.time_ns])
    assert trajectory.state[:, 0, [0, 1, 3, 4]] == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("angle", [0.0, 0.9, np.pi / 2.0])
@pytest.mark.parametrize("size", [(0.54, 0.32), (0.3, 0.3), (0.9, 0.2)])
def test_translation_depends_neither_on_the_angle_nor_on_the_size(
    size: tuple[float, float], angle: float
) -> None:
    plant = Plant(spec(parcel(size_m=size, angle_rad=angle, position_m=(0.3, 0.25))))
    start = plant.state[0, [0, 1, 3, 4]]
    plant.advance(plant.array.positions_m * (-1.0, -2.0), 3 * SECOND)
    expected = oscillator(np.diag([-1.0, -2.0]), start, 3.0)
    assert plant.state[0, [0, 1, 3, 4]] == pytest.approx(expected, abs=1e-11)


def test_translation_depends_neither_on_the_shape_nor_on_where_the_centre_of_mass_is() -> None:
    corners = ((0.0, 0.0), (0.5, 0.1), (0.6, 0.3), (0.2, 0.5), (-0.1, 0.25))
    body = parcel(vertices_m=corners, centre_of_mass_m=(0.3, 0.2), position_m=(0.2, 0.3))
    plant = Plant(spec(body))
    start = plant.state[0, [0, 1, 3, 4]]
    plant.advance(plant.array.positions_m * (-1.0, -2.0), 4 * SECOND)
    assert plant.state[0, [0, 1, 3, 4]] == pytest.approx(
        oscillator(np.diag([-1.0, -2.0]), start, 4.0), abs=1e-11
    )


def test_holes_do_not_disturb_translation() -> None:
    draw = np.random.default_rng(2)
    cells = [(r, c) for r in range(20) for c in range(20)]
    holes = tuple(cells[i] for i in draw.choice(400, 100, replace=False))
    plant = Plant(spec(parcel(position_m=(0.3, 0.25)), missing=holes))
    start = plant.state[0, [0, 1, 3, 4]]
    plant.advance(plant.array.positions_m * (-1.0, -2.0), 4 * SECOND)
    assert plant.status[0].state == "moving"
    assert plant.state[0, [0, 1, 3, 4]] == pytest.approx(
        oscillator(np.diag([-1.0, -2.0]), start, 4.0), abs=1e-11
    )


def test_motors_drag_translation_by_their_lag_in_closed_form() -> None:
    motors = MotorsSpec(time_constant_s=0.3, speed_per_volt_m_s=0.1)
    plant = Plant(spec(parcel(position_m=(0.3, 0.25)), motors=motors))
    start = plant.state[0, [0, 1, 3, 4]]
    plant.advance(plant.array.positions_m * (-10.0, -20.0), 3 * SECOND)
    # V = (1 - exp(-t / tau)) K p: the load-weighted sum is K X times the same factor
    steps = 3000
    state, h = start, 3.0 / steps

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        speed = -np.expm1(-t / 0.3) * np.array([-1.0, -2.0]) * y[:2]
        return np.concatenate([y[2:], KAPPA * (speed - y[2:])])

    for k in range(steps):  # RK4: its error here is below 1e-13
        t = k * h
        a = rate(t, state)
        b = rate(t + h / 2, state + h / 2 * a)
        c = rate(t + h / 2, state + h / 2 * b)
        d = rate(t + h, state + h * c)
        state = state + h / 6 * (a + 2 * b + 2 * c + d)
    assert plant.state[0, [0, 1, 3, 4]] == pytest.approx(state, abs=1e-11)


def test_translation_stays_the_closed_form_when_the_field_changes_every_tick() -> None:
    plant = Plant(spec(parcel(position_m=(0.3, 0.25))))
    draw = np.random.default_rng(8)
    state = plant.state[0, [0, 1, 3, 4]]
    for tick in range(1, 400):
        field = -np.diag(draw.uniform(0.2, 3.0, 2)) + 0.3 * draw.normal(size=(2, 2))
        plant.advance(plant.array.positions_m @ field.T, tick * TICK_NS)
        state = oscillator(field, state, TICK_NS * 1e-9)
        assert plant.state[0, [0, 1, 3, 4]] == pytest.approx(state, abs=1e-11)
    assert plant.support_changes > 20
