"""Constants of motion (eqs. 18 and 23) against forces summed by hand over 4, 5 and 6 supports."""

from __future__ import annotations

import numpy as np
import pytest

from plant.analysis.constants import ConstantsOfMotion, constants_of_motion
from plant.errors import PlantError
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.reference import least_norm_loads
from tests.plant.scenes import MU, G, parcel, spec

MASS = 2.0
WEIGHT = MASS * G

SCENES: dict[int, PlantSpec] = {
    4: spec(parcel(size_m=(0.15, 0.15), position_m=(0.012, -0.007), angle_rad=0.1)),
    5: spec(
        parcel(size_m=(0.29, 0.29), position_m=(0.004, 0.011), angle_rad=0.0),
        rows=3,
        columns=3,
        cells=((0, 1), (1, 0), (1, 1), (1, 2), (2, 1)),
    ),
    6: spec(parcel(size_m=(0.25, 0.18), position_m=(0.013, -0.009), angle_rad=0.05), rows=2, columns=3),
}


def _drives(scene: PlantSpec) -> np.ndarray:
    n = len(Plant(scene).array)
    return np.random.default_rng(n).normal(size=(n, 2)) * 0.3


def _force_and_torque(
    points: np.ndarray, speeds: np.ndarray, x: np.ndarray, u: tuple[float, float] = (0, 0), omega: float = 0.0
) -> tuple[np.ndarray, float]:
    """Eqs. 2, 14 and 15, cell by cell."""
    loads = least_norm_loads(points, x)
    assert loads is not None
    force, torque = np.zeros(2), 0.0
    for p, v, n in zip(points, speeds, loads * WEIGHT, strict=True):
        r = p - x
        pull = MU * n * (v - np.array(u) - omega * np.array([-r[1], r[0]]))
        force += pull
        torque += r[0] * pull[1] - r[1] * pull[0]
    return force, float(torque)


def _both(supports: int) -> tuple[ConstantsOfMotion, np.ndarray, np.ndarray, np.ndarray]:
    scene = SCENES[supports]
    drives = _drives(scene)
    found = constants_of_motion(scene, 0, drives)
    plant = Plant(scene)
    cells = [plant.array.lattice.index(cell) for cell in found.supports]
    assert len(cells) == supports
    return found, plant.array.positions_m[cells], drives[cells], np.array(scene.parcels[0].position_m)


@pytest.mark.parametrize("supports", SCENES)
def test_the_loads_are_those_of_equal_springs(supports: int) -> None:
    found, points, _, x = _both(supports)
    expected = least_norm_loads(points, x)
    assert expected is not None
    assert found.loads_n == pytest.approx(WEIGHT * expected, abs=1e-12)
    assert found.loads_n.sum() == pytest.approx(WEIGHT, rel=1e-14)


def test_the_loads_on_four_cells_are_as_computed_on_paper() -> None:
    found, points, _, x = _both(4)
    # a square of pitch p: N = W/4 (1 + 4 dx x / p^2 + 4 dy y / p^2) with d the cell's place about the centre
    expected = WEIGHT / 4.0 * (1.0 + points @ x * 4.0 / 0.01)
    assert found.loads_n == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("supports", SCENES)
def test_the_force_is_linear_in_place_and_velocity_with_these_constants(supports: int) -> None:
    found, points, speeds, x = _both(supports)
    for step in ((0.0, 0.0), (0.003, 0.0), (0.0, -0.004), (0.002, 0.003)):
        place = x + step
        force, _ = _force_and_torque(points, speeds, place, u=(0.3, -0.2))
        expected = found.f0_n + found.k_s_n_per_m @ place - found.damping_n_s_per_m * np.array([0.3, -0.2])
        assert force == pytest.approx(expected, abs=1e-12)
    assert found.damping_n_s_per_m == pytest.approx(MU * WEIGHT, rel=1e-15)


@pytest.mark.parametrize("supports", SCENES)
def test_the_torque_and_its_gradient_are_those_of_the_sum_over_cells(supports: int) -> None:
    found, points, speeds, x = _both(supports)
    _, torque = _force_and_torque(points, speeds, x)
    assert found.tau0_n_m == pytest.approx(torque, abs=1e-13)
    h = 1e-3  # central differences of a quadratic are exact
    gradient = [
        (_force_and_torque(points, speeds, x + d)[1] - _force_and_torque(points, speeds, x - d)[1]) / (2 * h)
        for d in (np.array([h, 0.0]), np.array([0.0, h]))
    ]
    assert found.k_tau_n == pytest.approx(gradient, abs=1e-10)
    _, turning = _force_and_torque(points, speeds, x, omega=1.0)
    assert found.d_n_m_s == pytest.approx(torque - turning, abs=1e-13)
    assert found.d_n_m_s > 0.0
    size = SCENES[supports].parcels[0].size_m
    assert size is not None
    inertia = MASS * (size[0] ** 2 + size[1] ** 2) / 12.0
    assert found.angular_acceleration_rad_s2 == pytest.approx(torque / inertia, rel=1e-12)


@pytest.mark.parametrize("supports", SCENES)
def test_the_constants_are_the_plants_own_acceleration(supports: int) -> None:
    found, _, _, x = _both(supports)
    plant = Plant(SCENES[supports])
    plant.advance(_drives(SCENES[supports]), 10)
    force = found.f0_n + found.k_s_n_per_m @ x
    assert plant.state[0, 3:5] / 10e-9 == pytest.approx(force / MASS, rel=1e-6)
    assert plant.state[0, 5] / 10e-9 == pytest.approx(found.angular_acceleration_rad_s2, rel=1e-5)


@pytest.mark.parametrize("supports", SCENES)
def test_at_the_equilibrium_no_force_acts(supports: int) -> None:
    found = _both(supports)[0]
    assert found.equilibrium_m is not None
    force = found.f0_n + found.k_s_n_per_m @ found.equilibrium_m
    assert force == pytest.approx(np.zeros(2), abs=1e-9)
    assert not found.equilibrium_inside or np.abs(found.equilibrium_m).max() < 0.2


def test_eigenvalues_in_a_linear_field_are_those_of_the_damped_oscillator() -> None:
    scene = spec(parcel(size_m=(0.15, 0.15), position_m=(0.012, -0.007), angle_rad=0.1))
    plant = Plant(scene)
    found = constants_of_motion(scene, 0, plant.array.positions_m * (-1.0, -2.0))
    kappa = MU * G
    expected = np.concatenate([np.roots([1.0, kappa, kappa]), np.roots([1.0, kappa, 2.0 * kappa])])
    assert found.k_s_n_per_m == pytest.approx(np.diag([-1.0, -2.0]) * MU * WEIGHT, abs=1e-12)
    assert np.sort_complex(found.eigenvalues_per_s) == pytest.approx(np.sort_complex(expected), abs=1e-12)
    assert found.equilibrium_m == pytest.approx([0.0, 0.0], abs=1e-15)
    assert found.equilibrium_inside


def test_an_equilibrium_elsewhere_is_distinguished_from_one_on_the_same_supports() -> None:
    scene = spec(parcel(size_m=(0.15, 0.15), position_m=(0.3, 0.2), angle_rad=0.1))
    found = constants_of_motion(scene, 0, Plant(scene).array.positions_m * (-1.0, -2.0))
    assert found.equilibrium_m == pytest.approx([0.0, 0.0], abs=1e-12)
    assert not found.equilibrium_inside


@pytest.mark.parametrize("scene", [SCENES[4], SCENES[5], SCENES[6], spec(parcel())])
def test_a_uniform_field_has_no_single_equilibrium(scene: PlantSpec) -> None:
    found = constants_of_motion(scene, 0, np.tile((0.3, 0.1), (len(Plant(scene).array), 1)))
    assert found.k_s_n_per_m == pytest.approx(np.zeros((2, 2)), abs=1e-12)
    assert found.equilibrium_m is None
    assert not found.equilibrium_inside


def test_a_parcel_that_does_not_stand_has_no_constants() -> None:
    scene = spec(parcel(position_m=(9.0, 0.0)))
    with pytest.raises(PlantError, match=r"parcels\[0\]: no set of cells carries the parcel at this pose"):
        constants_of_motion(scene, 0, np.zeros((400, 2)))
