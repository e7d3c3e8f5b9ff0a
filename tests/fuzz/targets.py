"""Every decoder of the bus, with valid frames of its kind, and what must hold of whatever it accepts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from bus.errors import WireError
from bus.lattice import NO_TICK_LIMIT
from bus.lockstep.registers import NAMES_LIMIT, RegisterFrame, decode_registers, encodable, encode_registers
from bus.lockstep.snapshots import ShardSnapshot, decode_snapshot, encode_snapshot
from bus.partition import Partition
from bus.sensors import SensorSchema
from bus.wire.format import Senses
from bus.wire.formats import WireFormat
from bus.wire.frames import (
    COUNTER_LIMIT,
    TEXT_LIMIT,
    Control,
    LinkFrame,
    Report,
    decode_control,
    decode_report,
    encode_control,
    encode_report,
)
from bus.wire.msgpack_codec import TICK_LIMIT
from cell_firmware.faults.attach import decode_fault_control
from deploy.control.server import InjectRequest, ListRequest, RepairRequest, read_request
from deploy.errors import RequestError
from deploy.scenes.files import load_scene
from tests.bus.support import EVERYTHING, FORMS, PRESENCE, Network, System, grid
from tests.fuzz.mutator import JSON, MESSAGEPACK, Form

TICKS = (0, 1, 2, 3, 200, 70_000, TICK_LIMIT - 1)
"""Numbers of all widths that MessagePack has."""

_KINDS = {
    "flag": "?", "near": "<i1", "far": "<i8", "hops": "<u2", "label": "<u8",
    "half": "<f2", "single": "<f4", "whole": "<f8",
}  # fmt: skip
MESSAGE = np.dtype(list(_KINDS.items()))
"""A message with a field of every kind."""


@dataclass(frozen=True)
class Target:
    """One decoder.

    Attributes:
        name: Of the kind, and where it matters its form and what it carries.
        frames: Valid payloads.
        decode: Any bytes to tick and value; WireError for all that are not valid.
        check: Fails for a value that its key does not promise.
        form: What the payloads are written in.
    """

    name: str
    frames: tuple[bytes, ...]
    decode: Callable[[bytes], tuple[int, Any]]
    check: Callable[[Any], None]
    form: Form = MESSAGEPACK


def targets() -> list[Target]:
    """All of them."""
    found = [_control(), _report(), _registers(), _kept(), _request(), _live_fault()]
    for form in FORMS:
        found += [_sense(form, "plain", PRESENCE), _sense(form, "with all readings", EVERYTHING)]
        found += [_drive(form)] if form == "relayed" else [_drive(form), _link(form)]
    return found


def _system(form: WireFormat, readings: SensorSchema = PRESENCE) -> System:
    partition = Partition.even(grid(3, 4), 2)
    return System(Network("memory"), partition, form, message=MESSAGE, readings=readings)


def _sense(form: WireFormat, what: str, readings: SensorSchema) -> Target:
    system = _system(form, readings)
    member, host = system.members[0]._form, system.host._form
    cells = 1 if form == "per_cell" else len(system.partition.cells(0))

    def check(value: Any) -> None:
        _check_senses(member.join_senses([value]), readings, cells)
        if member.relays:
            _check_links(*member.join_links([], [value]), len(system.partition.incoming(0)))

    said = system.members[1]._form
    drives = [said.drive_payloads(system.drive(1, frame.tick), frame)[0] for frame in _said(system, 1)]
    driven = [[host.blank_drives[0], host.decode_drive(1, payload)[1]] for payload in drives]
    frames = tuple(
        host.sense_payloads(
            system.sense(i)._replace(tick=tick), host.relay(driven[i], None) if host.relays else None
        )[0]
        for i, tick in enumerate(TICKS)
    )
    return Target(f"sense, {form}, {what}", frames, lambda payload: member.decode_sense(0, payload), check)


def _check_senses(senses: Senses, readings: SensorSchema, cells: int) -> None:
    each = (cells, readings.sensors)
    assert (senses.presence.dtype, senses.presence.shape) == (np.bool_, each)
    assert set(senses.presence.tobytes()) <= {0, 1}
    assert (senses.encoder_m is not None) == readings.encoders
    if senses.encoder_m is not None:
        assert senses.encoder_m.shape == (cells, 2)
        assert np.isfinite(senses.encoder_m).all()
    if senses.level is not None:
        assert senses.level.shape == each
        assert ((senses.level >= 0.0) & (senses.level <= 1.0)).all()
    if senses.label is not None:
        assert ((senses.label >= 0) & (senses.label <= readings.labels)).all()
    if senses.picture is not None:
        parcel, pose = senses.picture
        assert parcel.tolist() == sorted(set(parcel.tolist()) & set(range(readings.camera)))
        assert pose.shape == (len(parcel), 3)
        assert np.isfinite(pose).all()


def _drive(form: WireFormat) -> Target:
    system = _system(form)
    host = system.host._form
    cells = 1 if form == "per_cell" else len(system.partition.cells(0))

    def check(value: Any) -> None:
        packed = value.drive if host.relays else value
        drives = np.frombuffer(packed).reshape(-1, 2) if isinstance(packed, bytes) else packed
        assert drives.shape == (cells, 2)
        assert np.isfinite(drives).all()
        if host.relays:
            links = len(system.partition.outgoing(0))
            assert (len(value.sent), len(value.message)) == (links, links * MESSAGE.itemsize)
            assert set(value.sent) <= {0, 1}

    frames = tuple(
        system.members[0]._form.drive_payloads(system.drive(0, frame.tick), frame)[0]
        for frame in _said(system, 0)
    )
    return Target(f"drive, {form}", frames, lambda payload: host.decode_drive(0, payload), check)


def _link(form: WireFormat) -> Target:
    system = _system(form)
    sender, hearer = system.members[0]._form, system.members[1]._form
    count = 1 if form == "per_cell" else len(system.partition.incoming(1))

    def check(value: Any) -> None:
        _check_links(*hearer.join_links([value], []), count)

    frames = tuple(payload for frame in _said(system, 0) for payload in sender.link_payloads(frame)[:3])
    return Target(f"link, {form}", frames, lambda payload: hearer.decode_link(0, payload), check)


def _check_links(sent: Any, message: Any, count: int) -> None:
    assert (len(sent), len(message)) == (count, count)
    assert set(sent.tobytes()) <= {0, 1}
    assert message.dtype == MESSAGE
    assert set(message["flag"].tobytes()) <= {0, 1}
    assert message[~sent].tobytes() == bytes(MESSAGE.itemsize * int((~sent).sum()))


def _said(system: System, shard: int) -> Iterator[LinkFrame]:
    """What a shard says: every field at its least, greatest and ordinary."""
    links = len(system.partition.outgoing(shard))
    for i, tick in enumerate(TICKS):
        message = np.zeros(links, dtype=MESSAGE)
        for name in MESSAGE.names or ():
            kind = MESSAGE[name]
            limits = np.iinfo(kind) if kind.kind in "iu" else np.finfo(kind) if kind.kind == "f" else None
            message[name] = i % 2 if limits is None else (limits.min, 1, limits.max)[i % 3]
        sent = (np.arange(links) + i) % 3 != 0
        message[~sent] = np.zeros((), dtype=MESSAGE)
        yield LinkFrame(tick, sent, message)


def _control() -> Target:
    records = [
        Control("start", 0),
        Control("lost", 70_000, ((0, 1), (2, 3)), "disconnected"),
        Control("stop", TICK_LIMIT - 1, (), "the run is over — finished, größer"),
    ]

    def decode(payload: bytes) -> tuple[int, Control]:
        control = decode_control(payload, 12)
        return control.tick, control

    def check(control: Control) -> None:
        assert control.kind in ("start", "lost", "stop")
        _check_words(control.cells, control.detail)

    return Target("control", tuple(map(encode_control, records)), decode, check)


def _check_words(cells: Any, detail: Any) -> None:
    assert len(cells) <= 12
    assert all(type(place) is int for cell in cells for place in cell)
    assert len(detail) <= TEXT_LIMIT
    detail.encode()


def _report() -> Target:
    reports = [
        Report("failed", 3, ((0, 1), (2, 3)), "ZeroDivisionError: on purpose\nTraceback ..."),
        Report("hung", 200, ((1, 1),), "HangingField: no answer within a tick"),
        Report("counters", 70_000, (), "", (1, 2, 3, 2**40), (("messages.sent", 7), ("cop.resets", 0))),
    ]

    def decode(payload: bytes) -> tuple[int, Report]:
        report = decode_report(payload, 12)
        return report.tick, report

    def check(report: Report) -> None:
        assert report.kind in ("failed", "hung", "counters")
        _check_words(report.cells, report.detail)
        assert len(report.counters) <= COUNTER_LIMIT
        numbers = [*report.counts, *(number for _, number in report.counters)]
        assert all(0 <= number < TICK_LIMIT for number in numbers)

    return Target("report", tuple(map(encode_report, reports)), decode, check)


def _registers() -> Target:
    cells = np.array([(0, 0), (1, 2), (2, 3)])
    ordinary = {
        "u": np.array([1.5, -2.0, np.nan]),
        "hops": np.zeros((3, 4), np.uint16),
        "led": cells[:, 0] > 0,
    }
    frames = [
        RegisterFrame(0, cells, encodable(ordinary)),
        RegisterFrame(TICK_LIMIT - 1, cells[:0], {}),
        RegisterFrame(200, cells[:1], encodable({f"r{i}": np.ones((1, 2, 3), np.int8) for i in range(20)})),
    ]

    def decode(payload: bytes) -> tuple[int, RegisterFrame]:
        frame = decode_registers(payload, 12)
        return frame.tick, frame

    def check(frame: RegisterFrame) -> None:
        assert frame.cells.shape == (len(frame.cells), 2)
        assert len(frame.cells) <= 12
        for name, array in frame.registers.items():
            assert name.isprintable()
            assert len(name) <= NAMES_LIMIT
            assert len(array) == len(frame.cells)
            assert array.dtype.kind in "biuf"

    return Target("registers", tuple(map(encode_registers, frames)), decode, check)


def _kept() -> Target:
    records = [
        ShardSnapshot(1, (0, 0, 0, 0), (), b""),
        ShardSnapshot(TICK_LIMIT - 1, (5, 4, 3, 2), ((b"\1", b"12345678"),) * 2, bytes(300)),
    ]

    def decode(payload: bytes) -> tuple[int, ShardSnapshot]:
        kept = decode_snapshot(payload, 3)
        return kept.tick, kept

    def check(kept: ShardSnapshot) -> None:
        assert isinstance(kept.state, bytes)
        assert all(0 <= number < TICK_LIMIT for number in kept.counts)

    return Target("memory", tuple(map(encode_snapshot, records)), decode, check)


def _request() -> Target:
    requests: list[dict[str, Any]] = [
        {"op": "list"},
        {"op": "repair", "number": 3},
        {"op": "inject", "fault": {"kind": "crash", "cell": [1, 2]}, "for_s": 0.5},
        {"op": "inject", "fault": {"kind": "crash", "share": 0.25, "at_s": 0.0, "until_s": 2.0}},
        {"op": "inject", "fault": {"kind": "crash", "rectangle": [[0, 0], [1, 1]]}},
        {"op": "inject", "fault": {"kind": "wheel_weak", "cells": [[0, 0], [1, 1]], "strength": 0.5}},
    ]

    def decode(payload: bytes) -> tuple[int, Any]:
        try:
            return 0, read_request(payload)
        except RequestError as error:
            told = "; ".join(error.problems)
            raise WireError(
                "request", "refused" if told.encode("utf-8", "replace") else "unsaid", told
            ) from None

    def check(request: Any) -> None:
        assert isinstance(request, InjectRequest | RepairRequest | ListRequest)

    return Target("request of an operator", tuple(map(JSON.pack, requests)), decode, check, JSON)


def _live_fault() -> Target:
    scene = load_scene("prototype")
    details: list[dict[str, Any]] = [
        {"number": 0, "fault": {"kind": "crash", "cell": [1, 2]}, "first": 7, "end": None},
        {"number": 2, "fault": {"kind": "crash", "share": 0.25}, "first": 7, "end": 70_000},
        {
            "number": 3,
            "fault": {"kind": "slow_clock", "rectangle": [[0, 0], [1, 2]], "factor": 0.1},
            "first": 0,
            "end": 1,
        },
        {"number": 2, "end": 200},
    ]

    def decode(payload: bytes) -> tuple[int, Any]:
        control = Control("fault", 7, (), payload.decode("utf-8", "replace"))
        return 7, decode_fault_control(control, scene.lattice(), scene.seed)

    def check(found: Any) -> None:
        if isinstance(found, tuple):
            assert all(0 <= number < TICK_LIMIT for number in found)
        else:
            assert ((found.cells >= 0) & (found.cells < len(scene.lattice()))).all()
            assert 0 <= found.start_tick < TICK_LIMIT
            assert 0 <= found.end_tick <= NO_TICK_LIMIT

    return Target("live fault", tuple(map(JSON.pack, details)), decode, check, JSON)
