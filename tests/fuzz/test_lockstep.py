"""Whatever a stranger puts on a run's keys, the run goes as it would have gone, and what came is counted."""

from __future__ import annotations

import gc
import tracemalloc
from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bus.errors import CoordinatorLostError, WireError
from bus.lockstep.registers import RegisterFrame, RegisterRequest, decode_registers, encode_registers
from bus.partition import Partition
from bus.transports.base import Endpoint, Received
from bus.wire.formats import WireFormat
from bus.wire.frames import Control, Report, decode_control, decode_report, encode_control, encode_report
from tests.bus.support import EVERYTHING, MESSAGE, FakeClock, Network, System, every_format, gathered, grid
from tests.fuzz.conftest import Rounds
from tests.fuzz.mutator import MESSAGEPACK, Mutator

TICKS, SPOILT, SEEDS = 5, 12, 6
Taken = list[Any]


def _system(form: WireFormat, clock: FakeClock | None = None) -> System:
    system = System(
        Network("memory"),
        Partition.even(grid(2, 3), 2),
        form,
        message=MESSAGE,
        readings=EVERYTHING,
        wanted=(RegisterRequest(1),),
        clock=clock,
    )
    return system.start()


def _step(system: System, tick: int) -> Taken:
    """One tick; returns all that any side took in."""
    taken: Taken = []
    system.host.publish(system.sense(tick))
    for shard, member in enumerate(system.members):
        sense, links = gathered(member.gather(tick))
        taken.append([None if part is None else np.asarray(part).tolist() for part in sense[:5]])
        taken.append(None if links is None else [part.tolist() for part in links[1:]])
        lattice, cells = system.partition.lattice, system.partition.cells(shard)
        places = np.stack((lattice.rows[cells], lattice.columns[cells]), axis=1)
        member.publish_registers(tick, lambda places=places: (places, {"u": places * 0.5}))
        member.publish(system.drive(shard, tick), system.links(shard, tick))
    drive, losses = system.host.gather(tick)
    shown = [(one.tick, one.registers["u"].tolist()) for one in system.host.drain_registers()]
    return [*taken, drive.drive.tolist(), losses, shown]


def _decoders(system: System) -> dict[str, Callable[[bytes], Any]]:
    """What reads the payloads of each key that anybody listens to."""
    found: dict[str, Callable[[bytes], Any]] = {"mdms/test/plant/control": lambda p: decode_control(p, 6)}
    host = system.host._form
    for key, unit in host.drive_units.items():
        found[key] = lambda p, unit=unit: host.decode_drive(unit, p)
    for shard, member in enumerate(system.members):
        form = member._form
        found[f"mdms/test/shard/{shard}/report"] = lambda p: decode_report(p, 6)
        found[f"mdms/test/shard/{shard}/registers"] = lambda p: decode_registers(p, 3)
        for key, unit in form.sense_units.items():
            found[key] = lambda p, form=form, unit=unit: form.decode_sense(unit, p)
        for key, part in form.in_parts.items():
            found[key] = lambda p, form=form, part=part: form.decode_link(part, p)
    return found


def _refusal(decode: Callable[[bytes], Any], payload: bytes) -> str | None:
    try:
        decode(payload)
    except WireError as error:
        return error.name
    return None


def _heard(ear: Endpoint, traffic: dict[str, list[bytes]]) -> None:
    for event in ear.receive_all(0):
        if isinstance(event, Received):
            traffic[event.key].append(event.payload)


@every_format
def test_spoilt_and_old_frames_on_every_key_change_nothing_and_are_all_counted(form: WireFormat) -> None:
    quiet, system = _system(form), _system(form)
    stranger, ear, traffic = (
        system.network.endpoint(),
        quiet.network.endpoint(),
        defaultdict[str, list[bytes]](list),
    )
    ear.subscribe("mdms/test/**")
    decoders, refused, old = _decoders(system), Counter[str](), 0
    traffic["mdms/test/plant/control"].append(encode_control(Control("start", 0)))
    for shard in range(2):
        traffic[f"mdms/test/shard/{shard}/report"].append(
            encode_report(Report("counters", 3, (), "", (1, 2, 3, 4)))
        )
    for tick in range(TICKS):
        expected = _step(quiet, tick)
        _heard(ear, traffic)
        for key, decode in decoders.items():
            put = stranger.publisher(key).put
            listeners = 2 if key.endswith("control") else 1
            mutator = Mutator(traffic[key], f"{form} {key} {tick}")
            for payload in (mutator.next() for _ in range(SPOILT)):
                if (name := _refusal(decode, payload)) is not None:
                    put(payload)
                    refused[name] += listeners
            if tick > 2 and not key.endswith(("control", "report")):
                put(traffic[key][0])
                old += 1
        assert _step(system, tick) == expected
    sides = [system.host.counters, *(member.counters for member in system.members)]
    assert sum((side.malformed for side in sides), Counter[str]()) == refused
    assert sum(side.late for side in sides) == old
    assert refused.total() > 40 * TICKS
    kinds = {"sense", "drive", "control", "report", "registers"} | ({"link"} if form != "relayed" else set())
    assert {name.partition(":")[0] for name in refused} >= kinds
    assert [side.delivered for side in sides] == [
        side.delivered for side in (quiet.host.counters, *(member.counters for member in quiet.members))
    ]


RECORDS = [
    encode_control(Control(kind, 0, ((0, 1), (1, 2)), "{}"))
    for kind in ("start", "lost", "rejoin_prepare", "rejoin_commit", "fault")
]
REPORTS = [
    encode_report(Report(kind, 3, ((0, 1),), "why", (1, 2, 3, 4)))
    for kind in ("failed", "hung", "rejoin_ready", "counters")
]


@every_format
@pytest.mark.parametrize("seed", range(SEEDS))
def test_well_formed_frames_of_a_stranger_can_drive_a_run_but_end_it_in_declared_errors_alone(
    form: WireFormat, seed: int, rounds: Rounds
) -> None:
    """Frames that a mutator made and a decoder took; the clock is one that obeys, so that silence costs nothing."""
    for number in rounds(1):
        _put_well_formed(form, SEEDS * number + seed)


def _put_well_formed(form: WireFormat, seed: int) -> None:
    system = _system(form, FakeClock())
    for member in system.members:
        member._silence_s = 1.0
    stranger, ear, traffic = (
        system.network.endpoint(),
        system.network.endpoint(),
        defaultdict[str, list[bytes]](list),
    )
    ear.subscribe("mdms/test/**")
    decoders = _decoders(system)
    traffic["mdms/test/plant/control"] += RECORDS
    for shard in range(2):
        traffic[f"mdms/test/shard/{shard}/report"] += REPORTS
    put = 0
    for tick in range(TICKS):
        for key, decode in decoders.items():
            mutator = Mutator(
                traffic[key] or [b""],
                f"well-formed {seed} {key} {tick}",
                MESSAGEPACK if traffic[key] else None,
            )
            for payload in (mutator.next() for _ in range(SPOILT)):
                if _refusal(decode, payload) is None:
                    stranger.publisher(key).put(payload)
                    put += 1
        try:
            system.host.admit(tick)
            _step(system, tick)
            for member in system.members:
                member.drain_faults(tick)
        except CoordinatorLostError:
            break
        except AssertionError as stopped:
            assert "kind='stop'" in str(stopped)  # noqa: PT017 - what a member answers to a stop of the stranger's
            break
        _heard(ear, traffic)
    assert put > 0


def test_reports_and_registers_without_end_fill_no_memory() -> None:
    system = _system("packed")
    stranger = system.network.endpoint()
    report = stranger.publisher("mdms/test/shard/0/report").put
    show = stranger.publisher("mdms/test/shard/0/registers").put
    shown = encode_registers(RegisterFrame(0, np.array([[0, 0]]), {"u": np.zeros((1, 2))}))

    def flood(rounds: int) -> int:
        for number in range(200 * rounds):
            report(encode_report(Report("hung", 0, ((0, 1),), f"reason {number}")))
            report(encode_report(Report("failed", 5, ((0, 0), (0, 1)), f"reason {number}")))
            report(encode_report(Report("failed", 2**60 + number, ((0, 0),), "far")))
            show(shown)
            if number % 200 == 199:
                system.host._inbox.poll(0)
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    before = flood(1)
    grown = flood(3) - before
    tracemalloc.stop()
    assert grown < 20_000
    assert system.host.counters.malformed == {"report: ahead": 800, "registers: duplicate": 799}
    assert [one.detail for one in system.host.drain_hung()] == ["reason 0"]


def test_a_report_that_names_nobody_or_registers_of_a_tick_to_come_are_refused() -> None:
    system = _system("packed")
    report = system.member_endpoints[0].publisher("mdms/test/shard/0/report").put
    for kind in ("hung", "failed"):
        report(encode_report(Report(kind, 0, (), "")))
    show = system.members[0].publish_registers
    for tick in (0, 1, 2**61):
        show(tick, lambda: (np.array([[0, 0]]), {"u": np.zeros(1)}))
    system.host._inbox.poll(0)
    assert system.host.counters.malformed == {"report: cells": 2, "registers: ahead": 2}
    assert [one.tick for one in system.host.drain_registers()] == [0]
