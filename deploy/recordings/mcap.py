"""One MCAP file being written: the library's writer, set up for a recording."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast, final

import msgpack  # pyright: ignore[reportMissingTypeStubs]
from mcap.writer import CompressionType, Writer

from deploy.recordings.format import FORMAT, HEADER_RECORD, PROFILE, SCHEMAS, Header, binary_schemas


@final
class McapFile:
    """Chunks of lz4, indexed once finished, readable up to the last flush before that.

    Args:
        path: File to make or replace.
        header: Written and flushed at once, outside the chunks, so that it survives anything later.
        chunk_bytes: Size at which a chunk is closed without a request.
        schemas: JSON Schema of every MessagePack topic; None: those of the header.

    Attributes:
        channels: Number of each topic's channel.
        pack: Form of a message on ``/tick`` and ``/registers``.

    Raises:
        OSError: From any method, as the operating system has it.
    """

    def __init__(
        self,
        path: Path,
        header: Header,
        chunk_bytes: int,
        *,
        schemas: Mapping[str, dict[str, Any]] | None = None,
    ) -> None:
        self._stream = path.open("wb")
        try:
            # The library's default is 1 MB: at 18 cells minutes would pass before anything reached the file.
            self._writer = Writer(self._stream, chunk_size=chunk_bytes, compression=CompressionType.LZ4)
            self._writer.start(profile=PROFILE, library="mdms")
            self._writer.add_metadata(HEADER_RECORD, {"format": str(FORMAT), "json": json.dumps(header)})
            self._stream.flush()
        except OSError:
            self.abandon()
            raise
        binary = binary_schemas(header) if schemas is None else schemas
        self.channels: Mapping[str, int] = {
            **{topic: self._channel(topic, "msgpack", schema) for topic, schema in binary.items()},
            **{topic: self._channel(topic, "json", schema) for topic, schema in SCHEMAS.items()},
        }
        packer = cast(Any, msgpack.Packer())  # pyright: ignore[reportUnknownMemberType]
        self.pack = cast(Callable[[Mapping[str, Any]], bytes], packer.pack)

    def _channel(self, topic: str, encoding: str, schema: dict[str, Any]) -> int:
        name = "mdms." + topic.removeprefix("/")
        number = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        return self._writer.register_channel(topic, encoding, number)

    def add(self, channel: int, time_ns: int, data: bytes) -> None:
        """Add a message; it reaches the file with its chunk."""
        self._writer.add_message(channel, time_ns, data, time_ns)

    def flush(self) -> None:
        """Close the chunk in progress and hand everything to the operating system."""
        self._writer.flush()

    def sync(self) -> None:
        """Have what was flushed survive a loss of power; from any thread."""
        os.fsync(self._stream.fileno())

    def finish(self) -> None:
        """Write the index and close the file."""
        self._writer.finish()
        self._stream.close()

    def abandon(self) -> None:
        """Close the file as it is, after an error, without trying again to write what is buffered."""
        self._stream.raw.close()
