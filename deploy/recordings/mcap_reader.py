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


@final
@dataclass(frozen=True, slots=True, eq=False)
class PackedChunk:
    """Records of the file, compressed as they are there.

    Attributes:
        data: The compressed records.
        compression: ``lz4``, ``zstd``, or nothing.
        size: Bytes of the records.
        checksum: CRC-32 of the records; 0: not known.
    """

    data: bytes
    compression: str
    size: int
    checksum: int

    def unpack(self) -> bytes:
        """Return the records, never beyond their declared size; check size and checksum.

        Raises:
            ValueError: They are not what the chunk says.
        """
        if self.compression == "lz4":
            data = _lz4(self.data, self.size)
        elif self.compression == "zstd":  # which the tools of the format write; the recorder never does
            data = _zstd(self.data, self.size)
        elif self.compression == "":
            data = self.data
        else:
            raise ValueError(f"a chunk's compression is {self.compression!r}")
        if len(data) != self.size:
            raise ValueError(f"a chunk holds another number of bytes than {self.size}")
        if self.checksum != 0 and zlib.crc32(data) != self.checksum:
            raise ValueError("a chunk is not what its checksum says")
        return data


class Message(NamedTuple):
    """A message of the file.

    Attributes:
        topic: Topic of its channel.
        time_ns: When it was logged.
        data: Its content.
        chunk: Where it is in the file, ...
        start: ... and the first byte of its content there, once unpacked.
    """

    topic: str
    time_ns: int
    data: bytes
    chunk: PackedChunk
    start: int


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
                    chunk = Chunk.read(ReadDataStream(BytesIO(content)))
                    packed = PackedChunk(
                        chunk.data, chunk.compression, chunk.uncompressed_size, chunk.uncompressed_crc
                    )
                    yield from _messages(packed, _unpack(packed.unpack()), declared)
                elif opcode == Opcode.METADATA:
                    yield _note(content)
                elif opcode == Opcode.DATA_END:
                    return
                else:
                    yield from _messages(
                        PackedChunk(content, "", len(content), 0), ((opcode, 0, content),), declared
                    )
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


def _unpack(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Yield opcode, first byte of the content and content of each record of an unpacked chunk."""
    offset = 0
    while offset < len(data):
        opcode, length = _RECORD.unpack_from(data, offset)
        offset += _RECORD.size + length
        yield opcode, offset - length, data[offset - length : offset]


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


def _messages(
    chunk: PackedChunk, records: Iterable[tuple[int, int, bytes]], declared: Declarations
) -> Iterator[Message]:
    """Yield the messages among a chunk's records, and keep what else the records declare."""
    for opcode, start, content in records:
        if opcode == Opcode.MESSAGE:
            channel, _, time_ns, _ = _MESSAGE.unpack_from(content)
            topic, data = declared.channels[channel].topic, content[_MESSAGE.size :]
            yield Message(topic, time_ns, data, chunk, start + _MESSAGE.size)
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
