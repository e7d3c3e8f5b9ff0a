"""Contents of a recording, whole or cut, without its arrays in memory."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, cast, final

from deploy.errors import InputError
from deploy.recordings.format import CONTROL, END, EVENTS, FAULTS, TICK, Header
from deploy.recordings.mcap_reader import Declarations, Message, scan
from deploy.recordings.reader import decode_header, refusing_corruption


@final
@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a recording.

    Attributes:
        name: Name of the topic.
        encoding: Encoding of its messages.
        schema: Name of its schema; empty without one.
        schema_encoding: Encoding of its schema; empty without one.
        messages: Number of messages.
        bytes: Size of the messages before compression.
    """

    name: str
    encoding: str
    schema: str
    schema_encoding: str
    messages: int
    bytes: int


@final
@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """Contents of a recording.

    Attributes:
        path: The file.
        size_bytes: Its size.
        format: Version of the format.
        run: Name of the run.
        title: Title of the scene.
        scene: Name of the scene, or its file.
        cells: Number of cells.
        sensors: Presence sensors of a cell.
        parcels: Number of parcels, fed ones included.
        period_s: Length of a tick, s.
        seed: Seed of the scene; None if it names none.
        versions: Versions with which it was made.
        instants: Number of recorded instants.
        ticks: Number of the last tick; None without any instant.
        time_s: Simulated time of the last instant, s.
        complete: Whether the recording holds the whole of its run.
        status: Final status of the run; None if the recording was cut before its end.
        digest: Digest of the run; None if the recording was cut or has none.
        motion_digest: Digest of sensor bits, drives and parcel states alone; None if the recording has none.
        topics: Topics of the file.
        events: Number of events of the plant, by kind.
        faults: Recorded faults and losses.
        commands: Live commands by kind.
    """

    path: Path
    size_bytes: int
    format: int
    run: str
    title: str
    scene: str
    cells: int
    sensors: int
    parcels: int
    period_s: float
    seed: int | None
    versions: Mapping[str, str]
    instants: int
    ticks: int | None
    time_s: float
    complete: bool
    status: str | None
    digest: str | None
    motion_digest: str | None
    topics: tuple[TopicInfo, ...]
    events: Mapping[str, int]
    faults: tuple[Mapping[str, Any], ...]
    commands: Mapping[str, int]

    def to_json(self) -> dict[str, Any]:
        """Return the content in JSON's types."""
        return {**asdict(self), "path": str(self.path)}


def recording_info(path: str | Path) -> RecordingInfo:
    """Return the contents of a recording, whole or cut.

    The file is read once, chunk by chunk. Memory does not grow with the number of ticks.

    Args:
        path: The file, or the output folder it is in.

    Raises:
        InputError: There is no such file, it is no recording, it is corrupt before its end, or it was cut
            before its header's end.
    """
    return refusing_corruption(path, _info)


@final
@dataclass(slots=True)
class _Tally:
    """Counts of a scan so far."""

    messages: Counter[str] = field(default_factory=Counter[str])
    size: Counter[str] = field(default_factory=Counter[str])
    events: Counter[str] = field(default_factory=Counter[str])
    commands: Counter[str] = field(default_factory=Counter[str])
    faults: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    last_ns: int = 0
    last_tick: bytes | None = None
    end: object = None

    def add(self, message: Message) -> None:
        topic, data = message.topic, message.data
        self.messages[topic] += 1
        self.size[topic] += len(data)
        if topic == TICK:
            self.last_ns, self.last_tick = message.time_ns, data
        elif topic == EVENTS:
            self.events[str(json.loads(data)["kind"])] += 1
        elif topic == CONTROL:
            self.commands[str(json.loads(data)["kind"])] += 1
        elif topic == FAULTS:
            self.faults.append(json.loads(data))
        elif topic == END:
            self.end = json.loads(data)


def _info(path: Path) -> RecordingInfo:
    import msgpack  # pyright: ignore[reportMissingTypeStubs]

    from deploy.recordings.checks import check_end, check_faults
    from deploy.recordings.format import PROFILE

    tally, declared, header, version = _Tally(), Declarations(), cast("Header | None", None), 0
    for record in scan(path, PROFILE, declared):
        if isinstance(record, Message):
            tally.add(record)
        elif (found := decode_header(path, record)) is not None:
            header, version = found, int(record.values["format"])
    if header is None:
        raise InputError(f"can't read the recording {path}: it holds no complete header")
    end = None if tally.end is None else check_end(tally.end)
    unpack = cast(Callable[[bytes], Any], msgpack.unpackb)  # pyright: ignore[reportUnknownMemberType]
    return RecordingInfo(
        path=path,
        size_bytes=path.stat().st_size,
        format=version,
        run=header["run"],
        title=header["title"],
        scene=header["scene_name"],
        cells=len(header["cells"]),
        sensors=len(header["sensors_m"]),
        parcels=len(header["footprints_m"]),
        period_s=header["period_ns"] * 1e-9,
        seed=header["scene"].get("seed"),
        versions=header["versions"],
        instants=tally.messages[TICK],
        ticks=None if tally.last_tick is None else int(unpack(tally.last_tick)["tick"]),
        time_s=tally.last_ns * 1e-9,
        complete=end is not None,
        status=None if end is None else end.status,
        digest=None if end is None else end.digest,
        motion_digest=None if end is None else end.motion_digest,
        topics=_topics(declared, tally),
        events=dict(tally.events),
        faults=tuple(check_faults(tally.faults)),
        commands=dict(tally.commands),
    )


def _topics(declared: Declarations, tally: _Tally) -> tuple[TopicInfo, ...]:
    """Declared topics, in the order of their channels."""
    found: list[TopicInfo] = []
    for _, channel in sorted(declared.channels.items()):
        schema = declared.schemas.get(channel.schema_id)
        found.append(
            TopicInfo(
                channel.topic,
                channel.message_encoding,
                "" if schema is None else schema.name,
                "" if schema is None else schema.encoding,
                tally.messages[channel.topic],
                tally.size[channel.topic],
            )
        )
    return tuple(found)
