"""Reads an MCAP file from front to back, as far as it is whole.

The library's readers look for the index at the end and give nothing of a file that was cut. This one goes
through the complete records only. It follows the format's specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata
from mcap.stream_reader import get_chunk_data_stream

from deploy.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time


class Message(NamedTuple):
    """One message: its topic, log time and bytes."""

    topic: str
    time_ns: int
    data: bytes


class Note(NamedTuple):
    """One metadata record."""

    name: str
    values: dict[str, str]


def scan(path: Path, profile: str) -> Iterator[Message | Note]:
    """Messages and metadata in the order of the file, up to its end or to where it was cut.

    Args:
        path: The file.
        profile: The profile its header must name.

    Raises:
        InputError: Not an MCAP file of this profile, or corrupt before its end.
        OSError: As the operating system has it.
    """
    topics: dict[int, str] = {}
    with path.open("rb") as stream:
        magic = stream.read(len(MAGIC))
        if magic != MAGIC[: len(magic)]:
            raise InputError(f"{path} is not a recording: it does not begin as an MCAP file does")
        for offset, opcode, content in _records(stream):
            try:
                if opcode == Opcode.HEADER:
                    _check_profile(path, content, profile)
                elif opcode == Opcode.CHUNK:
                    yield from _messages(_unpack(content), topics)
                elif opcode == Opcode.METADATA:
                    yield _note(content)
                elif opcode == Opcode.DATA_END:
                    return
                else:
                    yield from _messages(((opcode, content),), topics)
            except (ValueError, LookupError, RuntimeError, McapError, struct.error) as error:
                raise InputError(f"{path} is corrupt: record at byte {offset}: {error}") from error


def _records(stream: BinaryIO) -> Iterator[tuple[int, int, bytes]]:
    """Offset, opcode and content of each complete record of the file."""
    size = stream.seek(0, 2)
    offset = stream.seek(len(MAGIC))
    while offset + _RECORD.size <= size:
        opcode, length = _RECORD.unpack(stream.read(_RECORD.size))
        if offset + _RECORD.size + length > size:
            return
        yield offset, opcode, stream.read(length)
        offset += _RECORD.size + length


def _unpack(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of each record in a chunk."""
    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    data = stream.read(size)
    offset = 0
    while offset < size:
        opcode, length = _RECORD.unpack_from(data, offset)
        offset += _RECORD.size + length
        yield opcode, data[offset - length : offset]


def _messages(records: Iterable[tuple[int, bytes]], topics: dict[int, str]) -> Iterator[Message]:
    """The messages among records; channels on the way are noted in ``topics``."""
    for opcode, content in records:
        if opcode == Opcode.MESSAGE:
            channel, _, time_ns, _ = _MESSAGE.unpack_from(content)
            yield Message(topics[channel], time_ns, content[_MESSAGE.size :])
        elif opcode == Opcode.CHANNEL:
            declared = Channel.read(ReadDataStream(BytesIO(content)))
            topics[declared.id] = declared.topic


def _note(content: bytes) -> Note:
    record = Metadata.read(ReadDataStream(BytesIO(content)))
    return Note(record.name, record.metadata)


def _check_profile(path: Path, content: bytes, profile: str) -> None:
    header = Header.read(ReadDataStream(BytesIO(content)))
    if header.profile != profile:
        raise InputError(
            f"{path} is not a recording: an MCAP file of profile {header.profile!r}, not {profile!r}"
        )
