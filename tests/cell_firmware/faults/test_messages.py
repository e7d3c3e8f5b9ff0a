"""Cells that lie or babble, links that change bits, and what receivers refuse."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.stats import binom

from bus.lattice import Lattice
from bus.partition import Partition
from bus.wire.message_type import bounded_list
from cell_firmware.clocks import ArrayClocks, CellClocks
from cell_firmware.effects.registry import CellEffects
from cell_firmware.effects.serial.spec import SerialSpec
from cell_firmware.faults.kinds.lie import LieFault
from cell_firmware.faults.payload_bytes import flipped, random_bytes
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters
from cell_firmware.specs import CellsSpec
from tests.cell_firmware.faults.instances import instances

Grid = Callable[..., Lattice]
HERE = {"cell": (0, 0)}
MESSAGE = np.dtype([("real", "<f8"), ("small", "i1"), ("flag", "?")])


class Talker(Firmware):
    """Sends numbers that go up by the tick, and stores all that it receives.

    Attributes:
        received: By tick and cell, the four sides' ``(real, small, flag)``, None for nothing.
    """

    message = MESSAGE
    speculative = False

    def __init__(self) -> None:
        super().__init__(NoParameters())
        self.received: dict[tuple[int, int, int], list[Any]] = {}

    def init(self, cells: Cells) -> State:
        return {"tick": np.zeros(len(cells), dtype=np.int64), "row": cells.row, "column": cells.column}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        inbox, tick = inputs.inbox, state["tick"]
        assert inbox is not None
        for i, name in enumerate(
            zip(*(state[key].tolist() for key in ("tick", "row", "column")), strict=True)
        ):
            self.received[name] = [
                inbox.message[i, side].item() if inbox.received[i, side] else None for side in range(4)
            ]
        outbox = Outbox.to_all(self.message, real=tick / 8.0, small=tick % 100, flag=tick % 2 == 1)
        return {**state, "tick": tick + 1}, Outputs(np.zeros((len(tick), 2)), outbox)


def run_faults(
    grid: Grid,
    lockstep: Any,
    ticks: int,
    *faults: dict[str, Any],
    shards: int = 1,
    effects: CellEffects | None = None,
    windows: int = 0,
    size: tuple[int, int] = (1, 2),
    **times: int,
) -> tuple[dict[tuple[int, int, int], list[Any]], Counter[str]]:
    """What cells received, and what was counted."""
    lattice, clocks = grid(*size), None
    if windows:
        own = np.array([3_000, -4_000, 0, 1_000] * len(lattice))[: len(lattice)]
        window_ns = 4_096_000 * 99 // 100 // windows
        clocks = ArrayClocks(
            lattice, CellClocks(4_096_000, window_ns, own, np.arange(len(lattice)) * 700_000)
        )
    here = instances(
        lattice, *({**HERE, **fault} if "share" not in fault else fault for fault in faults), **times
    )
    firmware = Talker()
    steps = lockstep(firmware, Partition.even(lattice, shards), None, effects, 0, clocks, here)
    for _ in range(ticks):
        steps.step()
    assert not steps.failures
    return firmware.received, sum((shard.counters() for shard in steps.shards), Counter[str]())


def field(received: dict[tuple[int, int, int], list[Any]], name: str, ticks: range) -> list[Any]:
    """Of what 0,1 received of 0,0, in these ticks."""
    number = MESSAGE.names.index(name) if MESSAGE.names else 0
    return [received[tick, 0, 1][3][number] for tick in ticks]


@pytest.mark.parametrize("shards", [1, 2])
@pytest.mark.parametrize(
    ("lie", "real", "small"),
    [
        ({"mode": "stuck"}, lambda sent: 0.5, lambda sent: 4),
        ({"mode": "offset", "by": 120.4}, lambda sent: sent / 8 + 120.4, lambda sent: min(sent + 120, 127)),
        ({"mode": "factor", "by": -30.0}, lambda sent: sent / 8 * -30.0, lambda sent: max(-30 * sent, -128)),
        ({"mode": "factor", "by": 2.0, "field": "small"}, lambda sent: sent / 8, lambda sent: 2 * sent),
    ],
)
def test_a_lie_changes_the_numbers_that_neighbours_receive_and_no_other_cell_s(
    lie: dict[str, Any], real: Any, small: Any, shards: int, grid: Grid, lockstep: Any
) -> None:
    received, counted = run_faults(grid, lockstep, 14, {"kind": "lie", **lie}, shards=shards, first=5, end=12)
    sent = range(4, 11)
    assert field(received, "real", range(5, 12)) == [real(one) for one in sent]
    assert field(received, "small", range(5, 12)) == [small(one) for one in sent]
    assert field(received, "flag", range(5, 12)) == [one % 2 == 1 for one in sent], "booleans are no numbers"
    for tick in (1, 4, 12, 13):
        assert received[tick, 0, 1][3] == ((tick - 1) / 8, tick - 1, tick % 2 == 0)
    assert received[9, 0, 0][1] == (1.0, 8, False), "the other direction is as it was"
    assert counted["faults.lie.messages"] == 7


def test_a_random_lie_is_between_the_least_and_the_greatest_that_the_link_has_brought(
    grid: Grid, lockstep: Any
) -> None:
    received, _ = run_faults(grid, lockstep, 90, {"kind": "lie", "mode": "random"}, first=11)
    real, small = (np.array(field(received, name, range(11, 90))) for name in ("real", "small"))
    most = np.arange(10, 89)
    assert (real >= 10 / 8).all()
    assert (real <= most / 8).all()
    assert (small >= 10).all()
    assert (small <= most).all()
    share = (small[20:] - 10) / (most[20:] - 10)
    assert 0.35 < share.mean() < 0.65
    assert share.std() > 0.2


def test_what_sticks_stays_stuck_when_the_link_was_silent_for_a_while(grid: Grid, lockstep: Any) -> None:
    silence = {"kind": "link_down", "first": 7, "end": 9}
    received, _ = run_faults(grid, lockstep, 14, {"kind": "lie", "mode": "stuck"}, silence, first=5, end=12)
    assert [received[tick, 0, 1][3] for tick in (7, 8)] == [None, None]
    assert field(received, "real", range(5, 7)) == [0.5] * 2
    assert field(received, "real", range(9, 12)) == [0.5] * 3


def test_a_random_lie_stays_within_received_values_where_all_are_negative(grid: Grid, lockstep: Any) -> None:
    lies = ({"kind": "lie", "mode": "offset", "by": -100}, {"kind": "lie", "mode": "random"})
    silence = {"kind": "link_down", "first": 7, "end": 9}
    received, _ = run_faults(grid, lockstep, 30, *lies, silence, first=5)
    assert max(field(received, "real", range(9, 30))) <= 28 / 8 - 100
    assert max(field(received, "small", range(9, 30))) <= 28 - 100


def test_every_link_has_lies_of_its_own(grid: Grid, lockstep: Any) -> None:
    received, _ = run_faults(
        grid, lockstep, 12, {"kind": "lie", "mode": "random", "share": 1.0}, size=(2, 2), first=2
    )
    links = [(row, column, side) for row in (0, 1) for column in (0, 1) for side in range(4)]
    said = [[received[tick, row, column][side] for tick in range(4, 12)] for row, column, side in links]
    known = [tuple(one[0] for one in words) for words in said if None not in words]
    assert len(known) == len(set(known)) == 8


def test_a_restarted_cell_receives_no_messages_sent_before_its_restart(grid: Grid, lockstep: Any) -> None:
    received, counted = run_faults(grid, lockstep, 6, {"kind": "reboot"}, first=3, end=3)
    assert counted["faults.restarts"] == 1
    assert received[0, 0, 0] == [None] * 4, "its first period after the reset, which it counts from 0 again"
    assert received[1, 0, 0][1] == (3 / 8, 3, True)


@pytest.mark.parametrize(
    ("fault", "first"), [({"kind": "lie", "mode": "offset", "by": 50}, 9), ({"kind": "babble"}, 10)]
)
def test_with_clocks_of_their_own_words_are_changed_in_periods_that_begin_a_tick_before_they_act(
    fault: dict[str, Any], first: int, grid: Grid, lockstep: Any
) -> None:
    received, counted = run_faults(grid, lockstep, 20, fault, windows=1, first=10, end=13)
    plain, _ = run_faults(grid, lockstep, 20, windows=1)
    other = [tick for tick in range(19) if received[tick, 0, 1][3] != plain[tick, 0, 1][3]]
    assert other == [first, first + 1, first + 2], "what is babbled is heard a period after it was said"
    assert counted[f"faults.{fault['kind']}.messages"] == 3


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({"mode": "offset"}, "mode offset needs by"),
        ({"mode": "stuck", "by": 1.0}, "mode stuck takes no by; leave it out"),
    ],
)
def test_a_lie_says_by_how_much_where_that_is_to_be_said(settings: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        LieFault.model_validate({**HERE, **settings})


def test_a_lie_about_an_unknown_field_does_not_fit_the_cells() -> None:
    lie = LieFault.model_validate({**HERE, "mode": "stuck", "field": "temperature"})
    ((path, _, rule),) = lie.fit_problems(CellsSpec(firmware="heat_diffusion"), 1)
    assert path == ("field",)
    assert rule.endswith("vx_m_s, vy_m_s")


def test_the_requested_number_of_different_bits_is_flipped_each_equally_often() -> None:
    chance = np.random.default_rng(1).random((3_000, 5))
    count = np.full(3_000, 3)
    data = np.zeros((3_000, 4), dtype=np.uint8)
    bits = np.unpackbits(flipped(data, count, 5, chance), axis=1)
    assert (bits.sum(axis=1) == 5).all()
    assert not bits[:, 24:].any(), "what is not sent is not changed"
    for times in bits[:, :24].sum(axis=0).tolist():
        assert binom.ppf(1e-5, 3_000, 5 / 24) <= times <= binom.ppf(1 - 1e-5, 3_000, 5 / 24)
    assert (flipped(data[:1], np.array([0]), 5, chance[:1]) == 0).all()
    assert np.unpackbits(flipped(data[:1], np.array([1]), 64, np.zeros((1, 64)))).sum() == 8, (
        "there are no more"
    )


def test_corrupted_messages_differ_in_one_bit_and_a_float_that_is_none_is_refused(
    grid: Grid, lockstep: Any
) -> None:
    fault = {"kind": "link_corrupt", "probability": 0.5, "share": 1.0}
    received, counted = run_faults(grid, lockstep, 60, fault, size=(4, 4))
    changed = refused = 0
    for (tick, _row, _column), sides in received.items():
        for word in filter(None, sides):
            sent = np.array(((tick - 1) / 8, tick - 1, tick % 2 == 0), dtype=MESSAGE)
            got = np.array(word, dtype=MESSAGE)
            bits = np.bitwise_xor(
                np.frombuffer(sent.tobytes(), np.uint8), np.frombuffer(got.tobytes(), np.uint8)
            )
            assert np.isfinite(got["real"])
            assert int(np.unpackbits(bits).sum()) <= 1
            changed += bits.any()
    came = 59 * 48
    refused = came - sum(word is not None for sides in received.values() for word in sides)
    hits = counted["faults.link_corrupt.corrupted"]
    assert binom.ppf(1e-4, came, 0.5) <= hits <= binom.ppf(1 - 1e-4, came, 0.5)
    assert refused == counted["faults.words.refused"]
    # of 80 bits 8 are a boolean's: a true one stays true but for one of them
    assert hits - refused - changed <= hits * 0.1


def test_messages_that_no_cell_of_the_program_sends_are_refused(
    grid: Grid, lockstep: Any, monkeypatch: Any
) -> None:
    monkeypatch.setattr(Talker, "value_ranges", lambda _self: {"small": (0, 9)})
    lie = {"kind": "lie", "mode": "offset", "by": 3}
    received, counted = run_faults(grid, lockstep, 10, lie)
    assert [received[tick, 0, 1][3] is None for tick in range(1, 10)] == [False] * 7 + [True] * 2
    assert counted["faults.words.refused"] == 2


SERIAL = CellEffects(serial=SerialSpec(baud=9615))


@pytest.mark.parametrize("windows", [0, 1, 2])
@pytest.mark.parametrize("effects", [CellEffects(), SERIAL], ids=["whole", "serial"])
def test_a_babbling_cell_sends_noise_whatever_its_program_says_and_the_lockstep_goes_on(
    effects: CellEffects, windows: int, grid: Grid, lockstep: Any
) -> None:
    outcomes: list[Any] = []
    for shards in (1, 2):
        received, counted = run_faults(
            grid, lockstep, 80, {"kind": "babble"}, effects=effects, windows=windows, shards=shards, end=60
        )
        outcomes.append((received, counted))
        assert counted["faults.babble.messages"] >= 60 // max(windows, 1) - 2
        of_babbler = [
            sides[3]
            for (tick, _, column), sides in received.items()
            if column == 1 and tick < 50 // max(windows, 1)
        ]
        words = [word for word in of_babbler if word is not None]
        if effects is SERIAL:
            assert words == [], "no message ever ends"
            assert counted["serial.damaged"] > 0
        else:
            assert len(words) > len(of_babbler) // 2
            assert np.std([word[1] for word in words]) > 40, "all of a byte's values"
        last = max(tick for tick, _, column in received if column == 1)
        assert any(received[tick, 0, 1][3] for tick in range(last - 8, last + 1)), "it is heard again"
    assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize("windows", [0, 2])
def test_serial_lines_find_what_was_corrupted_on_them(windows: int, grid: Grid, lockstep: Any) -> None:
    clean, _ = run_faults(grid, lockstep, 200, effects=SERIAL, windows=windows)
    fault = {"kind": "link_corrupt", "probability": 0.1, "share": 1.0}
    received, counted = run_faults(grid, lockstep, 200, fault, effects=SERIAL, windows=windows)
    words, all_words = (
        [side for one in one_run.values() for side in one if side] for one_run in (received, clean)
    )
    assert counted["serial.damaged"] >= counted["faults.link_corrupt.corrupted"] // 2 > 0
    # one flipped bit a message is always found: what is received was sent
    assert set(words) < set(all_words)
    assert len(words) < len(all_words)


def test_a_sender_s_claim_of_more_bytes_than_a_window_holds_is_cut(grid: Grid, lockstep: Any) -> None:
    lattice = grid(1, 2)
    steps = lockstep(Talker(), Partition.even(lattice, 2), None, SERIAL, live=True)
    for _ in range(12):
        steps.step()
        for links in steps.links:
            links.sent[:] = True
            for name in ("bytes_1", "bytes_2"):
                links.message[name] = 0xFFFF
    assert not steps.failures


def test_noise_has_the_requested_number_of_bytes_and_all_values() -> None:
    class Half:
        def uniform(self, tick: int) -> NDArray[np.float64]:
            return np.random.default_rng(tick).random(1_200)

    data = random_bytes(Half(), 3, 600, 8)  # pyright: ignore[reportArgumentType]
    assert data.shape == (600, 8)
    assert len(np.unique(data)) == 256


class Vectors(Talker):
    """The same with a vector, a record and a list."""

    message = np.dtype(
        [
            ("pose", [("at", "<i2", (2,)), ("sure", "?")]),
            ("path", bounded_list("i1", 3)),
            ("real", "<f4", (2,)),
        ]
    )

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        inbox, tick = inputs.inbox, state["tick"]
        assert inbox is not None
        assert self.message is not None
        for i, name in enumerate(
            zip(*(state[key].tolist() for key in ("tick", "row", "column")), strict=True)
        ):
            got = inbox.message[i, 3]
            self.received[name] = [got["pose"]["at"].tolist(), got["path"].tolist(), got["real"].tolist()]
        outbox = Outbox.empty(len(tick), self.message)
        outbox.sent[...] = True
        outbox.message["pose"]["at"], outbox.message["real"][..., 1] = tick[:, None, None], 0.5
        outbox.message["path"]["length"], outbox.message["path"]["items"] = 2, 1
        return {**state, "tick": tick + 1}, Outputs(np.zeros((len(tick), 2)), outbox)


@pytest.mark.parametrize(
    ("lie", "expected"),
    [
        ({"by": 0.75, "field": "real"}, [[4, 4], (2, [1, 1, 0]), [0.75, 1.25]]),
        ({"by": 10.0, "field": "pose.at"}, [[14, 14], (2, [1, 1, 0]), [0.0, 0.5]]),
        ({"by": 9.0, "field": "path.items"}, [[4, 4], (2, [10, 10, 0]), [0.0, 0.5]]),
        ({"by": 9.0, "field": "path.length"}, [[4, 4], (3, [1, 1, 0]), [0.0, 0.5]]),
    ],
)
def test_a_lie_changes_numbers_in_records_vectors_and_lists(
    lie: dict[str, Any], expected: list[Any], grid: Grid, lockstep: Any
) -> None:
    lattice, firmware = grid(1, 2), Vectors()
    here = instances(lattice, {**HERE, "kind": "lie", "mode": "offset", **lie}, first=3)
    steps = lockstep(firmware, Partition.even(lattice, 1), None, None, 0, None, here)
    for _ in range(6):
        steps.step()
    assert not steps.failures
    got, (length, items), real = firmware.received[5, 0, 1]
    assert [got, (length, list(items)), real] == expected


@pytest.mark.parametrize("mode", ["stuck", "random"])
def test_a_lie_learns_vectors(mode: str, grid: Grid, lockstep: Any) -> None:
    lattice, firmware = grid(1, 2), Vectors()
    here = instances(lattice, {**HERE, "kind": "lie", "mode": mode, "field": "pose.at"}, first=3)
    steps = lockstep(firmware, Partition.even(lattice, 1), None, None, 0, None, here)
    for _ in range(30):
        steps.step()
    seen = [firmware.received[tick, 0, 1][0] for tick in range(3, 30)]
    if mode == "stuck":
        assert seen == [[2, 2]] * 27
    else:
        assert all(2 <= x <= tick - 1 for tick, pose in enumerate(seen, 3) for x in pose)
