"""Cells that talk over serial lines, among each other and with the other effects."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.clocks import ArrayClocks, CellClocks
from cell_firmware.effects.link_delay import LinkDelaySpec
from cell_firmware.effects.link_loss import LinkLossSpec
from cell_firmware.effects.registry import CellEffects
from cell_firmware.effects.serial.spec import SerialSpec
from cell_firmware.specs import CellsSpec
from tests.cell_firmware.effects.links import Stamper, received_on

Grid, Run = Callable[..., Lattice], Callable[..., Any]
PERIOD_NS = 4_096_000
CLEAN = ("serial.overruns", "serial.framing", "serial.damaged", "serial.unheard")


def serial(**settings: Any) -> CellEffects:
    return CellEffects(serial=SerialSpec(**settings))


@pytest.mark.parametrize(
    ("settings", "first", "every"),
    [
        # eight bytes to the last one's start, and 1.976 ms; ten characters from message to message
        ({}, 3, 10 * 1.040 / 4.096),
        ({"ring_bytes": 0}, 10, 10.0),  # a byte a period, and one without
        ({"baud": 125_000}, 1, 1.0),
    ],
)
def test_every_link_brings_messages_as_late_and_as_often_as_its_bytes_allow(
    settings: dict[str, Any], first: int, every: float, grid: Grid, run: Run
) -> None:
    received, counted = received_on(grid(3, 3), run, 120, serial(**settings))
    assert (received == received[:, :1]).all()  # all cells began together
    ticks = np.flatnonzero(received[:, 0] >= 0)
    assert ticks[0] == first
    assert np.diff(ticks).mean() == pytest.approx(every, abs=0.05)
    assert [counted[name] for name in CLEAN] == [0, 0, 0, 0]


MANY = {
    "ring": serial(),
    "polled": serial(ring_bytes=0),
    "mux": serial(sharing="mux"),
    "lossy": CellEffects(
        serial=SerialSpec(),
        link_loss=LinkLossSpec(probability=0.1),
        link_delay=LinkDelaySpec(between_ticks=(0, 3), ordered=False),
    ),
}


@pytest.mark.parametrize("effects", MANY.values(), ids=MANY.keys())
@pytest.mark.parametrize("own_clocks", [False, True])
def test_cells_receive_and_count_the_same_for_every_partition(
    effects: CellEffects, own_clocks: bool, grid: Grid, run: Run
) -> None:
    lattice = grid(2, 4, missing=[(1, 1)])
    n = len(lattice)
    clocks = None
    if own_clocks:
        rng = np.random.default_rng(3)
        ppb, phase = rng.integers(-60_000_000, 60_000_000, n), rng.integers(0, PERIOD_NS, n)
        window_ns = PERIOD_NS * 94 // 100
        clocks = ArrayClocks(lattice, CellClocks(PERIOD_NS, window_ns, ppb, phase))
    ran: list[Any] = []
    for shards in (1, n):
        firmware = Stamper()
        counted = run(
            firmware, Partition.even(lattice, shards), 60, dead={40: [(1, 3)]}, effects=effects, clocks=clocks
        ).counted
        ran.append((firmware.received, counted))
    assert ran[0] == ran[1]
    received, counted = ran[0]
    assert any(max(sides) >= 0 for sides in received.values())
    if own_clocks:
        assert counted["serial.framing"] > 0
    if effects is MANY["lossy"]:
        assert counted["serial.damaged"] > 0
        assert counted["link_loss.lost"] > 0


def test_with_good_crystals_at_any_phase_nothing_is_lost_and_words_take_a_window_more(
    grid: Grid, run: Run
) -> None:
    lattice = grid(2, 3)
    phase = np.random.default_rng(5).integers(0, PERIOD_NS, 6)
    ppb = np.array([50_000, -50_000, 20_000, 0, 7, -33_333])
    clocks = ArrayClocks(lattice, CellClocks(PERIOD_NS, PERIOD_NS * 999 // 1000, ppb, phase))
    firmware = Stamper()
    counted = run(firmware, Partition.even(lattice, 1), 200, effects=serial(), clocks=clocks).counted
    assert [counted[name] for name in CLEAN] == [0, 0, 0, 0]
    lags: set[int] = set()
    for (step, row, column), sides in firmware.received.items():
        for side, said in enumerate(sides):
            if said >= 0:
                i, j = lattice.index((row, column)), lattice.neighbours[lattice.index((row, column)), side]
                lags.add(int(phase[i] + step * PERIOD_NS - phase[j] - said * PERIOD_NS) // 1_000_000)
    # 10.3 ms for nine bytes and the idle line, a period and a bit for the exchange, up to a period until one looks,
    # and while it waits for the line to be free up to a period more than the word itself
    assert min(lags) >= 14
    assert max(lags) <= 10.3 + 4.2 + 2 * 4.1 + 1


@pytest.mark.parametrize(
    ("by_bytes", "damaged", "received"),
    [
        # a message each way, eight bytes of two periods' to the living, and three of the last period's to the dead
        (True, 1, 2 * 9 + 8 + 3),
        (False, 0, 2 * 9),  # lines that carry messages whole count whole ones
    ],
)
def test_what_a_cell_had_half_said_when_it_died_is_not_heard_and_nothing_comes_after(
    by_bytes: bool, damaged: int, received: int, grid: Grid, run: Run
) -> None:
    for shards in (1, 2):
        firmware = Stamper(every=10)
        partition = Partition.even(grid(1, 2), shards)
        counted = run(firmware, partition, 40, dead={12: [(0, 0)]}, effects=serial(), live=by_bytes).counted
        west = [firmware.received[tick, 0, 1][3] for tick in range(40)]
        assert [said for said in west if said >= 0] == [0]  # that of tick 10 takes three periods
        assert counted["serial.damaged"] == damaged
        assert counted["serial.received"] == received


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({"baud": 9600}, "the nearest is 9615"),
        ({"ring_bytes": 8}, "ring_bytes"),
        ({"bytes_per_period": 1}, "ring_bytes must be 0"),
        ({"ring_bytes": 0, "bytes_per_period": 3}, "bytes_per_period"),
        ({"dwell_periods": 4}, 'sharing must be "mux"'),
        ({"sharing": "dual_uart"}, "sharing"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        SerialSpec.model_validate(settings)


def test_lines_that_would_never_bring_a_message_are_refused_with_the_scene() -> None:
    heat = CellsSpec(firmware="heat_diffusion")
    effects = serial(sharing="mux", dwell_periods=4)
    ((path, _, rule),) = effects.fit_problems(heat)
    assert path == ("serial",)
    assert rule == "a message of 17 bytes takes 5 periods, and the switch stays on a side for 4"
    assert not list(serial(sharing="mux", dwell_periods=5).fit_problems(heat))
    assert not list(effects.fit_problems(CellsSpec(firmware="velocity_field")))  # which doesn't talk
