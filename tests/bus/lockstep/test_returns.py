"""Cells that come back: a new process in the place of one that went."""

from __future__ import annotations

import time
from typing import Any, cast

import numpy as np
import pytest

from bus.errors import BarrierError, CoordinatorLostError, WireError
from bus.lattice import NO_TICK_LIMIT
from bus.lockstep import Loss, Participant
from bus.lockstep.counters import MessageCounters
from bus.lockstep.intervals import Membership
from bus.lockstep.liveness import LivenessTracker, RejoinTracker
from bus.lockstep.receive import EARLY_TICKS, FrameAssembler
from bus.partition import Partition
from bus.spec import StallSpec
from bus.wire.formats import WireFormat
from tests.bus.support import (
    MESSAGE,
    PRESENCE,
    Network,
    System,
    every_format,
    expected_drive,
    gathered,
    grid,
    step,
)


def _restarted(system: System, shard: int) -> Participant:
    """A new process for a shard, not yet ready."""
    endpoint = system.network.endpoint()
    system.member_endpoints[shard] = endpoint
    system.members[shard] = Participant(
        endpoint,
        system.partition,
        shard,
        system.form,
        run="test",
        readings=PRESENCE,
        message=system.message,
        joins=True,
    )
    return system.members[shard]


def _admitted(system: System, tick: int, shards: list[int]) -> tuple[int, list[int]]:
    """Ticks go by without the one that comes back until it is admitted: the tick, and the cells."""
    for now in range(tick, tick + 2000):
        cells = system.host.admit(now)
        if cells:
            return now, cells
        assert step(system, now, shards)[1] == []
    raise AssertionError("nobody was admitted")


def test_cells_come_back_to_a_run_that_has_lost_all_of_its_cells(network: Network) -> None:
    system = System(network, Partition.even(grid(1, 2), 1), "packed").start()
    step(system, 0)
    system.member_endpoints[0].close()
    assert {loss.cell for loss in step(system, 1, [])[1]} == {0, 1}
    assert system.host.admit(2) == []
    member = _restarted(system, 0)
    member.ready(10.0)
    first, cells = _admitted(system, 2, [])
    assert cells == [0, 1]
    assert member.join(10.0) == first
    assert step(system, first)[1] == []


def test_a_new_process_keeps_senses_that_come_with_its_admission_although_it_was_told_of_its_loss(
    network: Network,
) -> None:
    system = System(network, Partition.even(grid(1, 2), 2), "packed").start()
    step(system, 0)
    for shard in (0, 1):
        system.member_endpoints[shard].close()
    assert {loss.cell for loss in step(system, 1, [])[1]} == {0, 1}
    assert system.host.admit(2) == []
    first, second = _restarted(system, 0), _restarted(system, 1)
    first.ready(10.0)  # the second has subscribed, and hears at the first's admission who is dead
    now, cells = _admitted(system, 2, [])
    assert (cells, first.join(10.0)) == ([0], now)
    assert step(system, now, [0])[1] == []
    second.ready(10.0)
    admitted, cells = _admitted(system, now + 1, [0])
    system.host.publish(system.sense(admitted))
    time.sleep(0.1)  # the senses are there with the record of the admission
    assert (cells, second.join(10.0)) == ([1], admitted)
    gathered(second.gather(admitted, 10.0))


def test_a_process_that_was_too_slow_must_go_before_another_takes_its_place(network: Network) -> None:
    system = System(network, Partition.even(grid(1, 2), 2), "packed", stall=StallSpec(deadline_s=0.2)).start()
    step(system, 0)
    system.member_endpoints[1].close()
    assert [loss.reason for loss in step(system, 1, [0])[1]] == ["disconnected"]
    _restarted(system, 1).ready(10.0)
    first, _ = _admitted(system, 2, [0])
    assert [loss.reason for loss in step(system, first, [0])[1]] == ["timed_out"]
    for tick in range(first + 1, first + 50):
        assert system.host.admit(tick) == []
        step(system, tick, [0])


@every_format
def test_a_new_process_joins_at_a_tick_boundary_and_receives_no_earlier_messages(
    network: Network, form: WireFormat
) -> None:
    system = System(network, Partition.even(grid(2, 3), 3), form, message=MESSAGE).start()
    step(system, 0)
    system.member_endpoints[1].close()
    assert {loss.cell for loss in step(system, 1, [0, 2])[1]} == {2, 3}
    assert system.host.admit(2) == []
    member = _restarted(system, 1)
    member.ready(10.0)
    first, cells = _admitted(system, 2, [0, 2])
    assert cells == [2, 3]
    assert member.join(10.0) == first

    received = {}
    for tick in (first, first + 1):
        system.host.publish(system.sense(tick))
        for shard in range(3):
            received[shard, tick] = gathered(system.members[shard].gather(tick)).links
            system.members[shard].publish(system.drive(shard, tick), system.links(shard, tick))
        drive, losses = system.host.gather(tick)
        assert losses == []
        assert drive.drive.tolist() == expected_drive(system, tick).tolist()
    assert not received[1, first].sent.any()
    incoming = system.partition.incoming(0)
    others = np.isin(incoming.source, [2, 3])
    assert others.any()
    assert not received[0, first].sent[others].any()
    for shard in range(3):
        links = system.partition.incoming(shard)
        said = (links.source + links.source_side + first) % 3 != 0
        assert received[shard, first + 1].sent.tolist() == said.tolist()


@every_format
def test_what_a_lost_cell_said_in_the_tick_of_its_loss_was_never_said(
    memory: Network, form: WireFormat
) -> None:
    system = System(memory, Partition.each(grid(1, 2)), form, message=MESSAGE).start()
    step(system, 0)
    system.host.publish(system.sense(1))
    for member in system.members:
        gathered(member.gather(1))
    links = system.links(1, 1)
    assert links is not None
    links.sent[:] = True
    # messages go out before drives: it is killed in between
    puts = system.members[1]._outgoing.encode(system.drive(1, 1), links)  # pyright: ignore[reportPrivateUsage]
    system.member_endpoints[1].put_all(puts[:-1])
    system.member_endpoints[1].close()
    system.members[0].publish(system.drive(0, 1), system.links(0, 1))
    assert system.host.gather(1)[1] == [Loss(1, 1, "disconnected")]
    system.host.publish(system.sense(2))
    received = gathered(system.members[0].gather(2)).links
    assert received is not None
    assert not received.sent.any()


@every_format
def test_a_process_lost_before_it_is_admitted_is_prepared_again(memory: Network, form: WireFormat) -> None:
    system = System(memory, Partition.even(grid(1, 3), 3), form, message=MESSAGE).start()
    step(system, 0)
    system.member_endpoints[1].close()
    step(system, 1, [0, 2])
    _restarted(system, 1).ready(10.0)
    assert system.host.admit(2) == []  # asked
    system.member_endpoints[1].close()
    step(system, 2, [0, 2])
    step(system, 3, [0, 2])
    assert system.host.admit(4) == []
    member = _restarted(system, 1)
    member.ready(10.0)
    first, cells = _admitted(system, 4, [0, 2])
    assert cells == [1]
    assert member.join(10.0) == first
    assert step(system, first)[1] == []


def test_who_is_not_let_in_or_whose_plant_goes_says_so(memory: Network) -> None:
    system = System(memory, Partition.even(grid(1, 2), 2), "packed").start()
    step(system, 0)
    system.member_endpoints[1].close()
    step(system, 1, [0])
    member = _restarted(system, 1)
    member.ready(10.0)
    with pytest.raises(BarrierError, match="shard 1 was not readmitted"):
        member.join(0.01)
    system.host.close()
    with pytest.raises(CoordinatorLostError):
        member.join(10.0)


def test_cells_that_come_back_still_die_when_they_were_to_die() -> None:
    membership = Membership(3)
    membership.schedule_death([0], 50)
    membership.mark_dead([0, 1], 10)
    membership.admit([0, 1], 20)
    assert [membership.live(tick).tolist() for tick in (19, 20, 50)] == [
        [False, False, True],
        [True, True, True],
        [False, True, True],
    ]
    assert membership.start_by_group([np.array([0, 1]), np.array([2])]) == [20, 0]
    assert membership.end_by_group([np.array([0]), np.array([1, 2])]) == [50, NO_TICK_LIMIT]


def test_a_group_is_there_from_when_the_first_of_those_came_who_stay_longest() -> None:
    membership = Membership(4)
    assert membership.unchanged
    membership.schedule_death([0], 50)
    assert not membership.unchanged
    assert membership.live(50).tolist() == [False, True, True, True]
    membership.mark_dead([1, 2], 10)
    membership.admit([2], 20)
    membership.mark_dead([1], 40)
    membership.admit([1], 45)
    membership.mark_dead([3], 30)
    group = np.arange(4)
    assert membership.start_by_group([group, np.array([0, 3])]) == [20, 0]
    assert membership.end_by_group([group, np.array([0, 3])]) == [NO_TICK_LIMIT, 50]


def test_parts_are_waited_for_from_their_tick_on_and_earlier_ones_are_late() -> None:
    counts = MessageCounters()
    collector = FrameAssembler("drive", [0, 0], lambda _, payload: (payload[0], payload[1]), counts)
    collector.start_at(7)
    collector.admit([0, 9], [NO_TICK_LIMIT, NO_TICK_LIMIT])
    assert [collector.missing(tick) for tick in (7, 8, 9)] == [[0], [0], [0, 1]]
    collector.handle(1, bytes([8, 1]))
    assert counts.late == 1
    collector.handle(1, bytes([9, 5]))
    assert collector.slot(9).values == [0, 5]
    collector.discard([1], 9)
    assert collector.slot(9).values == [0, 0]


def _collector(counts: MessageCounters) -> FrameAssembler:
    """Of two parts, whose payloads are a tick and a value."""
    return FrameAssembler("drive", [0, 0], lambda _, payload: (payload[0], payload[1]), counts)


def test_frames_of_lost_senders_are_stored_only_where_a_rejoin_is_expected() -> None:
    counts = MessageCounters()
    collector = _collector(counts)
    collector.start_at(7)
    collector.update_membership([NO_TICK_LIMIT, 5])
    collector.handle(1, bytes([8, 3]))
    assert (counts.late, collector.early(7)) == (1, 0)
    collector.allow_early([1])
    collector.handle(1, bytes([8, 3]))
    collector.handle(1, bytes([6, 3]))
    collector.handle(1, bytes([7 + EARLY_TICKS, 4]))
    collector.handle(1, bytes([8 + EARLY_TICKS, 5]))
    with pytest.raises(WireError, match="tick 8 was received already"):
        collector.handle(1, bytes([8, 9]))
    assert (counts.delivered, counts.late) == (2, 3)
    assert (collector.slot(8).values, collector.slot(8).missing) == ([0, 3], 1)
    collector.handle(0, bytes([8, 1]))
    assert collector.slot(8).missing == 0
    collector.admit([0, 7], [NO_TICK_LIMIT, NO_TICK_LIMIT])
    assert (collector.slot(7).missing, collector.slot(8).missing, collector.missing(9)) == (2, 0, [0, 1])


def test_who_comes_back_keeps_whatever_comes_until_its_first_tick_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    early = 64
    monkeypatch.setattr("bus.lockstep.receive.EARLY_TICKS", early)
    counts = MessageCounters()
    collector = _collector(counts)
    with pytest.raises(WireError, match="at most 64 ahead of 0"):
        collector.handle(0, bytes([early + 1, 1]))
    collector.accept_any_tick()
    for tick in range(100, 100 + early):
        collector.handle(0, bytes([tick, tick]))
    with pytest.raises(WireError, match="ahead"):
        collector.handle(0, bytes([99, 1]))
    assert (collector.early(100), collector.early(101)) == (early, early - 1)
    collector.start_at(103)
    assert collector.early(0) == early - 3
    assert (collector.now, collector.slot(103).values, collector.missing(103)) == (103, [103, 0], [1])
    with pytest.raises(WireError, match="ahead of 103"):
        collector.handle(1, bytes([104 + early, 1]))


def test_a_frame_that_is_over_takes_nothing_with_it_that_is_still_to_come() -> None:
    counts = MessageCounters()
    collector = _collector(counts)
    collector.handle(0, bytes([0, 1]))
    assert collector.close(0).values == [1, 0]
    assert (collector.now, collector.slot(1).values, collector.slot(1).missing) == (1, [0, 0], 2)
    collector.handle(1, bytes([0, 5]))
    assert counts.late == 1
    for tick in (2, 3, 5):
        collector.handle(0, bytes([tick, tick]))
    collector.close(1)
    assert collector.slot(2).values == [2, 0]
    collector.close(3)
    assert (collector.now, collector.early(0), collector.slot(5).values) == (4, 1, [5, 0])
    collector.update_membership([NO_TICK_LIMIT, 6])
    assert (collector.missing(5), collector.missing(6)) == ([1], [0])
    collector.close(6)
    assert collector.slot(7).missing == 1


def test_only_what_was_said_from_a_tick_on_is_void_and_may_be_said_again() -> None:
    collector = _collector(MessageCounters())
    for tick in range(3):
        collector.handle(1, bytes([tick, 5]))
    collector.discard([1], 1)
    assert [collector.slot(tick).values for tick in range(3)] == [[0, 5], [0, 0], [0, 0]]
    collector.handle(1, bytes([2, 6]))
    assert collector.slot(2).values == [0, 6]


class Absent:
    """Two shards of three that went, of two cells and of one, and what the plant sees of their new processes."""

    def __init__(self) -> None:
        nothing = cast("Any", None)
        self.roll = LivenessTracker(nothing, nothing)
        self.matched = {2, 3, 4}
        self.returns = RejoinTracker(self.roll, [[0, 1], [2, 3], [4]], self.matched.__contains__)
        self.returns.on_left(2, [4])
        self.returns.on_left(1, [3])
        self.returns.on_left(1, [2])

    def seen(self, *units: int) -> None:
        for signs in (self.roll.ever_left, self.roll.alive, self.roll.ready):
            signs.update(units)

    def requested(self) -> list[list[int]]:
        return [absence.cells for absence in self.returns.to_prepare()]


@pytest.mark.parametrize("sign", ["left", "alive", "ready", "matched"])
def test_a_process_is_back_when_all_its_units_went_came_are_ready_and_can_be_sent_to(sign: str) -> None:
    absent = Absent()
    absent.seen(2, 3)
    signs = (
        absent.matched if sign == "matched" else getattr(absent.roll, {"left": "ever_left"}.get(sign, sign))
    )
    signs.discard(2)
    assert absent.requested() == []
    assert absent.returns.ready_to_commit([]) == []
    signs.add(2)
    assert absent.requested() == [[3, 2]]
    assert absent.requested() == []


def test_cells_are_admitted_when_all_who_live_can_send_to_them_and_not_to_others() -> None:
    absent = Absent()
    absent.seen(2, 3, 4)
    assert absent.requested() == [[4], [3, 2]]
    absent.returns.on_ready(0, [2])
    absent.returns.on_ready(0, [4])
    absent.returns.on_ready(5, [2, 3])
    assert absent.returns.ready_to_commit([0, 5]) == []
    absent.returns.on_ready(0, [2, 3])
    assert absent.returns.ready_to_commit([0, 5]) == [2, 3]
    assert absent.returns.ready_to_commit([0]) == [4]
    assert not absent.returns


def test_matched_senders_are_reset_when_a_process_is_lost_again() -> None:
    absent = Absent()
    absent.seen(4)
    assert absent.requested() == [[4]]
    absent.returns.on_ready(0, [4])
    absent.roll.alive.discard(4)
    assert absent.requested() == []
    absent.roll.alive.add(4)
    assert absent.requested() == [[4]]
    assert absent.returns.ready_to_commit([0]) == []


def test_shards_that_rejoin_together_are_listed_by_their_cells_in_order() -> None:
    absent = Absent()
    absent.seen(2, 3, 4)
    absent.requested()
    assert absent.returns.ready_to_commit([]) == [2, 3, 4]


def test_asking_what_is_missing_of_a_far_tick_keeps_no_frame() -> None:
    # a forged record of a loss may name any tick
    collector = _collector(MessageCounters())
    assert collector.missing(1 << 40) == [0, 1]
    assert collector.untouched
