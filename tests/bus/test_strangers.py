"""What others put on a run's keys."""

from __future__ import annotations

from collections.abc import Callable

import msgpack
import numpy as np

from bus.errors import WireError
from bus.lockstep.counters import MessageCounters
from bus.partition import Partition
from bus.transports.base import Publisher
from bus.wire.formats import WireFormat
from bus.wire.frames import COUNTER_LIMIT, DriveFrame
from tests.bus.support import (
    MESSAGE,
    Network,
    System,
    every_format,
    expected_drive,
    gathered,
    grid,
    settle,
    step,
)


@every_format
def test_no_payload_on_any_key_breaks_a_run(network: Network, form: WireFormat) -> None:
    system = System(network, Partition.even(grid(2, 2), 2), form, message=MESSAGE).start()
    stranger = network.endpoint()
    of_form = {
        "packed": ["shard/0/sense", "shard/1/drive", "shard/7/drive", "shard/0/to/1"],
        "per_cell": ["cell/0/0/sense", "cell/1/1/drive", "cell/7/7/drive", "cell/0/0/to/north"],
        "relayed": ["shard/0/sense", "shard/1/drive", "shard/7/drive"],
    }
    leaves = ["plant/control", "shard/0/report", "shard/9/report", *of_form[form]]
    keys = [f"mdms/test/{leaf}" for leaf in leaves]
    publishers: list[Publisher] = [stranger.publisher(key) for key in keys]
    for publisher in publishers:
        settle(publisher, stranger)
    far = msgpack.packb({"v": 2, "tick": 10**15, "drive": [0.0, 0.0]})
    outside = msgpack.packb({"v": 2, "tick": 0, "kind": "lost", "cells": [[9, 9]], "detail": ""})
    for tick in range(6):
        for publisher in publishers:
            for payload in (b"", b"\xc1", b"\x80", b"\xff" * 3000, far, outside):
                publisher.put(payload)
        drive, losses = step(system, tick)
        assert losses == []
        assert drive.drive.tolist() == expected_drive(system, tick).tolist()
    seen: Callable[[str], int] = lambda name: (  # noqa: E731
        system.host.counters.malformed[name] + sum(m.counters.malformed[name] for m in system.members)
    )
    system.host.publish(system.sense(6))
    for member in system.members:
        gathered(member.gather(6))
    assert seen("drive: encoding") > 0
    assert seen("sense: length") + seen("sense: encoding") > 0
    assert (seen("link: length") + seen("link: encoding") > 0) == (form != "relayed")
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
    assert system.host.counters.malformed == {"drive: duplicate": 1}


def test_refused_messages_are_counted_by_sender_and_reported_to_the_plant(memory: Network) -> None:
    system = System(memory, Partition.each(grid(1, 2)), "per_cell", message=MESSAGE).start()
    stranger = memory.endpoint()
    for key in ("cell/0/1/to/west", "cell/0/0/sense", "cell/0/1/drive", "cell/9/9/drive", "cell/8/8/drive"):
        stranger.publisher(f"mdms/test/{key}").put(b"\xc1")
    assert step(system, 0)[1] == []
    system.host.publish(system.sense(1))
    for member in system.members:
        gathered(member.gather(1))
        member.close()
    assert system.host.stop("", 0.2).refused == {
        ("cell 0,1", "link: encoding"): 1,
        ("cell 0,0", "sense: encoding"): 1,
        ("cell 0,1", "drive: encoding"): 1,
        ("nobody", "bus: key"): 2,
    }


def test_a_report_has_as_much_of_what_was_refused_as_there_is_room_for() -> None:
    counts = MessageCounters(1, 2, 3, 4)
    for i in range(100):
        counts.refuse(WireError("link", "type", ""), f"cell {i},0")
    counts.refuse(WireError("link", "x" * 64, ""), "cell 0,0")
    cell_counters = counts.to_report({"sensor.bounces": 7, "malformed": 8})
    assert len(cell_counters) == COUNTER_LIMIT
    assert max(len(name) for name, _ in cell_counters) <= COUNTER_LIMIT
    again = MessageCounters.from_report((1, 2, 3, 4), cell_counters)
    assert (again.sent, again.delivered, again.lost, again.late) == (1, 2, 3, 4)
    assert again.cell_counters == {"sensor.bounces": 7, "malformed": 8}
    assert again.refused == {(f"cell {i},0", "link: type"): 1 for i in range(COUNTER_LIMIT - 2)}


@every_format
def test_a_drive_of_a_tick_whose_senses_are_not_out_yet_is_refused_and_booked_against_its_sender(
    network: Network, form: WireFormat
) -> None:
    system = System(network, Partition.each(grid(1, 2)), form).start()
    thief, honest = system.members
    forged = DriveFrame(1, np.full((1, 2), 9.0))
    for tick in range(3):
        system.host.publish(system.sense(tick))
        for shard, member in enumerate((thief, honest)):
            gathered(member.gather(tick))
            if tick == 0 and member is thief:
                member.publish(forged, None)
            member.publish(system.drive(shard, tick), None)
        drive, losses = system.host.gather(tick)
        assert losses == []
        assert drive.drive.tolist() == expected_drive(system, tick).tolist()
    assert system.host.counters.refused == {("cell 0,0", "drive: ahead"): 1}
