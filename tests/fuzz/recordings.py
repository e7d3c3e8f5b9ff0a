"""Spoilt recordings: a file's bytes changed or cut, or a whole file around spoilt messages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from deploy.errors import InputError
from deploy.recordings.format import CONTROL, END, EVENTS, FAULTS, REGISTERS, TICK, Header, binary_schemas
from deploy.recordings.mcap import McapFile
from deploy.recordings.reader import load
from deploy.recordings.recording import Recording
from deploy.recordings.writer import Recorder
from tests.fuzz.mutator import JSON, MESSAGEPACK, Mutator

CELLS = [[row, column] for row in range(2) for column in range(3)]
HEADER = Header(
    run="r1",
    title="A made-up run",
    scene_name="made_up",
    scene={"duration_s": 1.0, "effects": {"parcel_contact": {"rails": [[[0.0, 0.0], [1.0, 0.0]]]}}},
    versions={"python": "3.11"},
    period_ns=4_096_000,
    pitch_m=0.1,
    cells=CELLS,
    positions_m=[[0.1 * column, 0.1 * row] for row, column in CELLS],
    sensors_m=[[0.0, 0.0], [0.0, 0.01]],
    footprints_m=[[[-0.1, -0.1], [0.1, -0.1], [0.0, 0.1]], [[-0.1, -0.1], [0.1, -0.1], [0.0, 0.1]]],
    own_parcels=1,
    exits=[{"name": "out", "corners_m": [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]]}],
)
_FORMS = {
    TICK: MESSAGEPACK, REGISTERS: MESSAGEPACK, EVENTS: JSON, FAULTS: JSON, CONTROL: JSON, END: JSON
}  # fmt: skip


def record(folder: Path) -> bytes:
    """A small recording with something of everything, as the recorder writes it."""
    ones, n = np.ones((len(CELLS), 2)), len(CELLS)
    with Recorder(folder, HEADER) as recorder:
        for tick in range(4):
            time_ns = tick * HEADER["period_ns"]
            drives = ones * tick if tick < 3 else None
            recorder.tick(tick, time_ns, ones > tick, drives, ones / 3.0, np.full((2, 6), tick / 7.0))
            recorder.registers(tick, time_ns, {"u": np.arange(2.0 * n).reshape(n, 2), "led": ones[:, 0] > 0})
            recorder.flush()
        recorder.event({"time_s": 0.004096, "kind": "fed", "parcel": 1})
        recorder.event({"time_s": 0.008192, "kind": "left", "parcel": 1, "detail": "out"})
        recorder.fault({"time_s": 0.01, "kind": "crash", "cell": [1, 2], "detail": "scheduled"})
        recorder.control({"time_s": 0.01, "kind": "pause"})
        recorder.close("ok", "ab" * 32)
    return recorder.path.read_bytes()


def use(path: Path) -> Recording | None:
    """Load a recording and make all that it offers; None where it is refused as bad input."""
    try:
        recording = load(path)
    except InputError:
        return None
    found = (recording.presence, recording.drives, recording.wheel_speeds, recording.time_s)
    assert all(len(values) == len(recording.tick) for values in found)
    recording.run_trace()
    return recording


class SpoiltMessages:
    """Recordings that are whole as files, of messages of which one in a few is spoilt.

    Args:
        folder: Where a good recording is, and where the spoilt ones go.
        purpose: The same words, the same recordings.
    """

    def __init__(self, folder: Path, purpose: str) -> None:
        from deploy.recordings.mcap_reader import Message, scan

        self._path = folder / "spoilt.mcap"
        good = folder / "recording.mcap"
        self._messages = [one for one in scan(good, "mdms") if isinstance(one, Message)]
        self._mutators = {
            topic: Mutator(
                [m.data for m in self._messages if m.topic == topic], f"{purpose} {topic}", _FORMS[topic]
            )
            for topic in _FORMS
        }
        self._header = Mutator([JSON.pack(HEADER)], f"{purpose} header", JSON)
        self._number = 0

    def next(self) -> Path:
        """One of them."""
        self._number += 1
        header = self._spoilt_header() if self._number % 3 == 0 else HEADER
        file = McapFile(self._path, header, 1 << 18, schemas=binary_schemas(HEADER))
        for i, message in enumerate(self._messages):
            topic, data = message.topic, message.data
            # Another message of each file is spoilt.
            if topic in self._mutators and i % len(self._messages) == self._number % len(self._messages):
                data = self._mutators[topic].next()
            file.add(file.channels[topic], message.time_ns, data)
        file.finish()
        return self._path

    def _spoilt_header(self) -> Any:
        while True:
            try:
                return json.loads(self._header.next())
            except ValueError:
                continue
