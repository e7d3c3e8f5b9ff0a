"""Cells that go: lost, failed, or dead by schedule."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from bus.lockstep import Loss, TickInputs
from bus.partition import Partition
from bus.spec import StallSpec
from bus.wire.formats import WireFormat
from bus.wire.frames import Control, decode_control
from tests.bus.support import (
    EVERYTHING,
    MESSAGE,
    FakeClock,
    Network,
    System,
    drain,
    every_format,
    expected_drive,
    gathered,
    grid,
    step,
)


@every_format
def test_cells_whose_token_goes_are_lost_at_the_first_tick_without_their_drive(
    network: Network, form: WireFormat
) -> None:
    system = System(network, Partition.even(grid(2, 3), 3), form, message=MESSAGE).start()
    step(system, 0)
    system.member_endpoints[1].close()
    drive, losses = step(system, 1, [0, 2])
    assert losses == [Loss(2, 1, "disconnected"), Loss(3, 1, "disconnected")]
    whole = expected_drive(system, 1)
    whole[[2, 3]] = 0.0
    assert drive.drive.tolist() == whole.tolist()
    # The others go on without them; what the lost ones said last is still read.
    for tick in (2, 3):
        drive, losses = step(system, tick, [0, 2])
        assert losses == []
        assert drive.drive[[2, 3]].tolist() == [[0.0, 0.0]] * 2
    assert system.host.live(3).tolist() == [True, True, False, False, True, True]


@every_format
def test_a_drive_that_came_before_its_token_went_still_counts(memory: Network, form: WireFormat) -> None:
    system = System(memory, Partition.each(grid(1, 2)), form).start()
    system.host.publish(system.sense(0))
    for shard, member in enumerate(system.members):
        gathered(member.gather(0))
        member.publish(system.drive(shard, 0), None)
    system.member_endpoints[1].close()
    drive, losses = system.host.gather(0)
    assert losses == []
    assert drive.drive.tolist() == expected_drive(system, 0).tolist()
    _, losses = step(system, 1, [0])
    assert losses == [Loss(1, 1, "disconnected")]


@every_format
def test_a_cell_that_stays_silent_is_lost_at_its_deadline(memory: Network, form: WireFormat) -> None:
    clock = FakeClock()
    stall = StallSpec(deadline_s=3.0)
    system = System(
        memory, Partition.each(grid(1, 3)), form, clock=clock, stall=stall, message=MESSAGE
    ).start()
    step(system, 0)
    before = clock.now
    drive, losses = step(system, 1, [0, 2])
    assert clock.now - before == pytest.approx(3.0)
    assert losses == [Loss(1, 1, "timed_out")]
    assert drive.drive[1].tolist() == [0.0, 0.0]
    assert system.host.counters.lost == 1
    # Its neighbours don't wait for it, and it learns of that when it comes back.
    before = clock.now
    assert step(system, 2, [0, 2])[1] == []
    assert clock.now == before
    assert isinstance(system.members[1].gather(1), Control)


@every_format
def test_what_a_cell_sends_after_it_was_given_up_is_late(memory: Network, form: WireFormat) -> None:
    clock = FakeClock()
    system = System(memory, Partition.each(grid(1, 2)), form, clock=clock).start()
    step(system, 0, [0])
    system.members[1].publish(system.drive(1, 0), None)
    system.members[1].publish(system.drive(1, 1), None)
    drive, losses = step(system, 1, [0])
    assert losses == []
    assert drive.drive[1].tolist() == [0.0, 0.0]
    assert system.host.counters.late == 2


@every_format
def test_waiting_neighbours_receive_the_report_of_a_loss(network: Network, form: WireFormat) -> None:
    system = System(network, Partition.each(grid(1, 3)), form, message=MESSAGE).start()
    host, (left, middle, right) = system.host, system.members
    step(system, 0)
    host.publish(system.sense(1))
    # The middle one reads tick 1 but never answers; its neighbours do.
    gathered(middle.gather(1))
    for shard, member in ((0, left), (2, right)):
        gathered(member.gather(1))
        member.publish(system.drive(shard, 1), system.links(shard, 1))
    results: list[TickInputs | Control] = []
    relayed = form == "relayed"  # whose senses wait for the messages, instead of the neighbours
    if not relayed:
        host.publish(system.sense(2))
    threads = [
        threading.Thread(target=lambda m=member: results.append(m.gather(2))) for member in (left, right)
    ]
    for thread in threads:
        thread.start()
    system.member_endpoints[1].close()
    assert host.gather(1)[1] == [Loss(1, 1, "disconnected")]
    if relayed:
        host.publish(system.sense(2))
    for thread in threads:
        thread.join(10.0)
    frames = [gathered(result).links for result in results]
    assert len(frames) == 2
    assert all(frame is not None and not frame.sent.any() for frame in frames)


def test_a_loss_is_broadcast_by_name(memory: Network) -> None:
    system = System(memory, Partition.each(grid(1, 2)), "per_cell").start()
    listener = memory.endpoint()
    listener.subscribe("mdms/test/plant/control")
    system.member_endpoints[1].close()
    step(system, 0, [0])
    (event,) = drain(listener, lambda events: len(events) == 1)
    assert decode_control(event[1], 2) == Control("lost", 0, ((0, 1),), "disconnected")  # type: ignore[arg-type]


@every_format
def test_a_shard_whose_cells_all_failed_stays_until_the_plant_reports_it(
    memory: Network, form: WireFormat
) -> None:
    """Its token would overtake the report: the plant would take the process for dead, and name another cause."""
    system = System(memory, Partition.even(grid(1, 2), 2), form, message=MESSAGE).start()
    step(system, 0)
    system.host.publish(system.sense(1))
    for shard, member in enumerate(system.members):
        gathered(member.gather(1))
        if shard == 0:
            member.fail([0], 1, "ZeroDivisionError")
        else:
            member.publish(system.drive(shard, 1), system.links(shard, 1))
    left: list[float] = []

    def stay() -> None:
        assert isinstance(system.members[0].gather(2), Control)
        left.append(time.monotonic())

    shard = threading.Thread(target=stay)
    shard.start()
    time.sleep(0.1)
    reported = time.monotonic()
    assert left == []
    _, losses = system.host.gather(1)
    shard.join()
    assert losses == [Loss(0, 1, "failed", "ZeroDivisionError")]
    assert reported <= left[0] < reported + 0.8  # the answer, not the end of its ttl_periods


@every_format
def test_a_firmware_that_fails_loses_its_cells_alone(memory: Network, form: WireFormat) -> None:
    system = System(memory, Partition.even(grid(2, 2), 2), form, message=MESSAGE).start()
    step(system, 0)
    system.host.publish(system.sense(1))
    for shard, member in enumerate(system.members):
        gathered(member.gather(1))
        if shard == 0:
            member.fail([1], 1, "ZeroDivisionError")
        member.publish(system.drive(shard, 1), system.links(shard, 1))
    drive, losses = system.host.gather(1)
    assert losses == [Loss(1, 1, "failed", "ZeroDivisionError")]
    whole = expected_drive(system, 1)
    whole[1] = 0.0
    assert drive.drive.tolist() == whole.tolist()
    assert system.members[0].live(1).tolist() == [True, False]
    # Its neighbour in the other shard receives nothing from it, and everything from the others.
    system.host.publish(system.sense(2))
    _, links = gathered(system.members[1].gather(2))
    incoming = system.partition.incoming(1)
    assert links is not None
    from_it = incoming.source == 1
    assert not links.sent[from_it].any()
    assert (
        links.sent[~from_it].tolist()
        == ((incoming.source + incoming.source_side + 1) % 3 != 0)[~from_it].tolist()
    )


@every_format
@pytest.mark.parametrize("count", [1, 2, 6])
def test_nobody_waits_for_a_cell_from_the_tick_of_its_scheduled_death(
    network: Network, form: WireFormat, count: int
) -> None:
    """Same senses, same messages, same drives whatever the cut, and no loss."""
    system = System(
        network, Partition.even(grid(2, 3), count), form, message=MESSAGE, readings=EVERYTHING
    ).start()
    dead, at = [1, 5], 2
    for side in (system.host, *system.members):
        side.mark_dead(dead, at)
    gone: set[int] = set()
    for tick in range(5):
        system.host.publish(system.sense(tick))
        for shard, member in enumerate(system.members):
            if shard in gone:
                continue
            result = member.gather(tick)
            if isinstance(result, Control):
                assert (result.kind, tick) == ("stop", at)
                assert set(system.partition.cells(shard).tolist()) <= set(dead)
                system.member_endpoints[shard].close()
                gone.add(shard)
                continue
            cells, incoming = system.partition.cells(shard), system.partition.incoming(shard)
            absent = np.isin(cells, dead) & (tick >= at)
            assert result.sense.presence[absent].any() == False  # noqa: E712 - NumPy's
            assert result.sense.level is not None
            assert not result.sense.level[absent].any()
            assert result.sense.label is not None
            assert not result.sense.label[absent].any()
            assert result.links is not None
            spoke = (incoming.source + incoming.source_side + tick - 1) % 3 != 0
            alive_then = ~np.isin(incoming.source, dead) | (tick - 1 < at)
            reads = ~np.isin(incoming.target, dead) | (tick < at)
            expected = spoke & alive_then & (tick > 0)
            assert result.links.sent[reads].tolist() == expected[reads].tolist()
            member.publish(system.drive(shard, tick), system.links(shard, tick))
        drive, losses = system.host.gather(tick)
        assert losses == []
        whole = expected_drive(system, tick)
        whole[dead if tick >= at else []] = 0.0
        assert drive.drive.tolist() == whole.tolist()
    assert system.host.counters.lost == 0
    # The dead say nothing, and nobody speaks to them.
    assert [side.counters.late for side in (system.host, *system.members)] == [0] * (1 + count)


@every_format
def test_a_shard_whose_cells_all_die_by_schedule_has_reported_its_counters_before_the_next_tick(
    network: Network, form: WireFormat
) -> None:
    """Its process may be killed then, without leaving."""
    system = System(network, Partition.even(grid(2, 3), 3), form, message=MESSAGE).start()
    for side in (system.host, *system.members):
        side.mark_dead([2], 1)
        side.mark_dead([3], 2)
    step(system, 0)
    step(system, 1)
    assert system.host._reported.counters.keys() == {1}
    last_report = system.host._reported.counters[1]
    assert last_report.cell_counters == {"shards": 1, "numbers": 1, "nothing": 0}
    assert last_report.sent == system.members[1].counters.sent


class ReportingClock(FakeClock):
    """Calls ``waited`` whenever somebody has waited in vain."""

    def __init__(self) -> None:
        self.waited: Callable[[], None] = lambda: None
        super().__init__()

    @property
    def now(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self._now

    @now.setter
    def now(self, value: float) -> None:
        self._now = value
        self.waited()

    def skip(self, seconds: float) -> None:
        """Let time pass in which nobody runs."""
        self._now += seconds


@every_format
def test_a_shard_that_keeps_saying_that_it_is_busy_gets_ten_deadlines_and_others_one(
    memory: Network, form: WireFormat
) -> None:
    lived: list[tuple[float, list[bool]]] = []

    def waited() -> None:
        lived.append((round(clock.now - before, 6), system.host.live(1).tolist()))
        system.members[1].busy(1)

    clock = ReportingClock()
    stall = StallSpec(deadline_s=3.0)
    system = System(memory, Partition.each(grid(1, 3)), form, clock=clock, stall=stall).start()
    step(system, 0)
    before, sent = clock.now, system.members[1].counters.sent
    system.members[1].busy(1)
    clock.waited = waited
    drive, losses = step(system, 1, [0])
    assert losses == [Loss(1, 1, "timed_out"), Loss(2, 1, "timed_out")]
    assert drive.drive[1:].tolist() == [[0.0, 0.0]] * 2
    # As somebody comes to wait for the last time, what was decided at the time before is to be seen.
    assert (3.0, [True, True, True]) in lived
    assert (6.0, [True, True, False]) in lived
    assert lived[-1] == (30.0, [True, True, False])
    assert system.members[1].counters.sent == sent, "what depends on the wall clock is not counted"


def test_a_suspended_host_loses_no_cell_that_answers_when_the_host_goes_on(memory: Network) -> None:
    suspensions = [60.0, 60.0]

    def waited() -> None:
        if suspensions:
            clock.skip(suspensions.pop())
        else:
            gathered(system.members[1].gather(1))
            system.members[1].publish(system.drive(1, 1), None)

    clock = ReportingClock()
    stall = StallSpec(deadline_s=3.0)
    system = System(memory, Partition.each(grid(1, 2)), "packed", clock=clock, stall=stall).start()
    step(system, 0)
    clock.waited = waited
    drive, losses = step(system, 1, [0])
    assert (losses, suspensions) == ([], [])
    assert drive.drive.tolist() == expected_drive(system, 1).tolist()


@pytest.mark.parametrize("at", [0, 2])
def test_a_shard_that_is_busy_with_another_tick_gets_one_deadline(at: int, memory: Network) -> None:
    clock = FakeClock()
    stall = StallSpec(deadline_s=3.0)
    system = System(memory, Partition.each(grid(1, 2)), "packed", clock=clock, stall=stall).start()
    step(system, 0)
    before = clock.now
    system.members[1].busy(at)
    assert step(system, 1, [0])[1] == [Loss(1, 1, "timed_out")]
    assert clock.now - before == pytest.approx(3.0)


def test_a_shard_that_was_busy_and_falls_silent_gets_one_deadline_more(memory: Network) -> None:
    clock = FakeClock()
    stall = StallSpec(deadline_s=3.0)
    system = System(memory, Partition.each(grid(1, 2)), "packed", clock=clock, stall=stall).start()
    step(system, 0)
    before = clock.now
    system.members[1].busy(1)
    assert step(system, 1, [0])[1] == [Loss(1, 1, "timed_out")]
    assert clock.now - before == pytest.approx(6.0)


def test_a_shard_that_was_busy_and_answers_is_not_lost(memory: Network) -> None:
    def waited() -> None:
        if clock.now < before + 10.0:
            system.members[1].busy(1)
        else:
            gathered(system.members[1].gather(1))
            system.members[1].publish(system.drive(1, 1), None)

    clock = ReportingClock()
    stall = StallSpec(deadline_s=3.0)
    system = System(memory, Partition.each(grid(1, 2)), "packed", clock=clock, stall=stall).start()
    step(system, 0)
    before = clock.now
    system.members[1].busy(1)
    clock.waited = waited
    drive, losses = step(system, 1, [0])
    assert losses == []
    assert drive.drive.tolist() == expected_drive(system, 1).tolist()
