"""Sequential reader of MCAP files, which may have been cut.

The library's readers look for the index at the end and give nothing of a file that was cut. This one goes
through the complete records only. It follows the format's specification, https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast, final

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Metadata, Schema

from deploy.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
_RECORD = struct.Struct("<BQ")  # opcode, length
_LZ4_RATIO = 256
"""Bytes that one byte of lz4 can stand for."""
_PIECE = 1 << 20
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time


class Message(NamedTuple):
    """A message of the file."""

    topic: str
    time_ns: int
    data: bytes


class Note(NamedTuple):
    """A metadata record of the file."""

    name: str
    values: dict[str, str]


@final
@dataclass(frozen=True, slots=True)
class Declarations:
    """Channels and schemas that a file declares, by their numbers; filled while the file is scanned."""

    channels: dict[int, Channel] = field(default_factory=dict[int, Channel])
    schemas: dict[int, Schema] = field(default_factory=dict[int, Schema])


def scan(path: Path, profile: str, declared: Declarations | None = None) -> Iterator[Message | Note]:
    """Yield messages and metadata in the order of the file, up to its end or its cut.

    Args:
        path: The file.
        profile: The profile its header must name.
        declared: Filled with the channels and schemas that are declared in the part that was scanned.

    Raises:
        InputError: The file is no MCAP file of this profile, or corrupt before its end.
        OSError: The file can't be read.
    """
    declared = Declarations() if declared is None else declared
    with path.open("rb") as stream:
        magic = stream.read(len(MAGIC))
        if magic != MAGIC[: len(magic)]:
            raise InputError(f"{path} is not a recording: it does not begin as an MCAP file does")
        for offset, opcode, content in _records(stream):
            try:
                if opcode == Opcode.HEADER:
                    _check_profile(path, content, profile)
                elif opcode == Opcode.CHUNK:
                    yield from _messages(_unpack(content), declared)
                elif opcode == Opcode.METADATA:
                    yield _note(content)
                elif opcode == Opcode.DATA_END:
                    return
                else:
                    yield from _messages(((opcode, content),), declared)
            except (ValueError, LookupError, RuntimeError, McapError, struct.error) as error:
                raise InputError(f"{path} is corrupt: record at byte {offset}: {error}") from error


def _records(stream: BinaryIO) -> Iterator[tuple[int, int, bytes]]:
    """Yield offset, opcode and content of each complete record of the file."""
    size = stream.seek(0, 2)
    offset = stream.seek(len(MAGIC))
    while offset + _RECORD.size <= size:
        opcode, length = _RECORD.unpack(stream.read(_RECORD.size))
        if offset + _RECORD.size + length > size:
            return
        yield offset, opcode, stream.read(length)
        offset += _RECORD.size + length


def _unpack(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of each record in a chunk."""
    data = _decompress(Chunk.read(ReadDataStream(BytesIO(content))))
    offset = 0
    while offset < len(data):
        opcode, length = _RECORD.unpack_from(data, offset)
        offset += _RECORD.size + length
        yield opcode, data[offset - length : offset]


def _decompress(chunk: Chunk) -> bytes:
    """Decompress a chunk, never beyond its declared size, and check size and checksum."""
    size, packed = chunk.uncompressed_size, chunk.data
    if chunk.compression == "lz4":
        data = _lz4(packed, size)
    elif chunk.compression == "zstd":  # which the tools of the format write; the recorder never does
        data = _zstd(packed, size)
    elif chunk.compression == "":
        data = packed
    else:
        raise ValueError(f"a chunk's compression is {chunk.compression!r}")
    if len(data) != size:
        raise ValueError(f"a chunk holds another number of bytes than {size}")
    if chunk.uncompressed_crc != 0 and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk is not what its checksum says")
    return data


def _lz4(packed: bytes, size: int) -> bytes:
    from lz4.frame import LZ4FrameDecompressor  # pyright: ignore[reportMissingTypeStubs]

    if size > _LZ4_RATIO * len(packed):  # it takes the memory at once
        raise ValueError(f"a chunk of {len(packed)} bytes can't hold {size}")
    return cast("bytes", cast("Any", LZ4FrameDecompressor()).decompress(packed, max_length=size))


def _zstd(packed: bytes, size: int) -> bytes:
    from zstandard import ZstdDecompressor, ZstdError

    reader, data = ZstdDecompressor().stream_reader(packed), bytearray()
    try:
        while len(data) <= size and (piece := reader.read(_PIECE)):
            data += piece
    except ZstdError as error:
        raise ValueError(str(error)) from None
    return bytes(data)


def _messages(records: Iterable[tuple[int, bytes]], declared: Declarations) -> Iterator[Message]:
    """Yield the messages among records, and keep what else the records declare."""
    for opcode, content in records:
        if opcode == Opcode.MESSAGE:
            channel, _, time_ns, _ = _MESSAGE.unpack_from(content)
            yield Message(declared.channels[channel].topic, time_ns, content[_MESSAGE.size :])
        elif opcode == Opcode.CHANNEL:
            found = Channel.read(ReadDataStream(BytesIO(content)))
            declared.channels[found.id] = found
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(content)))
            declared.schemas[schema.id] = schema


def _note(content: bytes) -> Note:
    record = Metadata.read(ReadDataStream(BytesIO(content)))
    return Note(record.name, record.metadata)


def _check_profile(path: Path, content: bytes, profile: str) -> None:
    header = Header.read(ReadDataStream(BytesIO(content)))
    if header.profile != profile:
        raise InputError(
            f"{path} is not a recording: an MCAP file of profile {header.profile!r}, not {profile!r}"
        )
