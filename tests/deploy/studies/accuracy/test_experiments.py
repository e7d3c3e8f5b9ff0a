"""What the page on accuracy says is so: each section's numbers, beside something that was not made for it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deploy.studies.accuracy.experiments import chatter, continuum, graze, paper
from deploy.studies.accuracy.experiments.paper import Oscillator
from deploy.studies.accuracy.experiments.runs import changes_at, max_displacement_m, run, scene_with
from plant.array import CellArray

# --- from cells to a continuous surface -----------------------------------------------------------


@pytest.fixture(scope="module")
def pitches() -> list[continuum.ContinuumRow]:
    return continuum.measure()


def test_the_torque_tends_to_that_of_the_continuous_surface_by_the_printed_digits(
    pitches: list[continuum.ContinuumRow],
) -> None:
    assert [f"{row.rms:.4f}" for row in pitches] == ["0.0877", "0.0257", "0.0115", "0.0029"]
    assert [row.steps for row in pitches] == [176, 800, 3200, 13168]


def test_at_unit_pitch_it_is_what_a_sum_over_the_lattice_gives(pitches: list[continuum.ContinuumRow]) -> None:
    """With the centre on a cell loads are equal, and the torque is that of the mean of x y over the cells below."""
    grid = np.arange(-8.0, 9.0)
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
    angles = np.arange(0.0, 2.0 * np.pi, math.radians(0.05))
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    length, width = continuum.SIZE_M
    below = (np.abs(c * x + s * y) <= length / 2) & (np.abs(c * y - s * x) <= width / 2)
    mean = (below * x * y).sum(axis=1) / below.sum(axis=1)
    peak = (length**2 - width**2) / 24.0
    error = np.sqrt(np.mean((mean - peak * np.sin(2.0 * angles)) ** 2)) / peak
    assert pitches[0].sampled == pytest.approx(error, abs=1e-12)
    assert pitches[0].most == pytest.approx(np.abs(mean).max() / peak, rel=1e-12)


def test_the_integral_of_the_error_is_the_limit_of_ever_finer_samples(
    pitches: list[continuum.ContinuumRow],
) -> None:
    row = pitches[0]
    angles = (np.arange(400_000) + 0.5) * (2.0 * np.pi / 400_000)
    error = row.profile.torque_at(angles) - row.peak_n_m * np.sin(2.0 * angles)
    assert row.rms * abs(row.peak_n_m) == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-4)


# --- the graze ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def elliptic() -> graze.ExperimentTrace:
    return run(scene_with("elliptic", f"duration_s={graze.SECONDS}"), graze.settings("exact", 1e-12))


def test_the_corner_clips_the_cell_for_six_milliseconds(elliptic: graze.ExperimentTrace) -> None:
    assert graze.dwell_interval(elliptic) == pytest.approx((0.8035599651, 0.8098409086), abs=1e-9)


def test_dop853_finds_the_graze_late_at_a_tolerance_of_1e_12_and_stays_off(
    elliptic: graze.ExperimentTrace,
) -> None:
    pytest.importorskip("scipy")
    scene = scene_with("elliptic", f"duration_s={graze.SECONDS}")
    found = run(scene, graze.settings("DOP853", 1e-12))
    assert graze.dwell_interval(found)[0] - graze.dwell_interval(elliptic)[0] > 1e-3
    assert max_displacement_m(found, elliptic)[-1] > 1e-6


def test_every_first_step_of_dop853_ends_past_the_graze_with_the_cell_outside(
    elliptic: graze.ExperimentTrace,
) -> None:
    pytest.importorskip("scipy")
    enters, leaves = graze.dwell_interval(elliptic)
    since = max(event.time_s for event in elliptic.events if event.time_s < enters)
    steps = graze.steps_through(graze.CELL, since, leaves)
    time, depth = steps.trace
    # on these supports, written again from the equations, the cell comes in when the exact solver says
    inside = int(np.argmax(depth > 0.0))
    assert np.interp(0.0, depth[inside - 1 : inside + 1], time[inside - 1 : inside + 1]) == pytest.approx(
        enters, abs=1e-8
    )
    for tolerance, (ends, depths) in steps.ends.items():
        assert ends[1] > leaves + 0.01, tolerance
        assert depths[:2].max() < 0.0 < depth.max()


# --- chatter --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "cell", "known"),
    [
        ((0.68, 0.42), (8, 13), 0.17925400095),
        ((0.72, 0.42), (12, 12), 0.149413822985),
        ((0.40, 0.42), (11, 11), 1.125235075),
    ],
)
def test_a_parcel_that_chatters_rests_with_a_cell_on_its_edge(
    size: tuple[float, float], cell: tuple[int, int], known: float
) -> None:
    """The closed form, the angles known from elsewhere after 20 s, and a captured run after 40 s."""
    scene = scene_with("elliptic", "duration_s=40.0", f"parcels.0.size_m=[{size[0]}, {size[1]}]")
    array = CellArray(scene.array)
    rest = chatter.resting_angle(array.positions_m[array.lattice.index(cell)], size, known)
    assert rest == pytest.approx(known, abs=1e-8)
    x, y = array.positions_m[array.lattice.index(cell)]
    along, across = math.cos(rest) * x + math.sin(rest) * y, math.cos(rest) * y - math.sin(rest) * x
    assert min(abs(abs(along) - size[0] / 2), abs(abs(across) - size[1] / 2)) < 1e-15
    settled = run(scene, {"name": "exact", "tolerance": 1e-12}, sample_s=40.0)
    assert settled.state[-1, 2] == pytest.approx(rest, abs=1e-12)
    assert settled.changes < 250


def test_located_crossings_grow_until_a_run_in_ticks_may_not_go_on() -> None:
    scene = scene_with("elliptic", "duration_s=20.0", "parcels.0.size_m=[0.68, 0.42]")
    times = np.arange(1.0, 21.0)
    captured, located = (
        changes_at(scene, {"name": "exact", "tolerance": 1e-12, "capture_m": capture}, times)
        for capture in (1e-6, chatter.LOCATED_M)
    )
    assert len(captured) == 20
    assert captured[-1] == 150
    assert len(located) == 18
    # twice as many every second and more, once nothing else happens
    assert np.all(np.diff(located[12:]) > 2.0 * np.diff(located[11:-1]))


# --- the paper's simulations ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def simulations() -> dict[str, paper.PaperRun]:
    return {one.scene.name: one for one in paper.measure()}


def test_x_and_y_are_underdamped_and_of_second_order(simulations: dict[str, paper.PaperRun]) -> None:
    for name in ("elliptic", "misaligned"):
        for swing in simulations[name].swings:
            assert swing.oscillator is not None
            assert swing.oscillator.damping < 1.0
            assert swing.off_m is not None
            assert swing.off_m < 1e-12
            assert swing.overshoot == pytest.approx(swing.oscillator.overshoot, rel=1e-5)
            assert swing.overshoot_s == pytest.approx(swing.oscillator.overshoot_s, abs=1e-3)


def test_parcels_settle_aligned_well_off_zero_and_off_zero(simulations: dict[str, paper.PaperRun]) -> None:
    askew = {name: math.degrees(one.askew_rad) for name, one in simulations.items()}
    assert abs(askew["elliptic"]) < 1.0
    assert askew["misaligned"] == pytest.approx(13.26, abs=0.01)
    assert askew["squeeze"] == pytest.approx(1.45, abs=0.01)
    assert simulations["squeeze"].swings[0].oscillator is None


def test_each_rests_at_an_orientation_that_attracts(simulations: dict[str, paper.PaperRun]) -> None:
    for one in simulations.values():
        assert one.rests_at is not None
        assert one.rests_at in one.stable


def test_the_oscillator_s_overshoot_is_that_of_its_equation_integrated() -> None:
    integrate = pytest.importorskip("scipy.integrate").solve_ivp
    own = Oscillator(kappa=1.962, k=-2.0)
    turned = lambda t, y: y[1]  # noqa: E731 - back at rest
    turned.direction = 1.0
    found = integrate(
        lambda t, y: [y[1], own.kappa * (own.k * y[0] - y[1])],
        (1e-3, 5.0),
        [0.5, 0.0],
        events=turned,
        rtol=1e-10,
        atol=1e-12,
    )
    assert found.t_events[0][0] - 1e-3 == pytest.approx(own.overshoot_s, abs=1e-6)
    assert found.y_events[0][0][0] == pytest.approx(-0.5 * own.overshoot, abs=1e-8)
