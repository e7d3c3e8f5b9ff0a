"""Constants of motion (eqs. 18 and 23), against values worked out by hand.

Throughout mu = 0.2 s/m, m = 1 kg and g = 10 m/s², so mu W = 2 N s/m; the supports' centroid is the origin.
"""

from __future__ import annotations

import numpy as np
import pytest

from plant.constants import constants_of_motion
from plant.errors import PlantError
from plant.plant import Plant
from plant.specs import ArraySpec, FrictionSpec, ParcelSpec, PlantSpec


def scene(
    array: ArraySpec, size_m: tuple[float, float], position_m: tuple[float, float] = (0.0, 0.0)
) -> PlantSpec:
    parcel = ParcelSpec(size_m=size_m, mass_kg=1.0, position_m=position_m)
    friction = FrictionSpec(coefficient_s_per_m=0.2)
    return PlantSpec(array=array, parcels=(parcel,), friction=friction, gravity_m_s2=10.0)


def speeds(spec: PlantSpec, **cells: tuple[float, float]) -> np.ndarray:
    lattice = spec.array.lattice()
    wheel_speed = np.zeros((len(lattice), 2))
    for name, value in cells.items():
        wheel_speed[lattice.index((int(name[1]), int(name[2])))] = value
    return wheel_speed


def test_four_supports_with_one_driven_wheel() -> None:
    # r = (±0.05, ±0.05), sum r r' = 0.01 I, so the share of the lower left cell is 1/4 - 5 x - 5 y;
    # with V = (1, 0) there: f = 2 (1/4 - 5x - 5y), tau = 2 (1/4 - 5x - 5y)(0.05 + y), d = 2 * 0.005
    spec = scene(ArraySpec(rows=2, columns=2, pitch_m=0.1), (0.15, 0.15))
    found = constants_of_motion(spec, 0, speeds(spec, c00=(1.0, 0.0)))
    assert found.supports == ((0, 0), (0, 1), (1, 0), (1, 1))
    np.testing.assert_allclose(found.loads_n, 2.5, rtol=1e-14)
    np.testing.assert_allclose(found.k_s_n_per_m, [[-10.0, -10.0], [0.0, 0.0]], atol=1e-13)
    np.testing.assert_allclose(found.f0_n, [0.5, 0.0], atol=1e-14)
    assert found.tau0_n_m == pytest.approx(0.025, abs=1e-15)
    np.testing.assert_allclose(found.k_tau_n, [-0.5, 0.0], atol=1e-13)
    assert found.d_n_m_s == pytest.approx(0.01, abs=1e-15)
    assert found.equilibrium_m is None  # one line of points, not one point


def test_four_supports_off_the_centroid() -> None:
    # the centre of mass at (0.02, 0): shares 1/4 ∓ 0.1, so d = 2 (0.15 (0.07² + 0.05²) 2 + 0.35 (0.03² + 0.05²) 2)
    spec = scene(ArraySpec(rows=2, columns=2, pitch_m=0.1), (0.15, 0.15), (0.02, 0.0))
    found = constants_of_motion(spec, 0, speeds(spec, c00=(1.0, 0.0)))
    np.testing.assert_allclose(found.loads_n, [1.5, 3.5, 1.5, 3.5], rtol=1e-13)
    assert found.tau0_n_m == pytest.approx(2 * 0.15 * 0.05, abs=1e-15)
    assert found.d_n_m_s == pytest.approx(4 * (0.15 * 0.0074 + 0.35 * 0.0034), abs=1e-15)


def test_five_supports_in_a_cross() -> None:
    # r = 0, (±0.1, 0), (0, ±0.1): sum r r' = 0.02 I; shares 1/5 + 50 r . X. With V = (-1, 0) to the east and (1, 0)
    # to the west: f_x = 2 ((1/5 + 5x)(-1) + (1/5 - 5x)) = -20 x; with V = (0, 2) in the middle: f_y = 2/5 * 2
    cells = ((0, 1), (1, 0), (1, 1), (1, 2), (2, 1))
    spec = scene(ArraySpec(rows=3, columns=3, pitch_m=0.1, cells=cells), (0.25, 0.25))
    found = constants_of_motion(spec, 0, speeds(spec, c12=(-1.0, 0.0), c10=(1.0, 0.0), c11=(0.0, 2.0)))
    assert found.supports == cells
    np.testing.assert_allclose(found.loads_n, 2.0, rtol=1e-14)
    np.testing.assert_allclose(found.k_s_n_per_m, [[-20.0, 0.0], [0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(found.f0_n, [0.0, 0.8], atol=1e-14)
    assert found.tau0_n_m == pytest.approx(0.0, abs=1e-15)
    # tau = 2 sum n (r - X) x V: the middle gives 2 (1/5)(-x)(2), the arms 2 y (n_east - n_west)(-1)·(-1) = 0 at X = 0
    np.testing.assert_allclose(found.k_tau_n, [-0.8, 0.0], atol=1e-13)
    assert found.d_n_m_s == pytest.approx(2 * (4 / 5) * 0.01, abs=1e-15)


def test_six_supports_in_the_linear_field() -> None:
    # V = (-x, -2 y): f = -mu W (x, 2 y) whatever the supports; the pose is its own equilibrium, and its eigenvalues
    # are those of x'' = mu g (k x - x'): -1 ± i and -1 ± i sqrt 3
    spec = scene(ArraySpec(rows=2, columns=3, pitch_m=0.1), (0.25, 0.15))
    positions = np.array([[x, y] for y in (-0.05, 0.05) for x in (-0.1, 0.0, 0.1)])
    found = constants_of_motion(spec, 0, positions * [-1.0, -2.0])
    assert len(found.supports) == 6
    np.testing.assert_allclose(found.k_s_n_per_m, [[-2.0, 0.0], [0.0, -4.0]], atol=1e-13)
    np.testing.assert_allclose(found.f0_n, 0.0, atol=1e-15)
    np.testing.assert_allclose(found.k_tau_n, 0.0, atol=1e-13)
    assert found.d_n_m_s == pytest.approx(2 * (4 * 0.01 + 6 * 0.0025) / 6, abs=1e-15)
    np.testing.assert_allclose(found.equilibrium_m, 0.0, atol=1e-15)
    assert found.equilibrium_inside
    root = np.sqrt(3.0)
    rates = sorted(found.eigenvalues_per_s, key=lambda rate: rate.imag)
    np.testing.assert_allclose(rates, [-1 - root * 1j, -1 - 1j, -1 + 1j, -1 + root * 1j])


def test_the_plant_starts_with_the_accelerations_that_the_constants_say() -> None:
    spec = scene(ArraySpec(rows=6, columns=6, pitch_m=0.1), (0.32, 0.21), (0.031, -0.022))
    wheel_speed = np.random.default_rng(7).normal(size=(36, 2))
    found = constants_of_motion(spec, 0, wheel_speed)
    plant = Plant(spec)
    plant.advance(wheel_speed, 1_000)  # 1 µs from rest
    force = found.f0_n + found.k_s_n_per_m @ np.array([0.031, -0.022])
    np.testing.assert_allclose(plant.state[0, 3:5] / 1e-6, force, rtol=1e-5)
    assert plant.state[0, 5] / 1e-6 == pytest.approx(found.angular_acceleration_rad_s2, rel=1e-5)


def test_the_torque_gradient_is_that_of_neighbouring_poses() -> None:
    wheel_speed = np.random.default_rng(3).normal(size=(36, 2))
    array, step = ArraySpec(rows=6, columns=6, pitch_m=0.1), 1e-5

    def torque(x: float, y: float) -> float:
        return constants_of_motion(scene(array, (0.33, 0.23), (x, y)), 0, wheel_speed).tau0_n_m

    found = constants_of_motion(scene(array, (0.33, 0.23), (0.011, 0.013)), 0, wheel_speed).k_tau_n
    slope_x = (torque(0.011 + step, 0.013) - torque(0.011 - step, 0.013)) / (2 * step)
    slope_y = (torque(0.011, 0.013 + step) - torque(0.011, 0.013 - step)) / (2 * step)
    np.testing.assert_allclose(found, [slope_x, slope_y], rtol=1e-6)


def test_a_parcel_that_nothing_carries_has_no_constants() -> None:
    spec = scene(ArraySpec(rows=2, columns=2, pitch_m=0.1), (0.15, 0.15), (3.0, 0.0))
    with pytest.raises(PlantError, match=r"parcels\[0\]: no set of cells carries the parcel"):
        constants_of_motion(spec, 0, np.zeros((4, 2)))
