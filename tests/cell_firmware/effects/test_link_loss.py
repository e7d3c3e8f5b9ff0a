"""Messages that never arrive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import binom

from bus.lattice import Lattice
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.link_loss import LinkLossSpec
from cell_firmware.effects.registry import CellEffects
from tests.cell_firmware.effects.links import received_on

Grid, Run = Callable[..., Lattice], Callable[..., Any]


def loss(probability: float) -> CellEffects:
    return CellEffects(link_loss=LinkLossSpec(probability=probability))


def test_messages_are_lost_at_the_requested_rate_and_each_is_counted(grid: Grid, run: Run) -> None:
    received, counted = received_on(grid(20, 20), run, 50, loss(0.07))
    lost = int((received[1:] < 0).sum())
    of = received[1:].size
    assert binom.ppf(1e-4, of, 0.07) <= lost <= binom.ppf(1 - 1e-4, of, 0.07)
    assert counted == {"link_loss.lost": lost}
    assert (
        received[1:][received[1:] >= 0] == np.nonzero(received[1:] >= 0)[0]
    ).all()  # what comes is of the tick before


def test_the_two_directions_of_a_link_and_neighbouring_ticks_lose_by_themselves(grid: Grid, run: Run) -> None:
    received, _ = received_on(grid(1, 2), run, 4001, loss(0.5))
    lost = received[1:] < 0
    for one, other in ((lost[:, 0], lost[:, 1]), (lost[1:, 0], lost[:-1, 0])):
        both = int((one & other).sum())
        assert binom.ppf(1e-4, len(one), 0.25) <= both <= binom.ppf(1 - 1e-4, len(one), 0.25)


def test_at_probability_one_nothing_is_received(grid: Grid, run: Run) -> None:
    received, counted = received_on(grid(3, 3), run, 9, loss(1.0))
    assert (received == -1).all()
    assert counted["link_loss.lost"] == 8 * 24


@pytest.mark.parametrize(("probability", "message"), [(0.0, "<i8"), (0.5, None)])
def test_with_nothing_to_lose_there_is_no_stage(probability: float, message: str | None) -> None:
    site = ShardContext(np.arange(4), 1, message and np.dtype([("a", message)]), 0)
    assert loss(probability).input_filters(site) == {"link_loss": ()}


def test_a_probability_is_required_and_at_most_one() -> None:
    for settings in ({}, {"probability": 1.01}):
        with pytest.raises(ValidationError, match="probability"):
            LinkLossSpec.model_validate(settings)
