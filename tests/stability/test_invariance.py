"""What must not change the motion: where the array lies, how it is turned and mirrored, how its cells are numbered."""

from __future__ import annotations

import numpy as np
import pytest

from plant.array import CellArray
from plant.parcel_spec import ArraySpec
from plant.plant import Plant
from tests.plant.scenes import SECOND, elliptic, parcel
from tests.stability.solvers import Claim, Solver, claiming

FAR = 2.0**20
"""A thousand kilometres, and a number of pitches that floats hold exactly."""


class FarArray(CellArray):
    """The cells of a scene, ``FAR`` to the right and as far down."""

    def __init__(self, spec: ArraySpec) -> None:
        super().__init__(spec)
        self.positions_m += (FAR, -FAR)
        self.origin_m = (self.origin_m[0] + FAR, self.origin_m[1] - FAR)


class ShuffledArray(CellArray):
    """The cells of a scene, numbered at random."""

    def __init__(self, spec: ArraySpec) -> None:
        super().__init__(spec)
        order = np.random.default_rng(7).permutation(len(self.positions_m))
        rows, columns = self.lattice.rows[order], self.lattice.columns[order]
        self.positions_m = self.positions_m[order]
        self.grid[rows, columns] = np.arange(len(order))


def _moved(plant: Plant, shift: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """State after 3 s in the elliptic field about ``shift``, its place measured from there."""
    plant.advance((plant.array.positions_m - shift) * (-1.0, -2.0), 3 * SECOND)
    return plant.state[0] - [*shift, 0.0, 0.0, 0.0, 0.0]


@claiming(Claim.SYMMETRY, Claim.FAR)
def test_a_shift_by_a_thousand_kilometres_changes_nothing_but_digits(
    solver: Solver, monkeypatch: pytest.MonkeyPatch
) -> None:
    """H21, far from the origin: sums about the origin lose digits with the square of the distance."""
    # sizes that floats hold exactly there, too
    start = {"size_m": (0.53125, 0.3125), "position_m": (0.5625, 0.5)}
    near = solver.plant(parcel(**start), pitch_m=0.125)
    expected = _moved(near)
    monkeypatch.setattr("plant.plant.CellArray", FarArray)
    body = parcel(**start | {"position_m": (0.5625 + FAR, 0.5 - FAR)})
    far = solver.plant(body, pitch_m=0.125)
    # a place is known to 1e-10 m there
    assert _moved(far, (FAR, -FAR)) == pytest.approx(expected, abs=solver.within(1e-7, 3.0))
    assert far.support_changes == near.support_changes > 10


@claiming(Claim.SYMMETRY)
@pytest.mark.parametrize("size", [(0.54, 0.32), (0.68, 0.42)])
def test_cells_numbered_anew_carry_the_parcel_alike(
    solver: Solver, size: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """H24, sums that depend on an order that means nothing: PhysiCell #427, Menge #152."""
    plain = solver.plant(parcel(size_m=size))
    monkeypatch.setattr("plant.plant.CellArray", ShuffledArray)
    shuffled = solver.plant(parcel(size_m=size))
    assert not np.array_equal(plain.array.positions_m, shuffled.array.positions_m)
    for plant in (plain, shuffled):
        plant.advance(elliptic(plant), 10 * SECOND)
    assert shuffled.state == pytest.approx(plain.state, abs=solver.within(1e-11, 10.0))
    assert shuffled.support_changes == plain.support_changes > 10


@claiming(Claim.SYMMETRY)
@pytest.mark.parametrize("size", [(0.54, 0.32), (0.6, 0.4)], ids=["between cells", "edges on rows"])
def test_what_is_symmetric_stays_so_through_ten_seconds_of_support_changes(
    solver: Solver, size: tuple[float, float]
) -> None:
    """H4: a parcel aligned with the lattice is drawn along the field's axis, and neither turns nor leaves it."""
    plant = solver.plant(parcel(size_m=size, position_m=(0.55, 0.0), angle_rad=0.0))
    trajectory = plant.trajectory(elliptic(plant), 10 * SECOND, SECOND // 100)
    assert np.abs(trajectory.state[:, 0, [1, 2, 4, 5]]).max() <= 1e-12
    assert plant.support_changes > 20


FIELD = np.array([[-1.0, 0.4], [0.1, -1.7]])


def _run(
    solver: Solver, position: tuple[float, float], angle: float, field: np.ndarray, spin: float
) -> np.ndarray:
    body = parcel(
        position_m=position, angle_rad=angle, angular_velocity_rad_s=spin, centre_of_mass_m=(0.05, 0.0)
    )
    plant = solver.plant(body)
    plant.advance(plant.array.positions_m @ field.T, 3 * SECOND)
    assert plant.support_changes > 20
    return plant.state[0]


@claiming(Claim.SYMMETRY)
@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_a_quarter_turn_of_everything_turns_the_motion(solver: Solver, quarter: int) -> None:
    turn = np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), quarter)
    place, angle = turn @ (0.3, 0.2), 0.9 + quarter * np.pi / 2.0
    plain = _run(solver, (0.3, 0.2), 0.9, FIELD, 0.5)
    other = _run(solver, (float(place[0]), float(place[1])), angle, turn @ FIELD @ turn.T, 0.5)
    assert other[:2] == pytest.approx(turn @ plain[:2], abs=solver.within(1e-11, 3.0))
    assert other[3:5] == pytest.approx(turn @ plain[3:5], abs=solver.within(1e-11, 3.0))
    assert other[2] - quarter * np.pi / 2.0 == pytest.approx(plain[2], abs=solver.within(1e-10, 3.0))
    assert other[5] == pytest.approx(plain[5], abs=solver.within(1e-10, 3.0))


@claiming(Claim.SYMMETRY)
def test_a_mirror_mirrors_the_motion(solver: Solver) -> None:
    mirror = np.diag([1.0, -1.0])
    plain = _run(solver, (0.3, 0.2), 0.9, FIELD, 0.5)
    other = _run(solver, (0.3, -0.2), -0.9, mirror @ FIELD @ mirror, -0.5)
    assert other == pytest.approx(plain * [1, -1, -1, 1, -1, -1], abs=solver.within(1e-10, 3.0))


@claiming(Claim.SYMMETRY)
def test_a_whole_turn_of_the_start_angle_changes_nothing_but_digits(solver: Solver) -> None:
    plain, other = (_run(solver, (0.3, 0.2), angle, FIELD, 0.5) for angle in (0.9, 0.9 + 2.0 * np.pi))
    assert other - [0, 0, 2.0 * np.pi, 0, 0, 0] == pytest.approx(plain, abs=solver.within(1e-11, 3.0))
