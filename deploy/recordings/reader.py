"""Reader of recordings, whole or cut."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from deploy.errors import InputError
from deploy.recordings.format import (
    CONTROL,
    END,
    EVENTS,
    FAULTS,
    FILE_NAME,
    HEADER_RECORD,
    MESSAGES,
    PROFILE,
    READABLE,
    REGISTERS,
    TICK,
    TRACE,
    Header,
)
from deploy.recordings.recording import Recording
from deploy.recordings.rows import TickRows

if TYPE_CHECKING:
    from deploy.recordings.mcap_reader import Note

_Read = TypeVar("_Read")


def load(path: str | Path) -> Recording:
    """Load a recording, whole or cut.

    Args:
        path: The file, or the output folder it is in.

    Raises:
        InputError: There is no such file, it is no recording, it is corrupt before its end, or it was cut
            before it said what it is a recording of.
    """
    return refusing_corruption(path, _load)


def refusing_corruption(path: str | Path, read: Callable[[Path], _Read]) -> _Read:
    """Return what ``read`` returns of a recording, with errors that name the file and the cause.

    Args:
        path: The file, or the output folder it is in.
        read: Takes the file.

    Raises:
        InputError: There is no such file, it can't be read, or it is corrupt.
    """
    path = Path(path)
    if path.is_dir():
        if not (path / FILE_NAME).exists():
            raise InputError(f"there is no {FILE_NAME} in {path}")
        path = path / FILE_NAME
    try:
        return read(path)
    except OSError as error:
        raise InputError(f"can't read the recording {path}: {error.strerror or error}") from error
    except (ValueError, LookupError, TypeError, OverflowError, RecursionError) as error:
        raise InputError(f"{path} is corrupt: {error}") from error


def _load(path: Path) -> Recording:
    import msgpack  # pyright: ignore[reportMissingTypeStubs]

    from deploy.recordings.checks import check_end, check_faults, check_records, check_traffic
    from deploy.recordings.mcap_reader import Message, scan

    unpack = cast(Callable[[bytes], object], msgpack.unpackb)  # pyright: ignore[reportUnknownMemberType]
    header: Header | None = None
    rows = TickRows()
    shown: list[dict[str, Any]] = []
    sent: list[dict[str, Any]] = []
    traced: list[dict[str, Any]] = []
    logs: dict[str, list[object]] = {EVENTS: [], FAULTS: [], CONTROL: [], END: []}
    for record in scan(path, PROFILE):
        if isinstance(record, Message):
            if record.topic == TICK:
                rows.add(record, _map(unpack(record.data)))
            elif record.topic == REGISTERS:
                shown.append(_map(unpack(record.data)))
            elif record.topic == MESSAGES:
                sent.append(_map(unpack(record.data)))
            elif record.topic == TRACE:
                traced.append(_map(unpack(record.data)))
            elif record.topic in logs:
                logs[record.topic].append(json.loads(record.data))
        else:
            header = decode_header(path, record) or header
    if header is None:
        raise InputError(f"can't read the recording {path}: it holds no complete header")
    end = check_end(logs[END][-1]) if logs[END] else None
    events = check_records(logs[EVENTS])
    check_traffic(events, len(header["footprints_m"]))
    return Recording(
        path=path,
        header=header,
        events=events,
        faults=check_faults(logs[FAULTS]),
        control=check_records(logs[CONTROL]),
        status=None if end is None else end.status,
        digest=None if end is None else end.digest,
        motion_digest=None if end is None else end.motion_digest,
        register_tick=np.array([message["tick"] for message in shown], dtype=np.int64),
        registers=_stacked(shown, "registers"),
        message_tick=np.array([message["tick"] for message in sent], dtype=np.int64),
        messages=_stacked(sent, "messages"),
        trace_tick=np.array([message["tick"] for message in traced], dtype=np.int64),
        trace=_stacked(traced, "trace"),
        **rows.arrays(header),
    )


def _map(value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise TypeError(f"a message is a {type(value).__name__}, not a map")
    return cast("dict[str, Any]", value)


def _stacked(shown: Sequence[dict[str, Any]], key: str) -> dict[str, NDArray[Any]]:
    """Stack recorded arrays by name; zero where one is missing or has another shape."""
    found: dict[str, NDArray[Any]] = {}
    for row, message in enumerate(shown):
        for name, (code, shape, data) in _map(message[key]).items():
            values = np.frombuffer(data, np.dtype(code)).reshape(shape)
            if name not in found:
                found[name] = np.zeros((len(shown), *values.shape), dtype=values.dtype)
            if found[name].shape[1:] == values.shape:
                found[name][row] = values
    return found


def decode_header(path: Path, record: Note) -> Header | None:
    """Decode and check the header; None if the metadata record is another.

    Raises:
        InputError: The recording has another format, or fields are absent.
        ValueError: A field has the wrong type.
    """
    if record.name != HEADER_RECORD:
        return None
    values = record.values
    if values.get("format") not in [str(version) for version in READABLE]:
        raise InputError(
            f"{path} is a recording of format {values.get('format')}: this version reads formats "
            f"{' and '.join(map(str, READABLE))}"
        )
    from deploy.recordings.checks import check_header

    header = cast(Header, json.loads(values["json"]))
    absent = sorted(Header.__required_keys__ - set(header))
    if absent:
        raise InputError(f"{path} is not a recording of mdms: its header has no {', '.join(absent)}")
    return check_header(header)
