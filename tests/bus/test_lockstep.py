"""The lockstep of host and members: barrier, ticks, losses, deaths, bad payloads."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import pytest

from bus.errors import BarrierError, BusError, HostLostError, RunNameError, WokenError
from bus.forms import FormName
from bus.lockstep import Gathered, Host, Loss, Member
from bus.partition import Partition
from bus.specs import StallSpec
from bus.transport import Publisher
from bus.wire import Control, DriveFrame, LinkFrame, decode_control
from tests.bus.support import MESSAGE, SENSORS, FakeClock, Network, System, drain, grid

FORMS: list[FormName] = ["packed", "cells"]
both_forms = pytest.mark.parametrize("form", FORMS)


def gathered(result: Gathered | Control) -> Gathered:
    assert isinstance(result, Gathered), result
    return result


def step(system: System, tick: int, shards: list[int] | None = None) -> tuple[DriveFrame, list[Loss]]:
    """One tick in one thread: senses, every shard, drives."""
    system.host.publish(system.sense(tick))
    for shard in range(len(system.members)) if shards is None else shards:
        member = system.members[shard]
        gathered(member.gather(tick))
        member.publish(system.drive(shard, tick), system.links(shard, tick))
    return system.host.gather(tick)


def expected_drive(system: System, tick: int) -> Any:
    whole = np.zeros((len(system.partition.lattice), 2))
    for shard in range(system.partition.count):
        whole[system.partition.cells(shard)] = system.drive(shard, tick).drive
    return whole


# --- the barrier --------------------------------------------------------------------------------------


@both_forms
def test_the_barrier_names_who_never_appeared_and_who_is_not_ready(memory: Network, form: FormName) -> None:
    clock = FakeClock()
    system = System(memory, Partition.each(grid(1, 3)), form, clock=clock, message=MESSAGE)
    system.member_endpoints[1].declare_alive(
        "mdms/test/shard/1/alive" if form == "packed" else "mdms/test/cell/0/1/alive"
    )
    system.members[2].ready(5.0)  # its one neighbour subscribed, although it is not ready
    with pytest.raises(BarrierError) as caught:
        system.host.barrier(7.0)
    assert caught.value.absent == ((0, 0),)
    assert caught.value.unready == ((0, 1),)
    assert str(caught.value) == (
        "not every cell is ready after 7 s; never appeared: 1 cell (0,0); appeared but not ready: 1 cell (0,1)"
    )


def test_the_barrier_names_who_left_again_and_counts_the_many(memory: Network) -> None:
    clock = FakeClock()
    system = System(memory, Partition.even(grid(4, 5), 2), "packed", clock=clock)
    system.members[0].ready(5.0)
    system.members[0].close()
    with pytest.raises(BarrierError) as caught:
        system.host.barrier()
    said = str(caught.value)
    assert "never appeared: 10 cells (2,0 2,1 2,2 2,3 2,4 3,0 3,1 3,2 3,3 3,4)" in said
    assert "appeared and left again: 10 cells" in said
    assert len(caught.value.absent) == 20


def test_a_member_that_nobody_hears_says_whom_it_waits_for(memory: Network) -> None:
    clock = FakeClock()
    partition = Partition.each(grid(1, 2))
    system = System(memory, partition, "cells", clock=clock, message=MESSAGE)
    system.member_endpoints[1].close()
    with pytest.raises(BarrierError, match=r"nobody listens to mdms/test/cell/0/0/to/east"):
        system.members[0].ready(1.0)


def test_a_member_without_a_plant_says_so(memory: Network) -> None:
    clock = FakeClock()
    system = System(memory, Partition.each(grid(1, 1)), "packed", clock=clock)
    system.endpoint.close()
    member = system.members[0]
    with pytest.raises((BarrierError, HostLostError), match="plant"):
        member.ready(1.0)


@both_forms
def test_a_run_starts_in_any_order_on_any_transport(network: Network, form: FormName) -> None:
    system = System(network, Partition.even(grid(2, 3), 3), form, message=MESSAGE).start()
    drive, losses = step(system, 0)
    assert losses == []
    assert drive.drive.tolist() == expected_drive(system, 0).tolist()


def test_waking_the_barrier_ends_it(memory: Network) -> None:
    system = System(memory, Partition.each(grid(1, 2)), "packed")
    system.endpoint.wake()
    with pytest.raises(WokenError):
        system.host.barrier()


# --- ticks ----------------------------------------------------------------------------------------------


@both_forms
@pytest.mark.parametrize("count", [1, 2, 6])
def test_members_get_the_senses_of_their_cells_and_the_host_their_drives(
    network: Network, form: FormName, count: int
) -> None:
    system = System(network, Partition.even(grid(2, 3), count), form, encoders=True).start()
    for tick in range(3):
        sense = system.sense(tick)
        system.host.publish(sense)
        for shard, member in enumerate(system.members):
            mine, links = gathered(member.gather(tick))
            cells = system.partition.cells(shard)
            assert links is None
            assert mine.tick == tick
            assert mine.presence.tolist() == sense.presence[cells].tolist()
            assert mine.encoder_m is not None
            assert sense.encoder_m is not None
            assert mine.encoder_m.tolist() == sense.encoder_m[cells].tolist()
            member.publish(system.drive(shard, tick), None)
        drive, losses = system.host.gather(tick)
        assert drive.tick == tick
        assert drive.drive.tolist() == expected_drive(system, tick).tolist()
        assert losses == []


@both_forms
@pytest.mark.parametrize("count", [1, 2, 6])
def test_messages_of_a_tick_are_read_in_the_next(network: Network, form: FormName, count: int) -> None:
    system = System(network, Partition.even(grid(2, 3), count), form, message=MESSAGE).start()
    partition = system.partition
    for tick in range(4):
        system.host.publish(system.sense(tick))
        for shard, member in enumerate(system.members):
            _, links = gathered(member.gather(tick))
            incoming = partition.incoming(shard)
            assert links is not None
            assert links.tick == tick - 1
            sent = (incoming.source + incoming.source_side + tick - 1) % 3 != 0
            if tick == 0:
                sent[:] = False
            assert links.sent.tolist() == sent.tolist()
            said = (incoming.source * 4 + incoming.source_side) / 3.0 + (tick - 1)
            assert links.message["u"].tolist() == np.where(sent, said, 0.0).tolist()
            assert links.message["hops"].tolist() == np.where(sent, incoming.source + tick - 1, 0).tolist()
            member.publish(system.drive(shard, tick), system.links(shard, tick))
        assert system.host.gather(tick)[1] == []


def test_all_sides_counts_come_together_when_the_run_stops(network: Network) -> None:
    system = System(network, Partition.even(grid(2, 3), 2), "packed", message=MESSAGE).start()
    for tick in range(5):
        step(system, tick)
    stopped: list[Gathered | Control] = []

    def leave(member: Member) -> None:
        stopped.append(member.gather(5))
        member.close()

    threads = [threading.Thread(target=leave, args=(member,)) for member in system.members]
    for thread in threads:
        thread.start()
    total = system.host.stop("done", 5.0)
    for thread in threads:
        thread.join()
    assert [(record.kind, record.detail) for record in stopped if isinstance(record, Control)] == [
        ("stop", "done")
    ] * 2
    # Senses, start and stop from the plant; a drive and a link frame a tick from each shard.
    assert system.host.counts.sent == 5 * 2 + 2
    assert total.sent == 5 * 2 + 2 + 5 * 2 * 2
    # What was sent was delivered, but for the last tick's messages, which nobody read, and each record twice.
    assert total.delivered == 5 * 2 * 3 + 2 * 2
    assert (total.lost, total.late, sum(total.malformed.values())) == (0, 0, 0)


@both_forms
def test_a_frame_that_comes_early_is_kept_until_its_tick(memory: Network, form: FormName) -> None:
    system = System(memory, Partition.each(grid(1, 2)), form, message=MESSAGE).start()
    one, other = system.members
    for tick in range(2):
        system.host.publish(system.sense(tick))
    for tick in range(2):
        gathered(one.gather(tick)) if tick == 0 else None
        one.publish(system.drive(0, tick), system.links(0, tick))
    for tick in range(2):
        _, links = gathered(other.gather(tick))
        assert links is not None
        assert links.tick == tick - 1
        other.publish(system.drive(1, tick), system.links(1, tick))
    for tick in range(2):
        drive, _ = system.host.gather(tick)
        assert drive.drive.tolist() == expected_drive(system, tick).tolist()
    assert system.host.counts.late == 0


@both_forms
def test_a_frame_of_a_tick_that_is_over_is_counted_as_late(memory: Network, form: FormName) -> None:
    system = System(memory, Partition.each(grid(1, 1)), form).start()
    step(system, 0)
    system.members[0].publish(system.drive(0, 0), None)
    step(system, 1)
    assert system.host.counts.late == 1


def test_publishing_another_shape_than_agreed_is_refused_with_its_place(memory: Network) -> None:
    system = System(memory, Partition.each(grid(1, 2)), "packed", message=MESSAGE).start()
    member, links = system.members[1], system.links(1, 0)
    with pytest.raises(BusError, match=r"drive of shard 1, tick 0: must be float64 \(1, 2\)"):
        member.publish(DriveFrame(0, np.zeros((2, 2))), links)
    with pytest.raises(BusError, match=r"drive of cell 0,1, tick 0: must be finite, is \[nan, 0.0\]"):
        member.publish(DriveFrame(0, np.array([[np.nan, 0.0]])), links)
    with pytest.raises(BusError, match="the firmware has messages"):
        member.publish(system.drive(1, 0), None)
    with pytest.raises(BusError, match="links of shard 1, tick 0: must be 1 of"):
        member.publish(system.drive(1, 0), LinkFrame(0, np.zeros(2, np.bool_), np.zeros(2, MESSAGE)))
    with pytest.raises(BusError, match="sense frame of tick 0: must have presence"):
        system.host.publish(System.sense(system, 0).__class__(0, np.zeros((3, SENSORS), np.bool_), None))


def test_a_bad_run_name_is_refused(memory: Network) -> None:
    partition = Partition.each(grid(1, 1))
    with pytest.raises(RunNameError):
        Host(memory.endpoint(), partition, "packed", run="a/b", sensors=1, encoders=False, message=None)


# --- losses -----------------------------------------------------------------------------------------------


@both_forms
def test_cells_whose_token_goes_are_lost_at_the_first_tick_without_their_drive(
    network: Network, form: FormName
) -> None:
    system = System(network, Partition.even(grid(2, 3), 3), form, message=MESSAGE).start()
    step(system, 0)
    system.member_endpoints[1].close()
    drive, losses = step(system, 1, [0, 2])
    assert losses == [Loss(2, 1, "token lost"), Loss(3, 1, "token lost")]
    whole = expected_drive(system, 1)
    whole[[2, 3]] = 0.0
    assert drive.drive.tolist() == whole.tolist()
    # The others go on without them; what the lost ones said last is still read.
    for tick in (2, 3):
        drive, losses = step(system, tick, [0, 2])
        assert losses == []
        assert drive.drive[[2, 3]].tolist() == [[0.0, 0.0]] * 2
    assert system.host.live(3).tolist() == [True, True, False, False, True, True]


@both_forms
def test_a_drive_that_came_before_its_token_went_still_counts(memory: Network, form: FormName) -> None:
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
    assert losses == [Loss(1, 1, "token lost")]


@both_forms
def test_a_cell_that_stays_silent_is_lost_at_its_deadline(memory: Network, form: FormName) -> None:
    clock = FakeClock()
    stall = StallSpec(deadline_s=3.0)
    system = System(
        memory, Partition.each(grid(1, 3)), form, clock=clock, stall=stall, message=MESSAGE
    ).start()
    step(system, 0)
    before = clock.now
    drive, losses = step(system, 1, [0, 2])
    assert clock.now - before == pytest.approx(3.0)
    assert losses == [Loss(1, 1, "stalled")]
    assert drive.drive[1].tolist() == [0.0, 0.0]
    assert system.host.counts.lost == 1
    # Its neighbours don't wait for it, and it is told when it comes back.
    before = clock.now
    assert step(system, 2, [0, 2])[1] == []
    assert clock.now == before
    assert isinstance(system.members[1].gather(1), Control)


@both_forms
def test_what_a_cell_sends_after_it_was_given_up_is_late(memory: Network, form: FormName) -> None:
    clock = FakeClock()
    system = System(memory, Partition.each(grid(1, 2)), form, clock=clock).start()
    step(system, 0, [0])
    system.members[1].publish(system.drive(1, 0), None)
    system.members[1].publish(system.drive(1, 1), None)
    drive, losses = step(system, 1, [0])
    assert losses == []
    assert drive.drive[1].tolist() == [0.0, 0.0]
    assert system.host.counts.late == 2


@both_forms
def test_neighbours_are_told_of_a_loss_while_they_wait(network: Network, form: FormName) -> None:
    system = System(network, Partition.each(grid(1, 3)), form, message=MESSAGE).start()
    host, (left, middle, right) = system.host, system.members
    step(system, 0)
    host.publish(system.sense(1))
    # The middle one reads tick 1 but never answers; its neighbours do.
    gathered(middle.gather(1))
    for shard, member in ((0, left), (2, right)):
        gathered(member.gather(1))
        member.publish(system.drive(shard, 1), system.links(shard, 1))
    results: list[Gathered | Control] = []
    host.publish(system.sense(2))
    threads = [
        threading.Thread(target=lambda m=member: results.append(m.gather(2))) for member in (left, right)
    ]
    for thread in threads:
        thread.start()
    system.member_endpoints[1].close()
    assert host.gather(1)[1] == [Loss(1, 1, "token lost")]
    for thread in threads:
        thread.join(10.0)
    frames = [gathered(result).links for result in results]
    assert len(frames) == 2
    assert all(frame is not None and not frame.sent.any() for frame in frames)


def test_a_loss_is_broadcast_by_name(memory: Network) -> None:
    system = System(memory, Partition.each(grid(1, 2)), "cells").start()
    listener = memory.endpoint()
    listener.subscribe("mdms/test/plant/control")
    system.member_endpoints[1].close()
    step(system, 0, [0])
    (event,) = drain(listener, lambda events: len(events) == 1)
    assert decode_control(event[1], 2) == Control("lost", 0, ((0, 1),), "token lost")  # type: ignore[arg-type]


@both_forms
def test_a_firmware_that_fails_loses_its_cells_alone(memory: Network, form: FormName) -> None:
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
    # Its neighbour in the other shard hears nothing from it, and everything from the others.
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


# --- scheduled deaths -----------------------------------------------------------------------------------------


@both_forms
@pytest.mark.parametrize("count", [1, 2, 6])
def test_nobody_waits_for_a_cell_from_the_tick_of_its_scheduled_death(
    network: Network, form: FormName, count: int
) -> None:
    """Same senses, same messages, same drives whatever the cut, and no loss."""
    system = System(network, Partition.even(grid(2, 3), count), form, message=MESSAGE, encoders=True).start()
    dead, at = [1, 5], 2
    for side in (system.host, *system.members):
        side.retire(dead, at)
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
    assert system.host.counts.lost == 0
    # The dead say nothing, and nobody speaks to them.
    assert [side.counts.late for side in (system.host, *system.members)] == [0] * (1 + count)


# --- ends -------------------------------------------------------------------------------------------------------


def test_a_member_notices_that_the_plant_is_gone(network: Network) -> None:
    system = System(network, Partition.each(grid(1, 1)), "packed").start()
    step(system, 0)
    system.host.close()
    with pytest.raises(HostLostError, match="waited for tick 1"):
        system.members[0].gather(1)


def test_a_member_with_a_limit_gives_up_a_silent_plant(memory: Network) -> None:
    clock = FakeClock()
    system = System(memory, Partition.each(grid(1, 1)), "packed", clock=clock)
    member = Member(
        system.member_endpoints[0], system.partition, 0, "packed",
        run="test", sensors=SENSORS, encoders=False, message=None, silence_s=4.0, clock=clock,
    )  # fmt: skip
    with pytest.raises(HostLostError, match="silent for 4 s; shard 0 waited for tick 0"):
        member.gather(0)


def test_wake_ends_a_gather_on_either_side_and_it_may_be_repeated(network: Network) -> None:
    system = System(network, Partition.each(grid(1, 1)), "packed").start()
    for endpoint, gather in (
        (system.member_endpoints[0], system.members[0].gather),
        (system.endpoint, system.host.gather),
    ):
        waker = threading.Timer(0.02, endpoint.wake)
        waker.start()
        with pytest.raises(WokenError):
            gather(0)
        waker.join()
    assert step(system, 0)[1] == []


def test_the_state_is_put_only_while_somebody_listens(memory: Network) -> None:
    clock = FakeClock()
    system = System(memory, Partition.each(grid(1, 1)), "packed", clock=clock)
    system.host.publish_state(b"1")
    listener = memory.endpoint()
    listener.subscribe("mdms/test/plant/state")
    system.host.publish_state(b"2")
    clock.now += 1.0
    system.host.publish_state(b"3")
    assert [event[1] for event in drain(listener, lambda events: len(events) == 1)] == [b"3"]


# --- others on the bus ----------------------------------------------------------------------------------------------


@both_forms
def test_no_payload_on_any_key_breaks_a_run(network: Network, form: FormName) -> None:
    system = System(network, Partition.even(grid(2, 2), 2), form, message=MESSAGE).start()
    stranger = network.endpoint()
    keys = [
        "mdms/test/plant/control",
        "mdms/test/shard/0/report",
        "mdms/test/shard/9/report",
        *(
            ["mdms/test/shard/0/sense", "mdms/test/shard/1/drive", "mdms/test/shard/0/to/1"]
            if form == "packed"
            else ["mdms/test/cell/0/0/sense", "mdms/test/cell/1/1/drive", "mdms/test/cell/0/0/to/north"]
        ),
        "mdms/test/shard/7/drive" if form == "packed" else "mdms/test/cell/7/7/drive",
    ]
    publishers: list[Publisher] = [stranger.publisher(key) for key in keys]
    for publisher in publishers:
        while not publisher.matched():
            assert stranger.receive(0.005) is None
    far = msgpack.packb({"v": 1, "tick": 10**15, "drive": [0.0, 0.0]})
    outside = msgpack.packb({"v": 1, "tick": 0, "kind": "lost", "cells": [[9, 9]], "detail": ""})
    for tick in range(6):
        for publisher in publishers:
            for payload in (b"", b"\xc1", b"\x80", b"\xff" * 3000, far, outside):
                publisher.put(payload)
        drive, losses = step(system, tick)
        assert losses == []
        assert drive.drive.tolist() == expected_drive(system, tick).tolist()
    seen: Callable[[str], int] = lambda name: (  # noqa: E731
        system.host.counts.malformed[name] + sum(m.counts.malformed[name] for m in system.members)
    )
    system.host.publish(system.sense(6))
    for member in system.members:
        gathered(member.gather(6))
    assert seen("drive: encoding") > 0
    assert seen("sense: length") + seen("sense: encoding") > 0
    assert seen("link: length") + seen("link: encoding") > 0
    assert seen("control: cells") > 0
    assert seen("bus: key") > 0


def test_the_second_payload_of_a_tick_is_refused_and_the_first_stands(memory: Network) -> None:
    system = System(memory, Partition.each(grid(1, 2)), "packed").start()
    system.host.publish(system.sense(0))
    gathered(system.members[0].gather(0))
    system.members[0].publish(system.drive(0, 0), None)
    system.members[0].publish(DriveFrame(0, np.full((1, 2), 9.0)), None)
    gathered(system.members[1].gather(0))
    system.members[1].publish(system.drive(1, 0), None)
    drive, _ = system.host.gather(0)
    assert drive.drive.tolist() == expected_drive(system, 0).tolist()
    assert system.host.counts.malformed == {"drive: duplicate": 1}
