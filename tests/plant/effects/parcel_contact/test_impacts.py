"""Impacts of several pairs at an instant, restitution near the speed that does not bounce, and what is left."""

from __future__ import annotations

import numpy as np
import pytest

from plant.effects.parcel_contact import resolve
from plant.kernels.contact import layout as to
from plant.plant import Plant
from tests.plant.effects.parcel_contact.benches import BOX, box, least_gap, plant, run, still, ticks

SPEED = 0.5
SLOW = 0.01


def cradle(count: int, impacts: str, restitution: float = 1.0) -> Plant:
    """A box that flies at a row of others that touch."""
    row = [box(-0.3 + 5e-10 * k + k * BOX, 0.0) for k in range(count)]
    thrown = box(-0.3 - BOX - 0.01, 0.0, velocity_m_s=(SPEED, 0.0))
    return plant(thrown, *row, restitution=restitution, impacts=impacts)


def test_a_sequence_of_impacts_sends_out_the_last_box_of_a_cradle() -> None:
    bench = cradle(3, "sequential")
    run(bench, still(bench), 0.1)
    assert bench.state[:, 3] == pytest.approx([0.0, 0.0, 0.0, SPEED], abs=1e-9)


def test_a_simultaneous_impact_shares_among_all() -> None:
    # momentum, and the struck face opening at the speed it closed with; the others move on together
    bench = cradle(2, "simultaneous")
    run(bench, still(bench), 0.1)
    assert bench.state[:, 3] == pytest.approx([-SPEED / 3.0, 2.0 * SPEED / 3.0, 2.0 * SPEED / 3.0], abs=1e-9)


@pytest.mark.parametrize("impacts", ["sequential", "simultaneous"])
@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_momentum_stays_and_energy_never_grows(impacts: str, restitution: float) -> None:
    bench = cradle(3, impacts, restitution)
    energy = float(np.sum(bench.state[:, 3:5] ** 2))
    for _ in ticks(bench, still(bench), 40):
        assert bench.state[:, 3].sum() == pytest.approx(SPEED, abs=1e-9)
        now = float(np.sum(bench.state[:, 3:5] ** 2))
        assert now <= energy + 1e-9
        energy = now
        assert least_gap(bench) >= 0.0


@pytest.mark.parametrize(("closing", "share"), [(0.9, 0.0), (1.25, 0.25), (1.5, 0.5), (2.0, 1.0), (3.0, 1.0)])
def test_restitution_grows_from_the_speed_that_does_not_bounce_to_twice_that(
    closing: float, share: float
) -> None:
    thrown = box(-BOX - 1e-4, 0.0, velocity_m_s=(closing * SLOW, 0.0))
    bench = plant(thrown, box(0.0, 0.0), restitution=0.8, bounce_speed_m_s=SLOW)
    run(bench, still(bench), 0.1)
    apart = bench.state[1, 3] - bench.state[0, 3]
    assert apart == pytest.approx(0.8 * share * closing * SLOW, abs=1e-9)


def test_what_is_left_of_a_contact_problem_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    note = resolve.Resolution._note_left

    def leave(one: resolve.Resolution) -> None:
        one._work.left[to.ERROR] = 1e-3
        one._work.impulses.tally[to.SLIPPERY] = 2
        note(one)

    monkeypatch.setattr(resolve.Resolution, "_note_left", leave)
    bench = cradle(2, "simultaneous")
    _, events = bench.advance(still(bench), 100_000_000)
    (told,) = (event for event in events if event.kind == "contact_residual")
    assert told.detail == (
        "among parcels [0, 1, 2]: 2 problems solved without friction; velocities miss by up to 0.001 m/s"
    )


def test_deep_overlap_is_taken_out_about_the_centre_of_mass_and_told() -> None:
    bench = plant(box(-0.3, 0.0), box(0.3, 0.05, 0.2), mu=0.5)
    state = bench.state[1].copy()
    state[:2] = -0.1, 0.02
    bench._solver.set_state(1, state)
    middle = bench.state[:, :2].mean(axis=0)
    assert least_gap(bench) < -0.04
    (told,) = (event for event in run(bench, still(bench), 0.004_096) if event.kind == "parted")
    assert "overlap of up to 0.0" in told.detail
    assert 0.0 <= least_gap(bench) < 1e-3
    assert bench.state[:, :2].mean(axis=0) == pytest.approx(middle, abs=1e-12)
