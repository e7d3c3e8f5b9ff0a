"""The kit's protocols over 200 seeds: never outside of theory."""

from __future__ import annotations

import numpy as np
import pytest

from tests.cell_firmware.kit.trials import (
    GOSSIP_TICKS,
    LOSS,
    gossip_trials,
    slots_trials,
    synchroniser_trials,
    tree_trials,
)

SEEDS = range(1, 201)


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_trees_and_counts_are_right_within_their_bounds_from_any_registers_and_after_deaths() -> None:
    found = tree_trials(SEEDS)
    assert [one.what for one in found] == ["tree", "counts", "tree, after deaths", "counts, after deaths"]
    for one in found:
        assert (one.ticks <= one.bound).all(), one.what
        assert one.ticks.min() > 0, f"{one.what}: nothing was wrong in the beginning"


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_push_sum_loses_no_mass_and_converges_as_its_spectrum_has_it() -> None:
    found = gossip_trials(SEEDS)
    assert (found.mass_lost == 0).all()
    assert (found.share_of_bound <= 1.0).all()
    assert (found.perfect_ticks <= found.bound_ticks).all()
    assert (found.lossy_ticks < GOSSIP_TICKS).all()  # to the mean of the values, not to another one
    assert (found.lossy_ticks <= found.perfect_ticks / (1.0 - LOSS)).all()


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_slots_are_apart_at_distance_two_within_their_bound_from_any_registers_and_after_repairs() -> None:
    for one in slots_trials(SEEDS):
        assert (one.ticks <= one.bound).all(), one.what
        assert one.ticks.max() > 1, f"{one.what}: nothing was wrong in the beginning"


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_synchronised_rounds_have_the_bits_of_perfect_links() -> None:
    found = synchroniser_trials(SEEDS)
    assert (found.wrong == 0).all()
    assert np.unique(found.apart).tolist() == [1]
    assert (found.pulses > 20).all()
