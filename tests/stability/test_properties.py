"""What holds in every scene: balanced loads, the plain plant's motion, and the symmetries of space."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from plant.errors import PlantError
from plant.observations import Event
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from tests.plant.reference import is_least_norm
from tests.plant.scenes import MU, SECOND, Floats, G, bench, loads, parcel
from tests.stability.solvers import SOLVERS, Claim, Solver, claiming

pytestmark = pytest.mark.slow

SIDE = 12


def repeatable(examples: int) -> settings:
    """Few enough for a minute's suite, however hard they are to find."""
    return settings(
        max_examples=examples,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
    )


@dataclass(frozen=True)
class Drawn:
    """A scene: its parcel, its holes, and a field ``V = K p + shift + bend |p|^2 p``."""

    size: tuple[float, float]
    centre: tuple[float, float]
    at: tuple[float, float, float]
    velocity: tuple[float, float, float]
    inertia: float
    holes: frozenset[tuple[int, int]]
    field: tuple[float, float, float, float]
    shift: tuple[float, float]
    bend: float

    def body(self) -> ParcelSpec:
        """The parcel."""
        return parcel(
            size_m=self.size,
            centre_of_mass_m=self.centre,
            position_m=self.at[:2],
            angle_rad=self.at[2],
            velocity_m_s=self.velocity[:2],
            angular_velocity_rad_s=self.velocity[2],
            inertia_kg_m2=self.inertia,
        )

    def speeds(self, places: Floats) -> Floats:
        """Wheel velocities at ``(n, 2)`` places."""
        curl = self.bend * np.sum(places**2, axis=1, keepdims=True) * places
        return places @ np.array(self.field).reshape(2, 2).T + np.array(self.shift) - curl


def numbers(low: float, high: float, count: int) -> st.SearchStrategy[tuple[float, ...]]:
    """Tuples of so many numbers."""
    return st.tuples(*[st.floats(low, high)] * count)


@st.composite
def scenes(draw: st.DrawFn) -> Drawn:
    """Parcels of any proportion, mass off the centre, on arrays with up to 40 % of the cells missing."""
    size = draw(numbers(0.15, 0.7, 2))
    lean = draw(numbers(-0.35, 0.35, 2))
    seed, share = draw(st.integers(0, 2**16)), draw(st.floats(0.0, 0.4))
    away = np.random.default_rng(seed).random((SIDE, SIDE)) < share
    return Drawn(
        size=(size[0], size[1]),
        centre=(lean[0] * size[0], lean[1] * size[1]),
        at=(*draw(numbers(-0.25, 0.25, 2)), draw(st.floats(-3.0, 3.0))),  # type: ignore[arg-type]
        velocity=draw(numbers(-0.3, 0.3, 3)),  # type: ignore[arg-type]
        inertia=draw(st.floats(0.01, 0.2)),
        holes=frozenset((int(r), int(c)) for r, c in np.argwhere(away)),
        field=draw(numbers(-1.5, 0.5, 4)),  # type: ignore[arg-type]
        shift=draw(numbers(-0.05, 0.05, 2)),  # type: ignore[arg-type]
        bend=draw(st.floats(0.0, 3.0)),
    )


def built(solver: Solver, body: ParcelSpec, **scene: Any) -> Plant:
    """The plant, every crossing located; scenes whose parcel doesn't stand are none."""
    try:
        return solver.plant(body, **{"rows": SIDE, "columns": SIDE, "solver": solver.located} | scene)
    except PlantError:
        assume(False)
        raise


def ran(
    solver: Solver, drawn: Drawn, span_ns: int, motion: Floats | None = None, **change: Any
) -> tuple[Plant, list[Event]]:
    """The scene moved on by ``span_ns``; ``motion`` is a 2 x 2 map of the field's places and speeds."""
    plant = built(solver, drawn.body(), missing=tuple(sorted(drawn.holes)), **change)
    turn = np.eye(2) if motion is None else motion
    _, events = plant.advance(drawn.speeds(plant.array.positions_m @ turn) @ turn.T, span_ns)
    return plant, events


@claiming(Claim.LOADS)
@given(drawn=scenes())
@repeatable(120)
def test_loads_never_pull_and_balance_to_a_millionth_of_a_millionth(solver: Solver, drawn: Drawn) -> None:
    plant = built(solver, drawn.body(), missing=tuple(sorted(drawn.holes)))
    cells, share = loads(plant)
    lever = plant.array.positions_m[cells] - plant.state[0, :2]
    # a load over the mean one that rounding can't tell from none, of either sign
    assert share.min() * len(share) >= -1e-12
    assert abs(share.sum() - 1.0) <= 1e-12
    moment, reach = np.abs(share @ lever).max(), np.abs(lever).max()
    carrying = lever[share > 1e-13]
    if np.linalg.matrix_rank(carrying - carrying.mean(axis=0), tol=1e-6) < 2:
        # on a line or a point a parcel stands to 1e-8 of the pitch
        assert moment <= 1e-9 * (1.0 + 1e-6)
    else:
        assert moment <= 1e-12 * reach
        places = plant.array.positions_m[cells]
        assert is_least_norm(places, plant.state[0, :2], np.maximum(share, 0.0)) == ""


def _short_stay(events: list[Event]) -> bool:
    """Whether a cell is gained and lost, or the reverse, within what the reference's looks may step over."""
    last: dict[tuple[tuple[int, int], ...], float] = {}
    for event in events:
        if event.time_s - last.get(event.cells, -1.0) < 3e-3:
            return True
        last[event.cells] = event.time_s
    return False


FROM_A_COLUMN = Drawn(
    size=(0.232, 0.47),
    centre=(-0.0443, 0.0045),
    at=(-0.25, -0.0034, 1e-10),
    velocity=(0.062, 0.131, 0.093),
    inertia=0.2,
    holes=frozenset(),
    field=(0.2, -0.02, -0.035, 0.4),
    shift=(0.027, 0.01),
    bend=2.56,
)
"""The centre of mass begins right over a column of cells and moves off it: one column carries all, then two do."""


@claiming(Claim.MOTION)
@given(drawn=scenes())
@example(drawn=FROM_A_COLUMN)
@repeatable(15)
def test_the_motion_is_that_of_scipy_at_1e_13(solver: Solver, drawn: Drawn) -> None:
    plant = built(solver, drawn.body(), missing=tuple(sorted(drawn.holes)))
    drives = drawn.speeds(plant.array.positions_m)
    reference, start = bench(plant, drives), plant.state[0]
    _, events = plant.advance(drives, 300_000_000)
    assume(plant.status[0].state == "moving" and not _short_stay(events))
    assert plant.state[0] == pytest.approx(reference.run(start, 0.3), abs=solver.within(1e-9))
    if solver.claims(Claim.EVENTS):
        assert len(events) == len(reference.events)


def _moved(drawn: Drawn, turn: Floats, quarter: float, spin: float) -> Drawn:
    """The scene with its parcel and holes moved by an orthogonal map of the array onto itself; not its field."""
    (x, y), (ux, uy) = turn @ drawn.at[:2], turn @ drawn.velocity[:2]
    middle = 0.5 * (SIDE - 1)
    holes = [turn @ (column - middle, row - middle) + middle for row, column in drawn.holes]
    return Drawn(
        size=drawn.size,
        centre=(drawn.centre[0], spin * drawn.centre[1]),
        at=(float(x), float(y), spin * drawn.at[2] + quarter),
        velocity=(float(ux), float(uy), spin * drawn.velocity[2]),
        inertia=drawn.inertia,
        holes=frozenset((round(row), round(column)) for column, row in holes),
        field=drawn.field,
        shift=drawn.shift,
        bend=drawn.bend,
    )


def _same(solver: Solver, drawn: Drawn, turn: Floats, quarter: float, spin: float) -> None:
    """The scene and its image under the map move alike."""
    plain, events = ran(solver, drawn, SECOND)
    assume(plain.status[0].state == "moving")
    image, images = ran(solver, _moved(drawn, turn, quarter, spin), SECOND, turn)
    x, y, theta, ux, uy, omega = plain.state[0]
    expected = [*(turn @ (x, y)), spin * theta + quarter, *(turn @ (ux, uy)), spin * omega]
    assert image.state[0] == pytest.approx(expected, abs=solver.within(1e-8))
    if solver.claims(Claim.EVENTS):
        assert _crossings(images) == _crossings(events)


def _crossings(events: list[Event]) -> int:
    """Cells that entered or left the footprint. A load that is nothing but for rounding may vanish or not."""
    return sum(event.kind in ("support_gained", "support_lost") for event in events)


@claiming(Claim.SYMMETRY)
@given(drawn=scenes())
@repeatable(40)
def test_a_quarter_turn_of_everything_turns_the_motion(solver: Solver, drawn: Drawn) -> None:
    _same(solver, drawn, np.array([[0.0, -1.0], [1.0, 0.0]]), 0.5 * np.pi, 1.0)


@claiming(Claim.SYMMETRY)
@given(drawn=scenes())
@repeatable(40)
def test_a_mirror_mirrors_the_motion(solver: Solver, drawn: Drawn) -> None:
    _same(solver, drawn, np.diag([1.0, -1.0]), 0.0, -1.0)


@claiming(Claim.SYMMETRY)
@given(drawn=scenes(), rows=st.integers(-2, 2), columns=st.integers(-2, 2))
@repeatable(40)
def test_a_shift_on_a_larger_array_shifts_the_motion_and_numbers_the_cells_anew(
    solver: Solver, drawn: Drawn, rows: int, columns: int
) -> None:
    plain, events = ran(solver, drawn, SECOND)
    assume(plain.status[0].state == "moving")
    # four more on each side: the same cells shifted, other indices, and none of the others ever under the parcel
    cells = tuple(
        (r + 4 + rows, c + 4 + columns) for r in range(SIDE) for c in range(SIDE) if (r, c) not in drawn.holes
    )
    shift = 0.1 * np.array([columns, rows])
    body = drawn.body().model_copy(update={"position_m": tuple(np.array(drawn.at[:2]) + shift)})
    moved = built(solver, body, rows=SIDE + 8, columns=SIDE + 8, cells=cells)
    _, others = moved.advance(drawn.speeds(moved.array.positions_m - shift), SECOND)
    assert moved.state[0] - [*shift, 0, 0, 0, 0] == pytest.approx(plain.state[0], abs=solver.within(1e-8))
    if solver.claims(Claim.EVENTS):
        assert _crossings(others) == _crossings(events)


@claiming(Claim.SYMMETRY)
@given(drawn=scenes(), factor=st.sampled_from([1e-3, 0.3, 7.0, 1e5]))
@repeatable(40)
def test_mass_does_not_move_the_centre_otherwise_nor_inertia_where_it_scales_too(
    solver: Solver, drawn: Drawn, factor: float
) -> None:
    plain, _ = ran(solver, drawn, SECOND)
    body = drawn.body().model_copy(update={"mass_kg": 2.0 * factor, "inertia_kg_m2": drawn.inertia * factor})
    heavy = built(solver, body, missing=tuple(sorted(drawn.holes)))
    heavy.advance(drawn.speeds(heavy.array.positions_m), SECOND)
    assert heavy.status[0].state == plain.status[0].state
    assert heavy.state[0] == pytest.approx(plain.state[0], abs=solver.within(1e-8))


@claiming(Claim.ENERGY)
@given(drawn=scenes(), dead=st.integers(0, 2**16))
@repeatable(40)
def test_kinetic_energy_never_rises_on_stopped_wheels(solver: Solver, drawn: Drawn, dead: int) -> None:
    plant = built(solver, drawn.body(), missing=tuple(sorted(drawn.holes)))
    coasting = np.flatnonzero(np.random.default_rng(dead).random(len(plant.array)) < 0.3)
    plant.release_wheels([int(i) for i in coasting], "coast")
    state = plant.trajectory(np.zeros((len(plant.array), 2)), SECOND, 2_000_000).state[:, 0]
    energy = state[:, 3] ** 2 + state[:, 4] ** 2 + 0.5 * drawn.inertia * state[:, 5] ** 2
    assert np.all(np.diff(energy) <= 1e-15)


@claiming(Claim.ORDER)
@given(drawn=scenes())
@repeatable(15)
def test_errors_fall_as_fast_as_the_steps_or_faster_through_whatever_changes(
    solver: Solver, drawn: Drawn
) -> None:
    known, events = ran(SOLVERS["exact"], drawn, 300_000_000)
    assume(known.status[0].state == "moving" and not _short_stay(events))

    def worst(steps: list[float]) -> float:
        stepped = [replace(solver, settings=solver.settings | {"step_s": step}) for step in steps]
        ends = [ran(one, drawn, 300_000_000)[0].state for one in stepped]
        return float(max(np.abs(end - known.state).max() for end in ends))

    # one step length may be right by luck, even several may; of what a change of supports costs at most, the pull of a
    # wheel that runs at 1 m/s for a step of the fine ones, no luck is needed
    coarse = np.array([8e-3, 6e-3, 5e-3, 4.3e-3])
    least = MU * G * coarse.max() / 64.0 * len(events)
    assert worst((coarse / 64.0).tolist()) <= max(4.0 / 64.0 * worst(coarse.tolist()), least) + 1e-9
