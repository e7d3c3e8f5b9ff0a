"""One SCI that is led from side to side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bus.lattice import OPPOSITE, Lattice
from cell_firmware.effects.serial.mux import LineMultiplexer
from cell_firmware.effects.serial.timing import LineSettings
from cell_firmware.firmware import Cells
from tests.cell_firmware.effects.serial.line import BIT_NS, EAST, ONE_BYTE, PERIOD_NS, Pair, ReceiverBench


def test_neighbours_whose_counts_agree_face_each_other_and_every_side_has_its_dwell(
    grid: Callable[..., Lattice], everything: Callable[..., Cells]
) -> None:
    lattice, dwell = grid(3, 4), 3
    cells, scan = everything(lattice), LineMultiplexer(dwell)
    state = scan.init(cells)
    turns = np.zeros((len(lattice), 4), dtype=int)
    for period in range(4 * dwell):
        state, left = scan.advance(np.array([period * PERIOD_NS]), state)
        assert ((left > 0).sum(axis=1) == 1).all()
        assert (left.max(axis=1) == dwell - period % dwell).all()
        faces = left > 0
        turns += faces
        for cell in range(len(lattice)):
            for side in np.flatnonzero(faces[cell] & cells.has_neighbour[cell]).tolist():
                assert faces[lattice.neighbours[cell, side], OPPOSITE[side]]
    assert (turns == dwell).all()


def talk(pair: Pair, periods: int) -> None:
    for k in range(periods):
        pair.step((k % 256,), back=(k % 256,))


def test_with_equal_clocks_every_byte_is_received_in_its_side_s_turn() -> None:
    pair = Pair(LineSettings(BIT_NS, PERIOD_NS, dwell_periods=5), ONE_BYTE)
    talk(pair, 100)
    assert pair.counted("unheard") == pair.counted("unheard", 0, EAST) == 0
    # East and west face each other from 5 to 10, from 25 to 30, and so on; each period has room for its message.
    assert {start // PERIOD_NS % 20 for start, _ in pair.starts} <= {5, 6, 7, 8, 9}
    assert pair.received[0] == (6, (5,))
    assert pair.counted("damaged") == 0
    assert pair.counted("received") == pair.counted("sent", 0, EAST) == 5 * 5 * 2


@pytest.mark.parametrize("polled", [False, True])
def test_a_message_begins_only_where_it_ends_within_the_dwell(polled: bool) -> None:
    message = np.dtype([("a", "<u8")])  # nine bytes
    dwell = 10 if polled else 3
    pair = Pair(LineSettings(BIT_NS, PERIOD_NS, 0 if polled else 16, dwell_periods=dwell), message)
    for k in range(12 * dwell):
        pair.step((k,))
    begins = [start // PERIOD_NS for start, _ in pair.starts[::9]]
    # 9.36 ms of three periods, or nine periods of ten: one in a dwell, at its beginning
    assert begins == [dwell, 5 * dwell, 9 * dwell]
    assert [value for _, (value,) in pair.received] == begins


@pytest.mark.parametrize("shift", [1, 2, 5, 10])
def test_cells_whose_scans_are_apart_lose_what_comes_to_a_side_that_is_not_selected(shift: int) -> None:
    pair = Pair(LineSettings(BIT_NS, PERIOD_NS, dwell_periods=5), ONE_BYTE)
    periods: Any = pair.state["periods"] + np.array([0, shift])
    pair.state = {**pair.state, "periods": periods}
    talk(pair, 100)
    sent, unheard = pair.counted("sent", 0, EAST), pair.counted("unheard")
    assert pair.counted("received") + unheard == sent
    if shift >= 5:
        assert (unheard, pair.received) == (sent, [])
    else:
        assert 0 < unheard < sent
        assert len(pair.received) > 0


@pytest.mark.parametrize("clocks", [None, (0, 0)])
def test_a_byte_in_transmission_as_the_switch_turns_to_its_side_is_not_received(
    clocks: tuple[int, int] | None,
) -> None:
    """With clocks of their own all comes a window and a bit later than on the line."""
    late_ns = 0 if clocks is None else PERIOD_NS + BIT_NS
    for missed in (0, 1):
        bench = ReceiverBench(LineSettings(BIT_NS, PERIOD_NS, dwell_periods=1), ONE_BYTE, clocks)
        # cell 0,1 has ended its second period, and turned to its third side, west's
        since = np.full(2, PERIOD_NS + late_ns + missed)
        bench.state = {**bench.state, "periods": np.array([2, 2]), "since_ns": since}
        bench.tick(2, 4 * PERIOD_NS, [(0, b"7")])
        assert (bench.counted("received"), bench.counted("unheard")) == (1 - missed, missed)
