"""Loads under a parcel against a general least-norm solver, and by what wheels do to it."""

from __future__ import annotations

import numpy as np
import pytest

from plant.errors import PlantError
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from tests.plant.reference import is_least_norm, least_norm_loads
from tests.plant.scenes import loads, members, parcel, spec


def _places(plant: Plant, cells: np.ndarray) -> np.ndarray:
    return plant.array.positions_m[cells]


def _stand(body: ParcelSpec, **array: object) -> tuple[Plant, np.ndarray, np.ndarray] | None:
    """The plant, its cells under the parcel and their loads; None where it would tip."""
    try:
        plant = Plant(spec(body, **array))  # type: ignore[arg-type]
    except PlantError:
        return None
    return plant, *loads(plant)


def _random(draw: np.random.Generator) -> tuple[ParcelSpec, dict[str, object]]:
    """A parcel anywhere near the middle: any size, centre of mass anywhere inside it, some cells missing."""
    size = draw.uniform(0.12, 0.8, 2)
    body = parcel(
        size_m=tuple(size),
        position_m=tuple(draw.uniform(-0.3, 0.3, 2)),
        angle_rad=float(draw.uniform(-4.0, 4.0)),
        centre_of_mass_m=tuple(draw.uniform(-0.45, 0.45, 2) * size * draw.integers(0, 2)),
    )
    cells = [(r, c) for r in range(12) for c in range(12)]
    count = int(draw.integers(0, 80))
    holes = tuple(cells[i] for i in draw.choice(len(cells), count, replace=False))
    return body, {"rows": 12, "columns": 12, "missing": holes}


def test_loads_are_the_least_that_balance_and_never_pull_whatever_the_supports() -> None:
    draw = np.random.default_rng(11)
    standing = tipping = lifted = 0
    for _ in range(300):
        body, array = _random(draw)
        stand = _stand(body, **array)
        if stand is None:
            # off the array, or truly without loads that balance
            bare = Plant(spec(**{**array, "missing": ()}))  # type: ignore[arg-type]
            keep = [i for i, cell in enumerate(bare.array.lattice.cells) if cell not in array["missing"]]
            corners = np.array(body.polygon()) - np.array(body.centre_of_mass_m)
            cells = bare.array.positions_m[keep]
            under = cells[_inside(corners, cells, body)]
            assert len(under) == 0 or least_norm_loads(under, np.array(body.position_m)) is None
            tipping += 1
            continue
        plant, cells, share = stand
        centre = plant.state[0, :2]
        assert share.min() >= 0.0
        assert is_least_norm(_places(plant, cells), centre, share) == ""
        expected = least_norm_loads(_places(plant, cells), centre)
        assert expected is not None
        assert share == pytest.approx(expected, abs=1e-10)
        standing += 1
        lifted += int(np.any(share == 0.0))
    assert standing > 100
    assert tipping > 30
    assert lifted > 40


def _inside(corners: np.ndarray, cells: np.ndarray, body: ParcelSpec) -> np.ndarray:
    """Which cells lie in a polygon, by the winding of its corners about them."""
    c, s = np.cos(body.angle_rad), np.sin(body.angle_rad)
    placed = corners @ np.array([[c, s], [-s, c]]) + np.array(body.position_m)
    angle = np.arctan2(
        *(placed[None] - cells[:, None]).transpose(2, 0, 1)[::-1],
    )
    turn = np.diff(np.concatenate([angle, angle[:, :1]], axis=1), axis=1)
    return np.abs(((turn + np.pi) % (2.0 * np.pi) - np.pi).sum(axis=1)) > 3.0


def test_forces_and_moments_balance_to_a_millionth_of_a_millionth_of_the_weight() -> None:
    draw = np.random.default_rng(5)
    for _ in range(100):
        body, array = _random(draw)
        stand = _stand(body, **array)
        if stand is None:
            continue
        plant, cells, share = stand
        lever = _places(plant, cells) - plant.state[0, :2]
        reach = np.abs(lever).max()
        assert abs(share.sum() - 1.0) <= 1e-12
        assert np.abs(share @ lever).max() <= 1e-12 * reach


def test_four_supports_about_the_centre_share_equally() -> None:
    stand = _stand(parcel(size_m=(0.15, 0.15), position_m=(0.0, 0.0), angle_rad=0.0))
    assert stand is not None
    assert stand[2] == pytest.approx([0.25] * 4, abs=1e-15)


def test_the_lever_rule_holds_on_two_rows() -> None:
    stand = _stand(parcel(size_m=(0.15, 0.15), position_m=(0.02, 0.0), angle_rad=0.0))
    assert stand is not None
    plant, cells, share = stand
    right = _places(plant, cells)[:, 0] > 0.0
    assert share[right] == pytest.approx([0.35, 0.35], abs=1e-14)
    assert share[~right] == pytest.approx([0.15, 0.15], abs=1e-14)


def test_an_overhanging_parcel_lifts_off_its_far_supports() -> None:
    # five columns under it, the centre of mass a fifth of a pitch from the last: at most two columns push
    body = parcel(size_m=(0.48, 0.15), position_m=(0.18, 0.0), angle_rad=0.0, centre_of_mass_m=(0.18, 0.0))
    stand = _stand(body, rows=2, columns=5)
    assert stand is not None
    plant, cells, share = stand
    by_column = {c: share[np.isclose(_places(plant, cells)[:, 0], 0.1 * (c - 2))].sum() for c in range(5)}
    assert by_column[0] == by_column[1] == by_column[2] == 0.0
    assert by_column[3] == pytest.approx(0.2, abs=1e-13)
    assert by_column[4] == pytest.approx(0.8, abs=1e-13)


def _drop_all_that_pull(places: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """The supports left when all that would pull are dropped at once, again and again."""
    keep = np.ones(len(places), dtype=bool)
    while True:
        a = np.vstack([np.ones(int(keep.sum())), (places[keep] - centre).T / 0.1])
        loads = np.linalg.lstsq(a, np.array([1.0, 0.0, 0.0]), rcond=1e-12)[0]
        if np.all(loads >= -1e-12):
            return keep
        keep[np.flatnonzero(keep)[loads < 0.0]] = False


def test_supports_that_dropping_all_at_once_would_lose_carry_load() -> None:
    draw = np.random.default_rng(3)
    lost = 0
    for _ in range(1500):
        body, array = _random(draw)
        stand = _stand(body, **array)
        if stand is not None:
            plant, cells, share = stand
            places, centre = _places(plant, cells), plant.state[0, :2]
            if not np.array_equal(_drop_all_that_pull(places, centre), share > 1e-9):
                lost += 1
                assert is_least_norm(places, centre, share) == ""
    assert lost > 0


@pytest.mark.parametrize("x", [-0.04, 0.0, 0.03])
def test_two_supports_carry_by_the_lever_rule_while_the_centre_of_mass_is_between_them(x: float) -> None:
    stand = _stand(parcel(size_m=(0.19, 0.05), position_m=(x, 0.0), angle_rad=0.0), rows=1, columns=2)
    assert stand is not None
    assert stand[2] == pytest.approx([0.5 - 10.0 * x, 0.5 + 10.0 * x], abs=1e-12)


def test_one_support_carries_all_where_the_centre_of_mass_is_on_it() -> None:
    stand = _stand(parcel(size_m=(0.05, 0.05), position_m=(0.0, 0.0)), rows=1, columns=1)
    assert stand is not None
    assert stand[2].tolist() == [1.0]


def test_supports_in_a_row_carry_a_parcel_that_stands_on_the_row() -> None:
    stand = _stand(parcel(size_m=(0.45, 0.05), position_m=(0.013, 0.0), angle_rad=0.0), rows=1, columns=5)
    assert stand is not None
    plant, cells, share = stand
    assert is_least_norm(_places(plant, cells), np.array([0.013, 0.0]), share) == ""
    assert share == pytest.approx(0.2 + _places(plant, cells)[:, 0] * 0.013 / 0.1, abs=1e-13)


def test_supports_on_a_slanting_row_carry_a_parcel_that_stands_on_the_row() -> None:
    # the products of such coordinates cancel only to rounding
    diagonal = tuple((k, k) for k in range(7))
    body = parcel(size_m=(0.9, 0.05), position_m=(0.017, 0.017), angle_rad=np.pi / 4.0)
    stand = _stand(body, rows=7, columns=7, cells=diagonal)
    assert stand is not None
    plant, cells, share = stand
    assert len(cells) == 7
    assert is_least_norm(_places(plant, cells), plant.state[0, :2], share) == ""


def test_a_row_with_one_cell_beside_it_is_a_plane() -> None:
    cells = (*((0, c) for c in range(12)), (1, 6))
    body = parcel(size_m=(1.3, 0.26), position_m=(0.0, -0.049), angle_rad=0.0, centre_of_mass_m=(0.0, 0.0))
    stand = _stand(body, rows=2, columns=12, cells=cells)
    assert stand is not None
    plant, under, share = stand
    assert len(under) == 13
    assert is_least_norm(_places(plant, under), plant.state[0, :2], share) == ""
    assert share[_places(plant, under)[:, 1] > 0.0] == pytest.approx([0.01], abs=1e-13)


@pytest.mark.parametrize(
    ("position", "array"),
    [
        ((0.0, 1e-6), {"rows": 1, "columns": 5}),
        ((0.051, 0.0), {"rows": 1, "columns": 2}),
        ((1e-6, 0.0), {"rows": 1, "columns": 1}),
        ((0.16, 0.0), {"rows": 2, "columns": 4}),
    ],
)
def test_a_parcel_whose_centre_of_mass_lies_beside_its_supports_is_refused(
    position: tuple[float, float], array: dict[str, object]
) -> None:
    with pytest.raises(PlantError, match=r"parcels\[0\]\.position_m = .* would tip: its centre of mass lies"):
        Plant(spec(parcel(size_m=(0.2, 0.15), position_m=position, angle_rad=0.0), **array))  # type: ignore[arg-type]


def test_a_wheel_pulls_a_resting_parcel_in_proportion_to_its_load() -> None:
    """Loads seen from outside: one wheel turns, the parcel gains mu g N/W V t."""
    body = parcel(size_m=(0.42, 0.28), position_m=(0.03, -0.06), centre_of_mass_m=(0.15, 0.05))
    plant = Plant(spec(body))
    cells, share = loads(plant)
    for cell, expected in zip(cells, share, strict=True):
        fresh = Plant(spec(body))
        drives = np.zeros((len(fresh.array), 2))
        drives[cell] = (1.0, 0.0)
        fresh.advance(drives, 10)
        gained = fresh.state[0, 3] / (0.2 * 9.81 * 10e-9)
        assert gained == pytest.approx(expected, abs=2e-7)


def test_far_from_the_origin_loads_keep_their_digits() -> None:
    cells = tuple((9_990 + r, 9_980 + c) for r in range(8) for c in range(8))
    near = Plant(spec(parcel(size_m=(0.5, 0.4), position_m=(0.037, 0.021)), rows=8, columns=8))
    far_array = {"rows": 10_000, "columns": 10_000, "cells": cells}
    origin = np.array([(9_980 + 3.5 - 4_999.5) * 0.1, (9_990 + 3.5 - 4_999.5) * 0.1])
    far = Plant(
        spec(parcel(size_m=(0.5, 0.4), position_m=tuple(origin + np.array([0.037, 0.021]))), **far_array)
    )  # type: ignore[arg-type]
    assert np.array_equal(members(near), members(far))
    assert loads(far)[1] == pytest.approx(loads(near)[1], abs=1e-12)
