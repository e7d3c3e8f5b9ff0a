"""Coulomb's law against a solution that steps in no way like the plant: event-driven, by Filippov's rule."""

from __future__ import annotations

import numpy as np
import pytest

from plant.friction.coulomb import Coulomb
from tests.plant.filippov import Filippov, LiftedError
from tests.plant.laws import CONE, COULOMB, DAMPED, MU, STATIC
from tests.plant.scenes import SECOND, Floats, G, bench, parcel, solved
from tests.plant.slipping import (
    HEAVY,
    LOADED,
    controlled,
    distance_m_of,
    make_scene,
    make_wide_scene,
    off_m,
    solve_loaded_reference,
    solve_reference,
)

SEEDS = range(60)
"""Scenes tried; those in which a support is lifted are beyond the reference."""


def test_the_reference_has_a_block_reach_its_wheels_when_it_should_and_stick() -> None:
    """At V / (mu g), by both axes alike; the rest of the way at the wheels' speed."""
    body = parcel(size_m=(0.5, 0.5), position_m=(0.0, 0.0), angle_rad=0.0)
    plant = solved({"name": "implicit"}, body, law=COULOMB, rows=3, columns=3, pitch_m=0.16)
    reference = Filippov(bench(plant, np.full((9, 2), [0.2, 0.1]), mu=MU))
    ended = reference.run(plant.state[0], 0.1)
    (first, *_), (last, *_) = reference.events[0], reference.events[-1]
    assert (first, last) == pytest.approx((0.1 / (MU * G), 0.2 / (MU * G)), abs=1e-13)
    assert reference.modes[-1] == (18, 0)
    assert ended[3:] == pytest.approx([0.2, 0.1, 0.0], abs=1e-13)
    assert ended[:2] == pytest.approx([0.2 * (0.1 - 0.5 * last), 0.1 * (0.1 - 0.5 * first)], abs=1e-13)


@pytest.mark.parametrize("seed", [0, 1])
def test_coulomb_keeps_its_tolerance_against_the_reference(seed: int) -> None:
    reference, known = solve_reference(seed)
    assert len(reference.events) >= 3
    for tolerance in (1e-4, 1e-6):
        assert off_m(seed, controlled(tolerance), known) <= tolerance


def test_a_step_ends_where_a_wheel_begins_or_ceases_to_slip_instead_of_shrinking() -> None:
    """Of some ten such events in a scene each would take some fifty steps that shrink."""
    for seed in range(6):
        plant, drives = make_scene(seed, controlled(1e-6))
        plant.advance(drives, SECOND // 2)
        assert plant.effort < 200


def test_slips_are_located_on_wheels_that_feel_their_load_and_on_cells_with_one_limit() -> None:
    """In steps that shrink these scenes take 1,490 and 5,541."""
    steps = {"cone": 0, "loaded": 0}
    for seed in range(5):
        for name, (law, effects) in {"cone": (CONE, None), "loaded": (COULOMB, LOADED)}.items():
            plant, drives = make_scene(seed, controlled(1e-6), law, effects)
            plant.advance(drives, SECOND // 2)
            steps[name] += plant.effort
    assert steps["cone"] < 1200
    assert steps["loaded"] < 2000


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_wheels_that_feel_their_load_keep_the_tolerance_against_a_reference_of_their_own(
    request: pytest.FixtureRequest,
) -> None:
    kinds: list[str] = []
    for seed in range(20 if request.config.getoption("nightly") else 3):
        reference, known = solve_loaded_reference(seed)
        kinds += [kind for _, kind, _ in reference.events]
        for tolerance in (1e-4, 1e-6, 1e-8):
            assert off_m(seed, controlled(tolerance), known, effects=HEAVY) <= 0.5 * tolerance, (
                seed,
                tolerance,
            )
    assert kinds.count("slip ends") > 20
    assert kinds.count("stick ends") > 0


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("effects", [None, LOADED], ids=["driven", "loaded"])
def test_time_stepping_tends_to_the_ends_of_located_slips_on_cells_with_one_limit(
    request: pytest.FixtureRequest, effects: dict[str, object] | None
) -> None:
    """Steps of one length are Moreau's, and know nothing of where slips begin and end."""
    steps = [4e-3 * 0.5**k for k in range(9)]
    for seed in range(20 if request.config.getoption("nightly") else 6):
        plant, drives = make_scene(seed, controlled(1e-8), CONE, effects)
        plant.advance(drives, SECOND // 2)
        known = plant.state[0].copy()
        off = [off_m(seed, {"name": "implicit", "step_s": step}, known, CONE, effects) for step in steps]
        slope = float(np.polyfit(np.log(steps), np.log(off), 1)[0])
        assert 0.8 < slope < 1.3, (seed, slope)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_coulomb_keeps_its_tolerance_against_the_reference_in_every_scene(
    request: pytest.FixtureRequest,
) -> None:
    tried = SEEDS if request.config.getoption("nightly") else SEEDS[:24]
    kinds: list[str] = []
    scenes = 0
    off: list[float] = []
    for seed in tried:
        try:
            reference, known = solve_reference(seed)
        except LiftedError:
            continue
        scenes += 1
        kinds += [kind for _, kind, _ in reference.events]
        for tolerance in (1e-4, 1e-6, 1e-8, 1e-10):
            off.append(off_m(seed, controlled(tolerance), known) / tolerance)
            assert off[-1] <= 1.0, (seed, tolerance)
    assert scenes >= 0.9 * len(tried)
    assert {kind: 6 * kinds.count(kind) >= len(tried) for kind in ("slip ends", "stick ends", "edge")} == {
        "slip ends": True,
        "stick ends": True,
        "edge": True,
    }


def test_chatter_at_an_edge_is_captured_under_a_law_without_series() -> None:
    """In steps that overlook the edge the velocity is wrong by the root of ``capture_m``: by hundreds of tolerances."""
    law = Coulomb(law="coulomb", coefficient=MU, viscous_n_s_per_m=30.0)
    ends: list[Floats] = []
    for tolerance in (1e-6, 1e-8):
        plant, drives = make_wide_scene(0, controlled(tolerance), law, 4.0)
        _, events = plant.advance(drives, SECOND // 2)
        assert "captured" in [event.kind for event in events]
        ends.append(plant.state[0])
    assert ends[0] == pytest.approx(ends[1], abs=1e-7)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("seed", "motors"), [(17, False), (11, True)])
def test_a_static_force_falls_when_it_should(seed: int, motors: bool) -> None:
    """By the force of a step's last part, that of its middle, it falls half a part too early: ten tolerances off."""
    law = Coulomb(law="coulomb", coefficient=MU, static_coefficient=0.45, viscous_n_s_per_m=0.1)
    ends: list[Floats] = []
    for tolerance in (1e-8, 1e-9):
        plant, drives = make_wide_scene(seed, controlled(tolerance), law, 4.0, motors=motors)
        plant.advance(drives, SECOND // 2)
        ends.append(plant.state[0])
    assert ends[0][:3] == pytest.approx(ends[1][:3], abs=1e-9)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("law", [COULOMB, DAMPED, STATIC], ids=["coulomb", "damped", "static"])
@pytest.mark.parametrize("spin_rad_s", [4.0, 30.0])
@pytest.mark.parametrize(
    "motors", [False, pytest.param(True, marks=pytest.mark.nightly)], ids=["driven", "motors"]
)
def test_coulomb_keeps_its_tolerance_on_wheels_that_lag_and_under_parcels_that_spin(
    motors: bool, spin_rad_s: float, law: Coulomb
) -> None:
    """Twenty scenes each, four kinds of field, beside a tolerance that is a thousand times finer."""
    for seed in range(20):
        ends: list[Floats] = []
        for tolerance in (1e-6, 1e-9):
            plant, drives = make_wide_scene(seed, controlled(tolerance), law, spin_rad_s, motors=motors)
            plant.advance(drives, SECOND // 2)
            ends.append(plant.state[0])
        assert ends[0] == pytest.approx(ends[1], abs=1e-6), seed


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("others", "motors", "seeds"),
    [
        ({"load_transfer": {"centre_of_mass_height_m": 0.06}}, True, (6, 16)),
        ({"wheel_load": {"inertia_kg": 0.05}}, True, (4, 16)),
    ],
    ids=["load_transfer", "wheel_load"],
)
def test_coulomb_keeps_within_ten_tolerances_with_effects_on_loads_and_wheels(
    others: dict[str, object], motors: bool, seeds: tuple[int, ...]
) -> None:
    """Scenes in which a corner clips a cell, and a slip ends where a cell leaves."""
    for seed in seeds:
        ends: list[Floats] = []
        for tolerance in (1e-6, 1e-8, 1e-9):
            plant, drives = make_wide_scene(
                seed, controlled(tolerance), COULOMB, 10.0, motors=motors, others=others
            )
            plant.advance(drives, SECOND // 2)
            ends.append(plant.state[0])
        assert distance_m_of(ends[0], ends[2]) < 1e-5, seed
        assert distance_m_of(ends[1], ends[2]) < 1e-7, seed


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(("width_m", "seeds"), [(0.012, (0, 9, 17, 18)), (5e-4, (4, 16, 19))])
def test_slips_are_located_between_the_ramps_of_wheels_with_a_width(
    width_m: float, seeds: tuple[int, ...]
) -> None:
    """Steps that shrink are off by seven tolerances, loads of a part's begin by one and a half."""
    for seed in seeds:
        ends: list[Floats] = []
        for tolerance in (1e-6, 1e-8, 1e-10):
            plant, drives = make_wide_scene(
                seed, controlled(tolerance), COULOMB, 10.0, others={"contact_width": {"width_m": width_m}}
            )
            plant.advance(drives, SECOND // 2)
            ends.append(plant.state[0])
        assert distance_m_of(ends[0], ends[2]) < 1e-7, seed
        assert distance_m_of(ends[1], ends[2]) < 1e-9, seed


@pytest.mark.slow
def test_wheels_in_a_row_about_one_that_sticks_cease_to_slip_at_one_instant() -> None:
    """Three on a line do where the parcel turns as the field does. Then the static limit holds all."""
    law = Coulomb(law="coulomb", coefficient=MU, static_coefficient=0.45, viscous_n_s_per_m=0.1)
    ends: list[Floats] = []
    for tolerance in (1e-9, 1e-10, 1e-11):
        plant, drives = make_wide_scene(13, controlled(tolerance), law, 30.0)
        plant.advance(drives, SECOND // 2)
        ends.append(plant.state[0])
    assert distance_m_of(ends[0], ends[2]) < 1e-9
    assert distance_m_of(ends[1], ends[2]) < 1e-10


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_time_stepping_tends_to_the_reference_at_first_order_over_ten_halvings() -> None:
    """Steps of one length are Moreau's: velocity and impulses of the end of a step, supports of its begin."""
    steps = [2e-2 * 0.5**k for k in range(11)]
    slopes: list[float] = []
    for seed in SEEDS[:24]:
        _, known = solve_reference(seed)
        off = [off_m(seed, {"name": "implicit", "step_s": step}, known) for step in steps]
        slopes.append(float(np.polyfit(np.log(steps), np.log(off), 1)[0]))
        assert off[-1] < 3e-3 * off[0], seed
    assert min(slopes) > 0.9
    assert max(slopes) < 1.2
    assert np.median(slopes) == pytest.approx(1.0, abs=0.03)
